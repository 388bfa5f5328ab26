"""Plot the sums of a run against time: energy, momentum, events per unit time (collisions, wall hits, missed), largest speed.

If bodies attract one another and never collide, angular momentum is drawn instead of events.

The heading of the energy panel says how far the total energy has moved from its first value: a run without losses should
keep it; with friction, drag or inelastic collisions it must fall. Steady momentum is the same check for the forces.

example:
    python python_viz/plot_diagnostics.py out/marbles
draws out/marbles/diagnostics.csv into out/marbles/plots/diagnostics.png
"""

from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from run_files import DASHES, DEFAULT_RUN, finish, new_parser, parse, save_path, spaced, start, stop

from particles_mpi import Run
from particles_mpi.results.curves import EVENTS, rates

BINS = 200  # longer runs have their counts summed to about this many intervals, or the rates would be a black band


def plot_energy(axes: Axes, rows: dict[str, np.ndarray]) -> None:
    """Draw kinetic, potential and total energy; the heading gives the change of the total, relative to the largest energy.

    A run with a force along a periodic axis has only a kinetic energy.
    """
    axes.plot(rows["time"], rows["kinetic"], label="kinetic")
    if not np.isfinite(rows["total_energy"]).all():
        axes.set_title("kinetic energy   (a force along a periodic axis has no potential)")
        return
    axes.plot(rows["time"], rows["potential"], label="potential")
    if "rotational" in rows:
        axes.plot(rows["time"], rows["rotational"], label="of spins")
    axes.plot(rows["time"], rows["total_energy"], color="#222222", ls=":", label="total")
    total = rows["total_energy"]
    scale = max(np.abs(rows[name]).max() for name in ("kinetic", "potential", "total_energy")) or 1
    axes.set_title(f"energy   (total changed by {(total[-1] - total[0]) / scale:+.2g} of the largest energy)")
    at_least(axes, 1e-9 * scale)


def plot_momentum(axes: Axes, rows: dict[str, np.ndarray]) -> None:
    """Draw the components of the total momentum; round-off is not magnified: sum of m|v| is at least 2 K / (largest speed)."""
    plot_components(axes, rows, "momentum")
    at_least(axes, 1e-9 * float((2 * rows["kinetic"] / np.maximum(rows["max_speed"], 1e-300)).max()))


def plot_components(axes: Axes, rows: dict[str, np.ndarray], what: str) -> None:
    """Draw every component of a vector; the heading gives the largest change of any from its first value."""
    names = [name for name in rows if name.startswith(f"{what}_")]
    for name in names:
        axes.plot(rows["time"], rows[name], label=name.removeprefix(f"{what}_"))
    change = max(float(np.abs(rows[name] - rows[name][0]).max()) for name in names)
    axes.set_title(f"{what.replace('_', ' ')}   (changed by at most {change:.2g})")


def plot_rates(axes: Axes, rows: dict[str, np.ndarray]) -> None:
    """Draw events per unit time: counts since the previous row over the time since then; angular momentum if there are none."""
    if not any(rows[name].any() for name in EVENTS) and any(name.startswith("angular_momentum_") for name in rows):
        plot_components(axes, rows, "angular_momentum")
        return
    edges, found = rates(rows, BINS)
    if len(edges) < 2:
        axes.text(0.5, 0.5, "needs two rows", ha="center", transform=axes.transAxes)
    for name, dash in zip(EVENTS, DASHES, strict=False):
        if rows[name].any() and len(edges) > 1:
            label = f"{name.replace('_', ' ')} ({spaced(rows[name].sum())})"
            axes.stairs(found[name], edges, baseline=None, ls=dash, label=label, lw=1.4)
    none = [name.replace("_", " ") for name in EVENTS if not rows[name].any()]
    axes.set_title("events per unit time (in all)" + (f"   no {', no '.join(none)}" if none else ""))
    axes.set_ylim(bottom=0)


def plot_speed(axes: Axes, rows: dict[str, np.ndarray]) -> None:
    """Draw the speed of the fastest particle."""
    axes.plot(rows["time"], rows["max_speed"])
    axes.set_title("speed of the fastest particle")
    axes.set_ylim(bottom=0)


def at_least(axes: Axes, span: float) -> None:
    """Widen the y range to `span`, so that round-off in a constant is not magnified to the full height."""
    low, high = axes.get_ylim()
    grow = max(0.0, (span - (high - low)) / 2)
    axes.set_ylim(low - grow, high + grow)


def main() -> None:
    parser = new_parser(__doc__)
    parser.add_argument("run", nargs="?", type=Path, default=DEFAULT_RUN, metavar="RUN_DIR", help=f"default: {DEFAULT_RUN}")
    options = parse(parser)
    run = Run(options.run)
    rows = run.columns
    if not len(rows["time"]):
        stop(f"{run.folder}: no row of diagnostics yet")
    figure, panels = plt.subplots(2, 2, figsize=(12, 7.5), sharex=True, dpi=130, layout="constrained")
    for axes, draw in zip(panels.flat, (plot_energy, plot_momentum, plot_rates, plot_speed), strict=True):
        draw(axes, rows)
        if axes.get_legend_handles_labels()[0]:
            axes.legend()
    for axes in panels[-1]:
        axes.set_xlabel("time")
    figure.suptitle(f"{run.title} · {spaced(rows['particles'][-1])} particles", fontsize=14, parse_math=False)
    finish(figure, save_path(options.save, options.run, "diagnostics.png"), options.show)


if __name__ == "__main__":
    start(main)
