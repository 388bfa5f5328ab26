"""Compare two runs of the same scene, particle by particle: have they the same bits, and if not, how do they diverge?

Frames are matched by their time; of several at one time, because `sim.time` was set, by their step. The first frame with any
differing bit is printed with the particles and fields that differ; the picture shows the largest and the rms difference of
position and velocity over time (across periodic faces, the short way).

example:
    python python_viz/compare_runs.py out/ranks1 out/ranks4
prints "same bits" (exit code 0) or the first difference (exit code 1) and draws out/ranks1/plots/compare_runs.png

Runs of the same scene in mode rewind with several steps can be compared with one in mode event: by the collisions that they lose,
and by the order in the step with which that number falls. Seconds are "nan" for a run that has not ended.

    python python_viz/compare_runs.py out/event out/dt0.1 out/dt0.05 out/dt0.025
"""

from pathlib import Path

import against_event
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from run_files import BLUE, GREY, RED, finish, new_parser, parse, save_path, start, stop

from particles_mpi import Run
from particles_mpi.results.frame import Frame

CURVES = {"position": BLUE, "velocity": RED}


def matching(a: Run, b: Run) -> list[tuple[int, int]]:
    """Return the pairs of frames at the same time (to 1e-9 of the duration, so that 0.1 + 0.2 meets 0.3).

    If the other run has several frames at that time, the one whose step is the nearest is taken.
    """
    frames_a, frames_b = a[:], b[:]
    times, steps = np.array([frame.time for frame in frames_b]), np.array([frame.step for frame in frames_b])
    close = 1e-9 * max(np.ptp([frame.time for frame in frames_a]), np.ptp(times))
    pairs = []
    for i, frame in enumerate(frames_a):
        at_time = np.flatnonzero(np.abs(times - frame.time) <= close)
        if len(at_time):
            pairs.append((i, int(at_time[np.argmin(np.abs(steps[at_time] - frame.step))])))
    return pairs


def same_bits(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """For each row: equal to the last bit, and of the same type? NaN equals the same NaN; -0.0 differs from 0.0."""
    if a.dtype != b.dtype or a.shape != b.shape or not a.size:
        return np.full(len(a), a.dtype == b.dtype and a.shape == b.shape)
    a, b = (np.ascontiguousarray(x).view(np.uint8).reshape(len(x), -1) for x in (a, b))
    same: np.ndarray = (a == b).all(axis=1)
    return same


def compare(a: Frame, b: Frame, period: np.ndarray) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return the ids that differ by field (only fields with some), and the length of the difference by field of CURVES and id."""
    common, rows_a, rows_b = np.intersect1d(a.id, b.id, return_indices=True)
    all_a, all_b = ({name: frame[name] for name in frame.fields} for frame in (a, b))
    differ = {"presence": np.setxor1d(a.id, b.id)}
    for name in sorted(all_a.keys() ^ all_b.keys()):
        differ[f"presence of {name}"] = common
    lengths = {}
    for name in sorted(all_a.keys() & all_b.keys()):
        of_a, of_b = all_a[name][rows_a], all_b[name][rows_b]
        differ[name] = common[~same_bits(of_a, of_b)]
        if name in CURVES:
            shift = of_a - of_b
            if name == "position":
                wraps = period > 0
                shift[:, wraps] -= period[wraps] * np.round(shift[:, wraps] / period[wraps])
            lengths[name] = np.linalg.norm(shift, axis=1)
    return {name: ids for name, ids in differ.items() if len(ids)}, lengths


def describe(frame: Frame, differ: dict[str, np.ndarray]) -> str:
    """Return one line: the frame, how many particles differ in which fields, and the first of their ids."""
    ids = np.unique(np.concatenate(list(differ.values())))
    fields = ", ".join(f"{name} of {len(rows)}" for name, rows in differ.items())
    shown = " ".join(map(str, ids[:12])) + (" ..." if len(ids) > 12 else "")
    return f"first difference: frame {frame.index}, t = {frame.time:.6g}: {fields} particles: ids {shown}"


def refuse_other_dimensions(a: Run, b: Run) -> None:
    """End the script if the runs have other dimensions, or only one of them tells its own."""
    for run in (a, b):
        if "scene" not in run.about and a.dimension != b.dimension:
            stop(f"{run.folder}: has no run.json, which tells in how many dimensions it is")
    if a.dimension != b.dimension:
        stop(f"the runs are in {a.dimension} and in {b.dimension} dimensions")


def draw(times: np.ndarray, curves: dict[str, np.ndarray], radius: float, title: str, first: str | None) -> Figure:
    """Draw largest and rms difference over time, one panel for position and one for velocity; zeros are not drawn.

    first: the line about the first difference of all, if there is one.
    """
    figure, panels = plt.subplots(2, 1, figsize=(9, 7), sharex=True, dpi=130, layout="constrained")
    for axes, (name, color) in zip(panels, CURVES.items(), strict=True):
        largest, rms = np.ma.masked_equal(curves[name], 0).T
        if largest.count():
            axes.semilogy(times, largest, "o-", ms=3, color=color, label="largest")
            axes.semilogy(times, rms, "s--", ms=3, color=color, alpha=0.6, label="rms over particles")
            if name == "position" and radius > 0:
                axes.axhline(radius, color=GREY, ls=":", label="smallest radius")
            axes.legend()
        else:
            text = "none in any frame, of particles that are in both runs"
            axes.text(0.5, 0.5, text, ha="center", transform=axes.transAxes, color=GREY)
            axes.set_yticks([])
        axes.set_title(f"difference of {name}")
    panels[-1].set(xlabel="time", xlim=(times.min(), times.max() if times.max() > times.min() else times.min() + 1))
    figure.suptitle(title, fontsize=13, parse_math=False)
    figure.supxlabel(first or "", fontsize=9, color=GREY, wrap=True, parse_math=False)
    return figure


def main() -> None:
    parser = new_parser(__doc__)
    parser.add_argument("run_a", type=Path, metavar="RUN_A")
    parser.add_argument("run_b", type=Path, metavar="RUN_B", nargs="+")
    options = parse(parser)
    a, others = Run(options.run_a), [Run(folder) for folder in options.run_b]
    if against_event.mode_of(a) == "event" and all(against_event.mode_of(b) == "rewind" for b in others):
        table, exact, found = against_event.report(a, others)
        print(table)
        figure = against_event.draw(exact, found, f"{a.title}: rewind against event")
        finish(figure, save_path(options.save, options.run_a, "compare_runs.png"), options.show)
        return
    if len(others) > 1:
        stop("several runs are compared with one in mode event only")
    b = others[0]
    if not len(a) or not len(b):
        stop("a run has no frame yet")
    refuse_other_dimensions(a, b)
    pairs, period = matching(a, b), a.periodic_length
    if not pairs:
        stop("the two runs have no frame at the same time")
    first, radius = None, np.inf
    curves: dict[str, list[tuple[float, float]]] = {name: [] for name in CURVES}
    for i, j in pairs:
        frame = a[i]
        differ, lengths = compare(frame, b[j], period)
        if differ and first is None:
            first = describe(frame, differ)
        radius = min(radius, frame.radius.min(initial=np.inf))
        for name in CURVES:
            length = lengths.get(name, np.zeros(0))
            curves[name].append((length.max(initial=0), np.sqrt(np.mean(length**2)) if len(length) else 0))

    print(f"{len(pairs)} frames at the same time ({options.run_a}: {len(a)}, {b.folder}: {len(b)})")
    same_times = np.array_equal(a.times, b.times)
    if first:
        print(first)
        for name in CURVES:
            worst = int(np.argmax([largest for largest, _ in curves[name]]))
            largest, rms = curves[name][worst]
            print(f"largest difference of {name}: {largest:.3g} (rms {rms:.3g}) at t = {a.times[pairs[worst][0]]:.6g}")
    else:
        print("same bits" if same_times else "same bits in these frames, but the frames or their times are not the same")
    times = a.times[[i for i, _ in pairs]]
    title = f"{a.title}: {a.folder} against {b.folder}"
    figure = draw(times, {name: np.array(values) for name, values in curves.items()}, radius, title, first)
    finish(figure, save_path(options.save, options.run_a, "compare_runs.png"), options.show)
    raise SystemExit(0 if same_times and not first else 1)


if __name__ == "__main__":
    start(main)
