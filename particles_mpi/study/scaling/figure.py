"""The figure of `study scaling`: times, efficiency, phases, and the model."""

from collections.abc import Sequence
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from particles_mpi.study.scaling.performance_model import Model
from particles_mpi.study.scaling.report import EXTRAPOLATED, Curve, Result, shares

COURSE_SECONDS = {4: 148.0, 8: 37.9, 16: 10.3, 32: 3.13, 64: 1.036}  # cores: seconds of 500 steps, as the course code printed
COURSE_STEPS, COURSE_LABEL = 500, "course code, N = 32000, Xeon Gold 6230"
COLORS = ("#2e86ab", "#1b4965", "#d1495b")  # of the curves: strong ones first, the weak one last
GREY = "#b6bcc6"
TITLE_LETTERS = 60  # in a line of the title of a panel


def draw(result: Result) -> Figure:
    """Draw four panels, or three without a model."""
    figure = Figure(figsize=(12, 9), dpi=130, layout="constrained")
    panels = figure.subplot_mosaic([["times", "efficiency"], ["phases", "model" if result.model else "phases"]])
    draw_times(panels["times"], result)
    draw_efficiency(panels["efficiency"], result)
    draw_phases(panels["phases"], result)
    if result.model:
        draw_model(panels["model"], result, result.model)
    for axes in figure.axes:
        axes.spines[["top", "right"]].set_visible(False)
    figure.suptitle(result.title, fontsize=14)
    return figure


def color_of(result: Result, curve: Curve) -> str:
    return COLORS[-1] if curve.weak else COLORS[result.curves.index(curve)]


def against_ranks(axes: Axes, ranks: list[int], title: str, **legend: Any) -> None:
    """Prepare a log axis of ranks with whole numbers, which all panels but that of the phases have."""
    axes.set_xscale("log", base=2)
    axes.set_xticks(ranks, [str(n) for n in ranks])
    axes.minorticks_off()
    axes.set_xlabel("ranks")
    axes.set_title(title, loc="left", fontsize=10)
    axes.margins(x=0.08)
    axes.grid(color="#e3e6ea", lw=0.7)
    if axes.get_yscale() == "log":
        axes.set_ylim(top=axes.get_ylim()[1] * 8.0)  # room for the legend
    axes.legend(frameon=False, fontsize=8, **legend)


def draw_markers(axes: Axes, curve: Curve, values: Sequence[float], color: str) -> None:
    """Draw a marker at each point of a curve; hollow where ranks shared cores."""
    for p, value in zip(curve.points, values, strict=True):
        axes.plot(p.ranks, value, "o", color=color, mfc="white" if p.oversubscribed else color)


def draw_points(axes: Axes, result: Result, curve: Curve, values: list[tuple[float, float, float]]) -> None:
    """Draw median and quartiles against ranks."""
    color, (middle, low, high) = color_of(result, curve), np.array(values).T
    lengths = np.abs([middle - low, high - middle])
    axes.errorbar([p.ranks for p in curve.points], middle, lengths, color=color, lw=1.5, capsize=3, label=curve.name)
    draw_markers(axes, curve, middle, color)
    labels = axes.get_legend_handles_labels()[1]
    if any(p.oversubscribed for p in curve.points) and "hollow: oversubscribed" not in labels:
        axes.plot([], [], "o", color=GREY, mfc="white", label="hollow: oversubscribed")


def draw_times(axes: Axes, result: Result) -> None:
    """Draw the seconds of a step at a fixed size, and the ideal."""
    ranks = {p.ranks for p in result.points}
    for curve in (curve for curve in result.curves if not curve.weak):
        draw_points(axes, result, curve, [(p.seconds, p.low, p.high) for p in curve.points])
        ends = np.array([1, max(ranks)])
        axes.plot(ends, curve.points[0].seconds / ends, "--", color=GREY)
    axes.plot([], [], "--", color=GREY, label="ideal")
    if result.headline:
        seconds = [t / COURSE_STEPS for t in COURSE_SECONDS.values()]
        axes.plot(list(COURSE_SECONDS), seconds, "s-", color="#8d99ae", lw=1, ms=4, label=COURSE_LABEL)
        ranks |= set(COURSE_SECONDS)
    axes.set(yscale="log", ylabel="seconds a step: median, quartiles")
    against_ranks(axes, sorted(ranks), "strong scaling", loc="upper right")


def draw_efficiency(axes: Axes, result: Result) -> None:
    top = 1.15
    for curve in result.curves:
        values = [result.efficiency(curve, p) for p in curve.points]
        # a quartile of the time on P ranks; that on one rank is taken as it is
        quartiles = [(e, e * p.seconds / p.high, e * p.seconds / p.low) for e, p in zip(values, curve.points, strict=True)]
        draw_points(axes, result, curve, quartiles)
        top = max(top, 1.1 * max(values))
    axes.axhline(1.0, ls="--", color=GREY)
    axes.set(ylim=(0, min(top, 3.0)), ylabel="efficiency")
    title = "efficiency: T1 / (P TP) strong, T1 / TP weak"
    against_ranks(axes, sorted({p.ranks for p in result.points}), title, loc="lower left")


def draw_phases(axes: Axes, result: Result) -> None:
    """Draw the shares of the step, a bar for each point, curve by curve."""
    points = [(number, p) for number, curve in enumerate(result.curves) for p in curve.points]
    rows = shares([p for _, p in points])
    colors = [colormaps["viridis"](x) for x in np.linspace(0.1, 0.9, len(rows[0]) - 1)] + [GREY]
    of_curve = np.array([number for number, _ in points])
    places, bottom = np.arange(len(points)) + 0.6 * of_curve, np.zeros(len(points))  # gaps between the curves
    for name, color in zip(rows[0], colors, strict=True):
        height = np.array([row[name] for row in rows])
        axes.bar(places, height, bottom=bottom, color=color, label=name, width=0.8)
        bottom = bottom + height
    axes.set_xticks(places, [f"{p.ranks}{'*' * p.oversubscribed}" for _, p in points])
    for number, curve in enumerate(result.curves):
        axes.text(places[of_curve == number].mean(), 1.02, curve.name, ha="center", va="bottom", fontsize=8)
    star = "   * oversubscribed" if any(p.oversubscribed for _, p in points) else ""
    axes.set(xlabel=f"ranks{star}", ylabel="share of a step, mean over ranks")
    axes.set_title("phases", loc="left", fontsize=10, pad=18)
    axes.legend(reverse=True, frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1, 1))


def draw_model(axes: Axes, result: Result, model: Model) -> None:
    """Draw the model up to many ranks, dashed, with the measured points."""
    for curve in result.curves:
        color, seconds = color_of(result, curve), [model.seconds(curve.particles(ranks), ranks) for ranks in EXTRAPOLATED]
        axes.plot(EXTRAPOLATED, seconds, "--", color=color, label=f"model: {curve.name}")
        draw_markers(axes, curve, [p.seconds for p in curve.points], color)
    axes.plot([], [], "o", color=GREY, label="measured")
    axes.set(yscale="log", ylabel="seconds a step")
    against_ranks(axes, [1 << k for k in range(0, 11, 2)], fill(result.origin(model), TITLE_LETTERS), loc="upper right")
