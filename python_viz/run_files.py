"""Read what one run of particles_mpi left in its output folder, and the few things all scripts here share.

Only the files are read: `trajectory.vtkhdf` (all frames), `diagnostics.csv` (sums over time), `run.json` (scene, timers).
They may be read while the run still writes them: only frames and rows that are whole are used.
"""

import argparse
import csv
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import h5py
import matplotlib
import numpy as np
from matplotlib.figure import Figure

DEFAULT_RUN = Path("out/marbles")


def stop(message: str) -> NoReturn:
    """End the script with one line on stderr and exit code 2."""
    print(f"{Path(sys.argv[0]).name}: {message}", file=sys.stderr)
    raise SystemExit(2)


@dataclass
class Frame:
    """The particles at one time, in id order: fields[name] is PointData/name, row i belongs to the particle fields["id"][i]."""

    index: int
    time: float
    position: np.ndarray
    fields: dict[str, np.ndarray]

    @property
    def id(self) -> np.ndarray:
        return self.fields["id"]

    @property
    def radius(self) -> np.ndarray:
        return self.fields.get("radius", np.zeros(len(self.position)))

    @property
    def fixed(self) -> np.ndarray:
        return self.fields.get("fixed", np.zeros(len(self.position))).astype(bool)

    @property
    def speed(self) -> np.ndarray:
        velocity = self.fields.get("velocity_full", self.fields["velocity"])  # the whole one, in more than three dimensions
        speed: np.ndarray = np.linalg.norm(velocity, axis=1)
        return speed


class Trajectory:
    """The frames of `trajectory.vtkhdf`: `trajectory.times`, `len(trajectory)`, `trajectory[k]` (k < 0 counts from the end)."""

    def __init__(self, run: Path) -> None:
        path = run / "trajectory.vtkhdf"
        if not path.is_file():
            stop(f"no {path} (give the folder of a run that wrote hdf5 frames)")
        try:
            self.data = h5py.File(path, "r", locking=False)["VTKHDF"]
            self.steps = self.data["Steps"]
            count = int(self.steps.attrs["NSteps"])  # raised last: the datasets may already be longer
        except (OSError, KeyError) as error:
            stop(f"cannot read {path}: {error}")
        if count == 0:
            stop(f"no frames yet in {path}")
        self.times: np.ndarray = self.steps["Values"][:count]

    def __len__(self) -> int:
        return len(self.times)

    def __getitem__(self, k: int) -> Frame:
        if not -len(self) <= k < len(self):
            stop(f"no frame {k}: the run has frames 0 to {len(self) - 1}")
        k %= len(self)
        try:
            count = int(self.data["NumberOfPoints"][self.steps["PartOffsets"][k]])
            first = int(self.steps["PointOffsets"][k])
            position = self.data["Points"][first : first + count]
            fields = {}
            for name, values in self.data["PointData"].items():
                first = int(self.steps["PointDataOffsets"][name][k])
                fields[name] = values[first : first + count]
        except (OSError, KeyError) as error:
            stop(f"cannot read frame {k} of {self.data.file.filename}: {error}")
        return Frame(k, float(self.times[k]), fields.pop("position", position), fields)


def read_diagnostics(run: Path) -> dict[str, np.ndarray]:
    """The columns of `diagnostics.csv` by name; a last row that is still being written is left out."""
    path = run / "diagnostics.csv"
    if not path.is_file():
        stop(f"no {path}")
    with path.open(newline="") as lines:
        header, *rows = list(csv.reader(lines)) or [[]]
    whole = [row for row in rows if len(row) == len(header) and all(row)]
    if not whole:
        stop(f"no rows yet in {path}")
    try:
        return dict(zip(header, np.array(whole, dtype=float).T, strict=True))
    except ValueError as error:
        stop(f"cannot read {path}: {error}")


def read_run_json(run: Path) -> dict[str, Any]:
    """The content of `run.json`; empty where a run has none (a trajectory alone can still be drawn)."""
    path = run / "run.json"
    try:
        return json.loads(path.read_text()) if path.is_file() else {}
    except ValueError as error:
        stop(f"cannot read {path}: {error}")


def title_of(run: Path) -> str:
    """The title the scene gives itself, else the name of the folder."""
    return read_run_json(run).get("scene", {}).get("title") or run.resolve().name


def spaced(count: float) -> str:
    """A count with thin spaces between the thousands: 32 000."""
    return f"{int(count):_}".replace("_", "\u202f")


def new_parser(description: str | None) -> argparse.ArgumentParser:
    """A parser that shows the docstring of a script as it is written, with the options every script has."""
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
    """The file to write: the one asked for, else RUN_DIR/plots/name; its folder is made."""
    path = asked or run / "plots" / name
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        stop(f"cannot write {path}: {error}")
    return path


def finish(figure: Figure, path: Path, show: bool) -> None:
    """Save the figure, print where, and open a window if asked."""
    from matplotlib import pyplot

    try:
        figure.savefig(path, dpi=figure.dpi)
    except (OSError, ValueError) as error:
        stop(f"cannot write {path}: {error}")
    print(path)
    if show:
        pyplot.show()
