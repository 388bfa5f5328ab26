"""Draw how a run spends its time, and how it scales with MPI ranks, from the phase timers in run.json.

For one run: a bar for each phase (mean over ranks, with a line from the fastest to the slowest rank) and its share of the loop.
For several runs of one scene on different numbers of ranks: stacked bars of the phases, strong scaling and the ideal, and
efficiency. With --weak the runs are taken to have a constant load per rank: ideal is a constant time, efficiency = T1 / Tp.

examples:
    python python_viz/plot_phases.py out/marbles
    python python_viz/plot_phases.py out/ranks1 out/ranks2 out/ranks4
    python python_viz/plot_phases.py --weak out/weak1 out/weak2 out/weak4
draws into phases.png (one run), strong_scaling.png or weak_scaling.png in plots/ of the first run
"""

from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator
from run_files import BLUE, DEFAULT_RUN, RED, finish, new_parser, parse, save_path, start, stop

from particles_mpi import Run

MOST = 8  # phases with a colour of their own in stacked bars
LIGHT = "#b6bcc6"


class Timing:
    """The timers of one run, in seconds: {"min", "mean", "max"} over ranks; `phases` are parts of the `loop`, after `setup`.

    words: for the names of phases, as in the table at the end of a run; first: the step from which the times count, above 0 if
    the run was continued; rest: time of the loop outside all phases.
    """

    def __init__(self, run: Run):
        self.run, info = run, run.about
        try:
            self.phases: dict[str, dict[str, float]] = dict(info["timers"])
            self.setup, self.loop = (self.phases.pop(name) for name in ("setup", "loop"))
            self.ranks = int(info["ranks"])
        except KeyError as name:
            stop(f"no {name} in {run.folder / 'run.json'} (it is written when a run ends)")
        self.words, self.first = info.get("phases", {}), info.get("timed_from", 0)
        self.rest = max(0.0, self.loop["mean"] - sum(phase["mean"] for phase in self.phases.values()))


def odd_one(timings: list[Timing]) -> Path | None:
    """Return the folder of the first run that is of another scene than the first one, or of which other steps were timed."""
    first, *others = ((t.run.folder, t.run.about["scene"], t.first, t.run.about["counts"]["steps"]) for t in timings)
    return next((folder for folder, *what in others if what != list(first[1:])), None)


def draw_one(timing: Timing) -> Figure:
    """Draw horizontal bars of the phases, longest first, then the time outside phases, then setup (not part of the loop)."""
    phases = sorted(timing.phases.items(), key=lambda item: -item[1]["mean"])
    rest = dict.fromkeys(("min", "mean", "max"), timing.rest)
    outside = [("not in a phase", rest)] * (timing.rest > 1e-3 * timing.loop["mean"]) + [("setup", timing.setup)]
    bars = [*phases, *outside]
    colors = [BLUE] * len(phases) + [LIGHT] * len(outside)
    figure, axes = plt.subplots(figsize=(9.5, 1.6 + 0.42 * len(bars)), dpi=130, layout="constrained")
    longest = max(bar["max"] for _, bar in bars)
    for row, ((name, bar), color) in enumerate(zip(bars, colors, strict=True)):
        axes.barh(row, bar["mean"], color=color, height=0.68)
        if bar["max"] > bar["min"]:
            axes.plot([bar["min"], bar["max"]], [row, row], "-", color="#222222", lw=1.4, marker="|", ms=8)
        share = "" if name == "setup" else f"   {bar['mean'] / timing.loop['mean']:.1%}" if timing.loop["mean"] else ""
        axes.text(max(bar["max"], bar["mean"]) + 0.015 * longest, row, f"{bar['mean']:.3g} s{share}", va="center", fontsize=9)
    axes.set_yticks(range(len(bars)), [timing.words.get(name, name) for name, _ in bars])
    axes.invert_yaxis()
    axes.set(xlabel="seconds: mean over ranks (bar), fastest to slowest rank (line); share of the loop")
    axes.set_xlim(0, 1.2 * longest or 1)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="y", visible=False)
    ranks = f"{timing.ranks} rank" + "s" * (timing.ranks != 1)
    part = f" from step {timing.first} on" if timing.first else ""
    axes.set_title(f"{timing.run.title} · {ranks} · loop{part} {timing.loop['mean']:.3g} s", fontsize=13, parse_math=False)
    return figure


def draw_stack(axes: Axes, timings: list[Timing]) -> None:
    """Draw a bar for each run with stacked phases; those beyond the longest MOST, and time outside phases, are grey on top."""
    total: dict[str, float] = {}
    for timing in timings:
        for name, phase in timing.phases.items():
            total[name] = total.get(name, 0) + phase["mean"]
    names = sorted(total, key=lambda name: -total[name])[:MOST]
    bottom = np.zeros(len(timings))
    heights = [np.array([timing.phases.get(name, {"mean": 0})["mean"] for timing in timings]) for name in names]
    others = np.array([timing.loop["mean"] for timing in timings]) - sum(heights)
    colors = [plt.cm.viridis(x) for x in np.linspace(0.1, 0.9, len(names))] + [LIGHT]
    for name, height, color in zip([*names, "the rest"], [*heights, np.maximum(others, 0)], colors, strict=True):
        axes.bar(range(len(timings)), height, bottom=bottom, color=color, label=timings[0].words.get(name, name), width=0.7)
        bottom += height
    axes.set_xticks(range(len(timings)), [str(timing.ranks) for timing in timings])
    axes.set(xlabel="ranks", ylabel="seconds in the loop (mean over ranks)")
    axes.set_title("phases")
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(handles[::-1], labels[::-1], fontsize=9, loc="upper left", bbox_to_anchor=(1, 1))


def draw_scaling(time_axes: Axes, efficiency_axes: Axes, timings: list[Timing], weak: bool) -> None:
    """Draw loop time of the slowest rank, and efficiency, against ranks; all relative to the run on the fewest ranks."""
    ranks = np.array([timing.ranks for timing in timings])
    times = np.array([timing.loop["max"] for timing in timings])
    reference = times[ranks == ranks.min()].min()
    ideal = np.full(len(ranks), reference) if weak else reference * ranks.min() / ranks
    time_axes.plot(ranks, ideal, "--", color=LIGHT, label="ideal")
    time_axes.plot(ranks, times, "o-", color=BLUE, label="measured")
    for rank, time in zip(ranks, times, strict=True):
        time_axes.annotate(f"{time:.3g}", (rank, time), xytext=(5, 6), textcoords="offset points", fontsize=9)
    time_axes.set(ylabel="seconds in the loop (slowest rank)")
    time_axes.set_title("weak scaling" if weak else "strong scaling")
    if weak:
        time_axes.set_ylim(0, 1.15 * times.max())
    else:
        time_axes.set_yscale("log")
        time_axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        time_axes.yaxis.set_major_formatter("{x:g}")
    time_axes.legend(loc="lower left")
    efficiency_axes.axhline(1, ls="--", color=LIGHT)
    efficiency_axes.plot(ranks, ideal / times, "o-", color=RED)
    for rank, value in zip(ranks, ideal / times, strict=True):
        efficiency_axes.annotate(f"{value:.0%}", (rank, value), xytext=(5, 6), textcoords="offset points", fontsize=9)
    efficiency_axes.set(ylim=(0, max(1.15, 1.1 * (ideal / times).max())))
    efficiency_axes.set_title("efficiency = " + ("T1 / Tp" if weak else "T1 / (p Tp)").replace("1", str(ranks.min())))
    for axes in (time_axes, efficiency_axes):
        axes.set_xscale("log")
        axes.margins(x=0.12)
        axes.set_xticks(np.unique(ranks), [str(rank) for rank in np.unique(ranks)])
        axes.minorticks_off()
        axes.set_xlabel("ranks")


def draw_several(timings: list[Timing], weak: bool) -> Figure:
    """Draw stacked phases, scaling and efficiency side by side."""
    timings = sorted(timings, key=lambda timing: timing.ranks)
    figure, (stack, time, efficiency) = plt.subplots(1, 3, figsize=(15, 5), dpi=130, layout="constrained")
    draw_stack(stack, timings)
    draw_scaling(time, efficiency, timings, weak)
    stack.grid(visible=False)
    figure.suptitle(timings[0].run.title, fontsize=14, parse_math=False)
    return figure


def main() -> None:
    parser = new_parser(__doc__)
    parser.add_argument("runs", nargs="*", type=Path, default=[DEFAULT_RUN], metavar="RUN_DIR", help=f"default: {DEFAULT_RUN}")
    parser.add_argument("--weak", action="store_true", help="the runs have a constant load per rank")
    options = parse(parser)
    timings = [Timing(Run(run)) for run in options.runs]
    if len(timings) == 1:
        if options.weak:
            stop("--weak needs several runs")
        figure, name = draw_one(timings[0]), "phases.png"
    else:
        if not options.weak and (one := odd_one(timings)):
            stop(f"{one} is of another scene, or other steps of it were timed: strong scaling compares the same work")
        figure, name = draw_several(timings, options.weak), "weak_scaling.png" if options.weak else "strong_scaling.png"
    finish(figure, save_path(options.save, options.runs[0], name), options.show)


if __name__ == "__main__":
    start(main)
