"""The figure of `study scaling`: strong scaling, efficiency, shares of phases, and how the model goes on."""

from __future__ import annotations

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from particles_mpi.study.scaling.performance_model import Model
from particles_mpi.study.scaling.report import Curve, Result, shares

COURSE = {4: 148.0, 8: 37.9, 16: 10.3, 32: 3.13, 64: 1.036}  # cores: seconds of 500 steps, as the course code printed
COURSE_STEPS, COURSE_LABEL = 500, "course code, N = 32000, Xeon Gold 6230"
COLORS = ("#2e86ab", "#1b4965", "#d1495b")  # of the curves: strong ones first, the weak one last
GREY = "#b6bcc6"
MOST = 7  # phases with a colour of their own


def draw(result: Result) -> Figure:
    """Four panels; three without a model."""
    panels = [draw_times, draw_efficiency, draw_phases]
    if model := result.model:
        panels.append(lambda axes, result: draw_model(axes, result, model))
    figure = Figure(figsize=(12, 9), dpi=130, layout="constrained")
    for panel, axes in zip(panels, figure.subplots(2, 2).flat, strict=False):
        panel(axes, result)
        axes.spines[["top", "right"]].set_visible(False)
    for axes in figure.axes[len(panels) :]:
        axes.remove()
    figure.suptitle(result.title or "untitled scene", fontsize=14)
    return figure


def color_of(result: Result, curve: Curve) -> str:
    """Of a curve, in all panels."""
    strong = [c for c in result.curves if not c.weak]
    return COLORS[-1] if curve.weak else COLORS[strong.index(curve)]


def against_ranks(axes: Axes, ranks: list[int]) -> None:
    """Ranks on a log axis, as whole numbers."""
    axes.set_xscale("log", base=2)
    axes.set_xticks(ranks, [str(n) for n in ranks])
    axes.minorticks_off()
    axes.set_xlabel("ranks")
    axes.margins(x=0.08)
    axes.grid(color="#e3e6ea", lw=0.7)


def draw_points(axes: Axes, curve: Curve, values: list[tuple[float, float, float]], color: str) -> None:
    """Median and quartiles against ranks; hollow where ranks shared cores."""
    ranks = [p.ranks for p in curve.points]
    middle, low, high = np.array(values).T
    spread = np.abs([middle - low, high - middle])
    axes.errorbar(ranks, middle, spread, color=color, lw=1.5, capsize=3, label=curve.name)
    for p, value in zip(curve.points, middle, strict=True):
        axes.plot(p.ranks, value, "o", color=color, mfc="white" if p.oversubscribed else color)
    shared = [p.oversubscribed for p in curve.points]
    if any(shared) and not any("hollow" in str(line.get_label()) for line in axes.lines):
        axes.plot([], [], "o", color=GREY, mfc="white", label="hollow: oversubscribed")


def draw_times(axes: Axes, result: Result) -> None:
    """Seconds of a step at a fixed size, against the ideal."""
    ranks = {p.ranks for p in result.points}
    for curve in result.curves:
        if not curve.weak:
            draw_points(axes, curve, [(p.seconds, p.low, p.high) for p in curve.points], color_of(result, curve))
            ends = np.array([1, max(ranks)])
            axes.plot(ends, curve.points[0].seconds / ends, "--", color=GREY)
    axes.plot([], [], "--", color=GREY, label="ideal")
    if result.headline:
        axes.plot(
            list(COURSE), [t / COURSE_STEPS for t in COURSE.values()], "s-", color="#8d99ae", lw=1, ms=4, label=COURSE_LABEL
        )
        ranks |= set(COURSE)
    axes.set_yscale("log")
    axes.set(ylabel="seconds a step: median, quartiles")
    axes.set_title("strong scaling", loc="left")
    against_ranks(axes, sorted(ranks))
    axes.set_ylim(top=axes.get_ylim()[1] * 8.0)  # room for the legend
    axes.legend(frameon=False, fontsize=9, loc="upper right")


def draw_efficiency(axes: Axes, result: Result) -> None:
    """Of all curves."""
    top = 1.15
    for curve in result.curves:
        values = [result.efficiency(curve, p) for p in curve.points]
        # a quartile of the time on P ranks; that on one rank is taken as it is
        spread = [(e, e * p.seconds / p.high, e * p.seconds / p.low) for e, p in zip(values, curve.points, strict=True)]
        draw_points(axes, curve, spread, color_of(result, curve))
        top = max(top, 1.1 * max(values))
    axes.axhline(1.0, ls="--", color=GREY)
    axes.set(ylim=(0, min(top, 3.0)), ylabel="efficiency")
    axes.set_title("efficiency: T1 / (P TP) strong, T1 / TP weak", loc="left")
    against_ranks(axes, sorted({p.ranks for p in result.points}))
    axes.legend(frameon=False, fontsize=9, loc="lower left")


def draw_phases(axes: Axes, result: Result) -> None:
    """Shares of the step, a bar for each point, curve by curve."""
    points = [(curve, p) for curve in result.curves for p in curve.points]
    rows = shares([p for _, p in points], MOST)
    heights = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    colors = [colormaps["viridis"](x) for x in np.linspace(0.1, 0.9, len(heights) - 1)] + [GREY]
    gaps = [result.curves.index(curve) for curve, _ in points]  # between the curves
    places, bottom = np.arange(len(points)) + 0.6 * np.array(gaps), np.zeros(len(points))
    for (name, height), color in zip(heights.items(), colors, strict=True):
        axes.bar(places, height, bottom=bottom, color=color, label=name, width=0.8)
        bottom = bottom + height
    axes.set_xticks(places, [f"{p.ranks}{'*' * p.oversubscribed}" for _, p in points])
    for number, curve in enumerate(result.curves):
        own = [place for place, gap in zip(places, gaps, strict=True) if gap == number]
        axes.text(float(np.mean(own)), 1.02, curve.name, ha="center", va="bottom", fontsize=8)
    star = "   * oversubscribed" if any(p.oversubscribed for _, p in points) else ""
    axes.set(xlabel=f"ranks{star}", ylabel="share of a step, mean over ranks")
    axes.set_title("phases", loc="left", pad=18)
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(handles[::-1], labels[::-1], frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1, 1))


def draw_model(axes: Axes, result: Result, model: Model) -> None:
    """The model to many ranks, dashed, through the measured points."""
    for curve in result.curves:
        seconds = [(ranks, sum(parts.values())) for c, ranks, parts, _ in result.predictions(model) if c is curve]
        axes.plot(*zip(*seconds, strict=True), "--", color=color_of(result, curve), label=f"model: {curve.name}")
        for p in curve.points:
            face = "white" if p.oversubscribed else color_of(result, curve)
            axes.plot(p.ranks, p.seconds, "o", color=color_of(result, curve), mfc=face)
    axes.plot([], [], "o", color=GREY, label="measured")
    axes.set_yscale("log")
    axes.set(ylabel="seconds a step")
    axes.set_title(result.origin(model), loc="left", fontsize=10)
    against_ranks(axes, [1 << k for k in range(0, 11, 2)])
    axes.legend(frameon=False, fontsize=8)
