"""Work-precision plots: error against seconds, both logarithmic, with the Pareto front and slopes to compare with."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import LogLocator

from particles_mpi.study.experiment import Experiment, Row

COLORS = ("#0b5cad", "#c1432e", "#2f855a", "#8a5fb5", "#b7791f", "#2c7a7b", "#97266d", "#4a5568")
MARKERS = "osD^vPX*"
README_KEYS = ("C2", "A1", "B")  # keys of the picture of the README: collisions, regular orbits, close encounters
SPINES = {"axes.spines.top": False, "axes.spines.right": False, "axes.axisbelow": True}
PLOT_STYLE: Any = {"svg.hashsalt": "study", "font.size": 10, **SPINES}


def draw(axes: Any, found: Experiment, title: str) -> None:
    """Draw one experiment into axes; only the seconds if there is no error to plot."""
    error = found.main_error
    axes.set_title(title, loc="left", fontsize=10.5)
    if not any(row.errors[error] > 0.0 for row in found.rows):
        rows = found.rows[::-1]
        seconds, bars = seconds_and_bars(rows)
        axes.barh([row.setting.curve for row in rows], seconds, xerr=bars, color=COLORS[0], height=0.6)
        label_seconds(axes)
        return
    for k, curve in enumerate(found.curves):
        if rows := [row for row in found.curve(curve) if row.errors[error] > 0.0]:
            style = {"color": COLORS[k % 8], "marker": MARKERS[k % 8], "ms": 5, "lw": 1.2, "capsize": 2, "zorder": 3}
            seconds, bars = seconds_and_bars(rows)
            axes.errorbar(seconds, [row.errors[error] for row in rows], xerr=bars, label=curve, **style)
    front = [row for row in found.front() if row.errors[error] > 0.0]
    style = {"color": "#d9b44a", "lw": 7, "alpha": 0.45, "solid_capstyle": "round", "zorder": 1}
    axes.plot(seconds_and_bars(front)[0], [row.errors[error] for row in front], label="Pareto front", **style)
    axes.set(yscale="log", ylabel=f"error in {error}")
    label_seconds(axes)
    draw_slopes(axes, found.slopes)
    if found.floor:
        axes.axhspan(axes.get_ylim()[0], found.floor, color="#999999", alpha=0.15, lw=0)
    axes.grid(which="major", color="#dddddd", lw=0.6)
    axes.legend(fontsize=8, framealpha=0.9)


def seconds_and_bars(rows: Sequence[Row]) -> tuple[list[float], list[list[float]]]:
    """Return the seconds, and the lengths of their error bars to the left and to the right."""
    left = [max(row.seconds.median - row.seconds.low, 0.0) for row in rows]
    return [row.seconds.median for row in rows], [left, [row.seconds.high - row.seconds.median for row in rows]]


def label_seconds(axes: Any) -> None:
    """Label a log axis of seconds with plain numbers, some of them wherever the axis begins and ends."""
    axes.set(xscale="log", xlabel="seconds (median; bars: quartiles)")
    low, high = axes.get_xlim()
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0,) if high > 60.0 * low else (1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter("")


def draw_slopes(axes: Any, slopes: Sequence[float]) -> None:
    """Draw dashed lines of error ~ seconds^-p within the range of the plot."""
    low, high = axes.get_xlim()
    bottom, top = axes.get_ylim()
    for p in slopes:
        x = np.geomspace(low, high, 100)
        y = top * 0.5 * (x / low) ** -p
        x, y = x[y > bottom], y[y > bottom]
        if len(x):
            axes.plot(x, y, color="#888888", ls=(0, (4, 4)), lw=0.8, zorder=0)
            at = int(len(x) * 0.8)
            axes.annotate(f"slope {-p:g}", (x[at], y[at]), fontsize=7.5, color="#666666", ha="left", va="bottom")
    axes.set(xlim=(low, high), ylim=(bottom, top))


def svg(found: Experiment) -> str:
    """Return the plot of an experiment as SVG, for a page."""
    with plt.rc_context(PLOT_STYLE):
        figure, axes = plt.subplots(figsize=(7.2, 4.6), layout="constrained")
        draw(axes, found, f"{found.key}  {found.title}")
        text = io.StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None})
        plt.close(figure)
    return text.getvalue()[text.getvalue().index("<svg") :]


def draw_for_readme(path: Path, all_found: list[Experiment]) -> None:
    """Write the picture of the README: collisions and gravity, if they were measured."""
    wanted = [found for key in README_KEYS for found in all_found if found.key == key]
    if wanted:
        with plt.rc_context(PLOT_STYLE):
            figure, axes = plt.subplots(1, len(wanted), figsize=(5.2 * len(wanted), 4.4), layout="constrained", squeeze=False)
            for one, found in zip(axes[0], wanted, strict=True):
                draw(one, found, found.title)
            figure.savefig(path, dpi=110)
            plt.close(figure)
