"""Draw the paths of a few particles, or the positions of many at the last frame, seen along the last axis.

There is one panel per run. Up to 30 particles are drawn as paths that end in a dot: between two frames a curve that fits the
velocities at both ends, or a straight line if collisions or walls turn the particle; a path that leaves through a periodic face
continues at the opposite face. More particles are drawn at their last positions, as spheres if they have radii, otherwise as
points that are brighter where there are many. `--span` leaves out particles far from the middle. In one dimension all paths are
drawn over time. Up to ten paths have their ids in a legend.

example:
    python python_viz/plot_paths.py out/figure_eight out/solar_system --save gravity.png
draws the paths of both into gravity.png
"""

from pathlib import Path
from textwrap import fill

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.colors import to_rgb
from matplotlib.patches import Rectangle
from picture import FINEST
from run_files import DASHES, PAINTS, finish, new_parser, parse, save_path, spaced, start, within
from scipy.interpolate import CubicHermiteSpline

from particles_mpi import Run
from particles_mpi.results.frame import Frame

FEW = 30
NAMED = 10  # paths at most that a legend names
COLUMNS = 3
MANY_POINTS = 4000  # points: more are drawn as small as can be
TITLE = 40  # letters in a line of a title
PIECES = 8  # of a curve between two frames
FIT = 1e-6  # of a distance: smaller errors are all the same
MUCH_BETTER = 4.0  # times smaller is the square of an error
PALER = 0.45  # times as strong are the colours when they are used again


def ids_of(frames: list[Frame]) -> np.ndarray:
    """Return the ids of all particles of the run, in their order."""
    return np.unique(np.concatenate([frame.id for frame in frames]))


def durations(frames: list[Frame], moved: np.ndarray, velocity: np.ndarray, length: np.ndarray | float) -> np.ndarray:
    """Return the time from each frame to the next, (s - 1,), also where `sim.time` was set on the way.

    If steps were as long before as after an interval, but not in it, the clock was set, or the length of steps. Then it took so
    many of these steps, unless its own times fit much better how far the particles `moved` (s - 1, n, d), but for times round a
    periodic box, at these mean velocities.
    """
    times, steps = (np.diff([getattr(frame, name) for frame in frames]) for name in ("time", "step"))
    pace = times / np.maximum(steps, 1)
    before, after = np.insert(pace[:-1], 0, pace[0]), np.append(pace[1:], pace[-1])
    usual = before * steps
    left = moved - velocity * np.array([times, usual])[:, :, None, None]
    left -= np.rint(left / np.where(length, length, np.inf)) * length
    own, other = np.nansum(left**2, axis=(2, 3)) + FIT**2 * np.nansum(moved**2, axis=(1, 2))
    return np.where(np.isclose(before, after) & (other <= MUCH_BETTER * own) & (usual > 0.0), usual, times)


def paths_of(frames: list[Frame], smooth: bool, length: np.ndarray | float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return times (s,) and positions (s, n, d) of all particles of the run; on periodic axes they may leave the box.

    smooth: velocities never jump. length (d,): of the box on periodic axes, 0 on others. Between two frames a particle goes round
    the box in the way that fits its velocities best, or the shorter way if it may have collided.
    """
    ids = ids_of(frames)
    times = np.array([frame.time for frame in frames])
    places = np.full((len(frames), len(ids), frames[0].position.shape[1]), np.nan)  # a gap where a particle was not there
    velocities = places.copy()
    for k, frame in enumerate(frames):
        here = np.searchsorted(ids, frame.id)
        places[k, here], velocities[k, here] = frame.position, frame.velocity
    moved, mean = np.diff(places, axis=0), 0.5 * (velocities[1:] + velocities[:-1])
    lasted = durations(frames, moved, mean, length) if smooth and len(times) > 1 else np.zeros(len(times) - 1)
    smooth = bool((lasted > 0.0).all()) and len(times) > 1
    expected = mean * lasted[:, None, None] * smooth
    periods = np.rint((moved - expected) / np.where(length, length, np.inf))
    places[1:] -= np.cumsum(np.nan_to_num(periods), axis=0) * length
    if not smooth or np.isnan(places).any():
        return times, places
    clock, number = np.insert(np.cumsum(lasted), 0, 0.0), np.arange(len(times))
    at = np.arange(PIECES * (len(times) - 1) + 1) / PIECES
    moments, ticks = np.interp(at, number, times), np.interp(at, number, clock)
    return moments, CubicHermiteSpline(clock, places, velocities)(ticks)


def inside(path: np.ndarray, lower: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Return a path (s, c) of straight lines inside the box, with a gap (a row of nan) where it leaves through a periodic face.

    lower, length (c,): the lower corner of the box and its length; length 0 for axes that are not periodic, and for time.
    """
    number, cuts = np.arange(len(path)), []
    for k in np.flatnonzero(length):
        cell = (path[:, k] - lower[k]) / length[k]
        for i in np.flatnonzero(np.nan_to_num(np.diff(np.floor(cell)))):  # nan where the particle was not there
            begin, end = sorted(cell[i : i + 2])
            faces = np.arange(np.ceil(begin), np.ceil(end))
            cuts.append(i + (faces - cell[i]) / (cell[i + 1] - cell[i]))

    def places(at: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(at, number, column) for column in path.T], axis=1)

    at = np.unique(np.concatenate([number, *cuts]))
    if len(at) == 1:  # a single place is a path, too
        at = np.repeat(at, 2)
    shift = np.floor((places(0.5 * (at[1:] + at[:-1])) - lower) / np.where(length, length, np.inf)) * length
    gaps = np.flatnonzero((np.diff(shift, axis=0) != 0.0).any(axis=1)) + 1
    lines = np.stack((places(at[:-1]) - shift, places(at[1:]) - shift), axis=1).reshape(-1, path.shape[1])
    return np.insert(lines, 2 * gaps, np.nan, axis=0)


def style(i: int) -> tuple[np.ndarray, str]:
    """Return the colour and the dash of path number i; 48 paths have one of their own each."""
    turn = i // len(PAINTS)
    paler = PALER if (turn + turn // 4) % 2 else 1.0
    return 1.0 - (1.0 - np.array(to_rgb(PAINTS[i % len(PAINTS)]))) * paler, DASHES[turn % 4]


def plot_few(axes: Axes, ids: np.ndarray, places: np.ndarray, lower: np.ndarray, length: np.ndarray) -> None:
    """Draw the path of each particle, and its position at the end."""
    for i, name in enumerate(ids):
        color, dash = style(i)
        path = inside(places[:, i], lower, length)
        axes.plot(path[:, 0], path[:, 1], ls=dash, lw=0.8, color=color, label=str(name))
        axes.plot(*path[-1, :2], "o", ms=5, color=color)
    if 1 < len(ids) <= NAMED:
        axes.legend(title="id", fontsize=7, title_fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0)


def plot_spheres(axes: Axes, position: np.ndarray, radius: np.ndarray) -> None:
    """Draw spheres from above, the lower ones first and darker."""
    order = np.argsort(position[:, -1]) if position.shape[1] > 2 else np.arange(len(position))
    height = np.linspace(0.25, 0.95, len(order))
    size = 2.0 * radius[order]
    spheres = EllipseCollection(size, size, 0.0, units="xy", offsets=position[order, :2], transOffset=axes.transData)
    spheres.set(facecolors=plt.get_cmap("copper")(height), edgecolors="#2a1a10", linewidths=0.3)
    axes.add_collection(spheres)


def plot_points(axes: Axes, position: np.ndarray) -> None:
    """Draw many points, on black."""
    axes.set_facecolor("black")
    size = float(np.clip(1.5 * (MANY_POINTS / max(len(position), 1)) ** 0.5, 1.5, 4.0))
    axes.plot(position[:, 0], position[:, 1], ".", ms=size, mew=0, color="#ffe8c0", alpha=0.6)


def plot(axes: Axes, run: Run, span: float, title: str) -> None:
    """Draw one run."""
    last, half, scene = run[-1], 0.0, run.about.get("scene", {})
    smooth, d = not {"collisions", "walls"} & scene.get("effects", {}).keys(), run.dimension
    box, points = scene.get("box"), last.radius == 0.0
    lower = np.array(box["lower"] if box else [0.0] * d)
    length = run.periodic_length
    if d == 1:
        moments, places = paths_of(frames := run[:], smooth, length)
        over_time = np.stack((np.repeat(moments[:, None], places.shape[1], axis=1), places[:, :, 0]), axis=2)
        plot_few(axes, ids_of(frames), over_time, np.append(0.0, lower), np.append(0.0, length))
    elif len(last.position) <= FEW:
        plot_few(axes, ids_of(frames := run[:]), paths_of(frames, smooth, length)[1], lower, length)
        if box:
            (x, y), (right, top) = box["lower"][:2], box["upper"][:2]
            axes.add_patch(Rectangle((x, y), right - x, top - y, fill=False, ec="0.6", lw=0.8, zorder=0))
        axes.margins(0.08)
    else:
        plot_spheres(axes, last.position[~points], last.radius[~points])
        if points.any():
            plot_points(axes, last.position[points])
        middle = np.median(last.position[:, :2], axis=0)
        away = np.abs(last.position[:, :2] - middle).max(axis=1) + last.radius
        half = 1.05 * float(np.quantile(away, 1.0 if not points.all() else span))
        half = max(half, FINEST * np.abs(middle).max()) or 1.0
        axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half))
    axes.grid(False)
    axes.spines[:].set_visible(True)
    if d > 1:
        axes.set_aspect("equal", adjustable="datalim" if not half else "box")
    axes.set_title(fill(title, TITLE), fontsize=10, parse_math=False)
    seen = f"{spaced(len(last.position))} at t = {last.time:g}" + (f", two of {d} axes" if d > 3 else "")
    axes.text(0.99, 0.01, seen, transform=axes.transAxes, ha="right", fontsize=8,
              bbox={"facecolor": axes.get_facecolor(), "alpha": 0.7, "lw": 0, "pad": 1},
              color="white" if d > 1 and len(last.position) > FEW and points.any() else "black")  # fmt: skip
    axes.tick_params(labelsize=7)
    across, up = ("x", "y") if d > 1 else ("t", "x")
    axes.set_xlabel(across, fontsize=8)
    axes.set_ylabel(up, fontsize=8)


def main() -> None:
    parser = new_parser(__doc__)
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN_DIR")
    parser.add_argument(
        "--span", type=within(0.01, 1), default=0.97, metavar="PART", help="part of many points that is shown (default: 0.97)"
    )
    options = parse(parser)
    columns = min(len(options.runs), COLUMNS)
    rows = -(-len(options.runs) // columns)
    figure, panels = plt.subplots(rows, columns, figsize=(3.6 * columns, 3.5 * rows), squeeze=False, layout="constrained")
    runs = [Run(folder) for folder in options.runs]
    titles = [run.title for run in runs]
    for axes, run in zip(panels.flat, runs, strict=False):
        name = f" ({run.folder.name})" if titles.count(run.title) > 1 else ""
        plot(axes, run, options.span, run.title + name)
    for axes in panels.flat[len(options.runs) :]:
        axes.remove()
    finish(figure, save_path(options.save, options.runs[0], "paths.png"), options.show)


if __name__ == "__main__":
    start(main)
