"""Work-precision plots: error against seconds, both logarithmic, with the Pareto front and slopes to compare with."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from particles_mpi.study.experiment import Experiment, Row

COLORS = ("#0b5cad", "#c1432e", "#2f855a", "#8a5fb5", "#b7791f", "#2c7a7b", "#97266d", "#4a5568")
MARKERS = "osD^vPX*"
CENTRAL = ("C2", "A1", "B")  # keys of the picture of the README: collisions, regular orbits, close encounters
SPINES = {"axes.spines.top": False, "axes.spines.right": False, "axes.axisbelow": True}
STYLE: Any = {"svg.hashsalt": "study", "font.size": 10, **SPINES}


def draw(axes: Any, found: Experiment, title: str = "") -> None:
    """Draw one experiment into axes."""
    error = found.main_error
    for k, curve in enumerate(found.curves):
        rows = [row for row in found.curve(curve) if row.errors[error] > 0.0]
        if rows:
            style = {"color": COLORS[k % 8], "marker": MARKERS[k % 8], "ms": 5, "lw": 1.2, "capsize": 2, "zorder": 3}
            axes.errorbar(*points(rows, error), xerr=quartiles(rows), label=curve, **style)
    front = [row for row in found.front() if row.errors[error] > 0.0]
    axes.plot(*points(front, error), color="#d9b44a", lw=7, alpha=0.45, solid_capstyle="round", zorder=1, label="Pareto front")
    axes.set(xscale="log", yscale="log", ylabel=f"error in {error}")
    label_seconds(axes)
    draw_slopes(axes, found.slopes)
    if found.floor:
        axes.axhspan(axes.get_ylim()[0], found.floor, color="#999999", alpha=0.15, lw=0)
    axes.set_title(title or f"{found.key}  {found.title}", loc="left", fontsize=10.5)
    axes.grid(which="major", color="#dddddd", lw=0.6)
    axes.legend(fontsize=8, framealpha=0.9)


def draw_bars(axes: Any, found: Experiment) -> None:
    """Draw the seconds alone, where there is no error to plot."""
    rows = found.rows[::-1]
    seconds = [row.seconds.median for row in rows]
    axes.barh([row.setting.curve for row in rows], seconds, xerr=quartiles(rows), color=COLORS[0], height=0.6)
    axes.set(xscale="log")
    label_seconds(axes)
    axes.set_title(f"{found.key}  {found.title}", loc="left", fontsize=10.5)


def points(rows: Sequence[Row], error: str) -> tuple[list[float], list[float]]:
    """Seconds and errors."""
    return [row.seconds.median for row in rows], [row.errors[error] for row in rows]


def quartiles(rows: Sequence[Row]) -> list[list[float]]:
    """Lengths of the bars to the left and to the right of the median."""
    left = [max(row.seconds.median - row.seconds.low, 0.0) for row in rows]
    return [left, [row.seconds.high - row.seconds.median for row in rows]]


def label_seconds(axes: Any) -> None:
    """Seconds as plain numbers, some of them wherever the axis begins and ends."""
    low, high = axes.get_xlim()
    axes.set(xlabel="seconds (median; bars: quartiles)")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0,) if high > 60.0 * low else (1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def draw_slopes(axes: Any, slopes: Sequence[float]) -> None:
    """Dashed lines of error ~ seconds^-p, within what is plotted."""
    low, high = axes.get_xlim()
    bottom, top = axes.get_ylim()
    for p in slopes:
        x = np.geomspace(low, high, 100)
        y = top * 0.5 * (x / low) ** -p
        visible = y > bottom
        if visible.any():
            axes.plot(x[visible], y[visible], color="#888888", ls=(0, (4, 4)), lw=0.8, zorder=0)
            at = x[visible][int(visible.sum() * 0.8)], y[visible][int(visible.sum() * 0.8)]
            axes.annotate(f"slope {-p:g}", at, fontsize=7.5, color="#666666", ha="left", va="bottom")
    axes.set(xlim=(low, high), ylim=(bottom, top))


def svg(found: Experiment) -> str:
    """The plot of an experiment, to put into a page."""
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(figsize=(7.2, 4.6), layout="constrained")
        has_errors = any(row.errors[found.main_error] > 0.0 for row in found.rows)
        (draw if has_errors else draw_bars)(axes, found)
        text = io.StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None})
        plt.close(figure)
    return text.getvalue()[text.getvalue().index("<svg") :]


def central(path: Path, all_found: list[Experiment]) -> None:
    """Write the picture of the README: collisions beside gravity, as far as both were measured."""
    wanted = [found for key in CENTRAL for found in all_found if found.key == key]
    if wanted:
        with plt.rc_context(STYLE):
            figure, axes = plt.subplots(1, len(wanted), figsize=(5.2 * len(wanted), 4.4), layout="constrained", squeeze=False)
            for one, found in zip(axes[0], wanted, strict=True):
                draw(one, found, found.title)
            figure.savefig(path, dpi=110)
            plt.close(figure)
