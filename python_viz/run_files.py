"""Shared by all scripts here: their command line, their exit, and the folder of their pictures.

`particles_mpi.Run` reads a run, also while it is still running: only complete frames and rows are used.
"""

import argparse
import sys
from collections.abc import Callable
from math import isfinite
from pathlib import Path
from typing import NoReturn

import matplotlib
from cycler import cycler
from matplotlib.figure import Figure

from particles_mpi.errors import SceneError

DEFAULT_RUN = Path("out/marbles")
# Colours that stay apart for colour-blind readers (M. Okabe, K. Ito, 2008), each with a dash of its own.
PAINTS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
DASHES = ("-", "--", ":", "-.", "-", "--")
BLUE, RED, GREY = PAINTS[0], PAINTS[1], "#4a5260"
matplotlib.rcParams.update(
    {
        "axes.prop_cycle": cycler(color=PAINTS, linestyle=DASHES),
        "axes.titlelocation": "left",
        "axes.axisbelow": True,
        "axes.grid": True,
        "grid.color": "#e3e6ea",
        "grid.linewidth": 0.7,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "legend.frameon": False,
    }
)


def stop(message: str) -> NoReturn:
    """End the script with one line on stderr and exit code 2."""
    print(f"{Path(sys.argv[0]).name}: {message}", file=sys.stderr)
    raise SystemExit(2)


def start(main: Callable[[], None]) -> None:
    """Run a script; if something in a run is wrong or missing, end it with one line."""
    try:
        main()
    except (SceneError, IndexError) as error:
        stop(str(error))


def within(low: float, high: float) -> Callable[[str], float]:
    """Return a function, for a parser, that reads a number within limits."""

    def number(text: str) -> float:
        value = float(text)
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text} is not from {low:g} to {high:g}")
        return value

    return number


def finite(text: str) -> float:
    """Return a finite number, for a parser."""
    number = float(text)
    if not isfinite(number):
        raise argparse.ArgumentTypeError(f"{text} is not finite")
    return number


def spaced(count: float) -> str:
    """Return a count with thin spaces between the thousands: 32 000."""
    return f"{int(count):_}".replace("_", "\u202f")


def new_parser(description: str | None) -> argparse.ArgumentParser:
    """Return a parser that shows the docstring of a script as it is written, with the options of every script."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--save", type=Path, metavar="FILE", help="where to save (default: a file in RUN_DIR/plots)")
    return parser


def parse(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """Parse the command line of a script that draws one picture; without --show no screen is needed."""
    parser.add_argument("--show", action="store_true", help="also open a window")
    arguments = parser.parse_args()
    if not arguments.show:
        matplotlib.use("Agg")
    return arguments


def save_path(asked: Path | None, run: Path, name: str) -> Path:
    """Return the file to write: the one given by --save, or RUN_DIR/plots/name; make its folder."""
    path = asked or run / "plots" / name
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        stop(f"cannot write {path}: {error}")
    return path


def finish(figure: Figure, path: Path, show: bool) -> None:
    """Save the figure, print its path, and open a window with --show."""
    from matplotlib import pyplot

    known = path.exists()
    try:
        figure.savefig(path, dpi=figure.dpi)
    except (OSError, ValueError, MemoryError) as error:
        if not known:
            path.unlink(missing_ok=True)  # no half of a picture stays
        stop(f"cannot write {path}: {error}")
    print(path if path.suffix else path.with_suffix(".png"))
    if show:
        pyplot.show()
