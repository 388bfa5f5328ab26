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

from particles_mpi.study.measuring.experiment import Experiment, Row

COLORS = ("#0b5cad", "#c1432e", "#2f855a", "#8a5fb5", "#b7791f", "#2c7a7b", "#97266d", "#4a5568")
MARKERS = "osD^vPX*"
CENTRAL = ("C2", "A1", "B")  # collisions, regular and close
STYLE: Any = {
    "svg.hashsalt": "study",
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
}


def draw(axes: Any, found: Experiment, title: str = "") -> None:
    """One experiment into axes."""
    error = next(iter(found.errors))
    for k, curve in enumerate(found.curves):
        rows = [row for row in found.curve(curve) if row.errors[error] > 0.0]
        if not rows:
            continue
        x, y = [row.seconds.median for row in rows], [row.errors[error] for row in rows]
        wide = [
            [max(row.seconds.median - row.seconds.low, 0.0) for row in rows],
            [row.seconds.high - row.seconds.median for row in rows],
        ]
        axes.errorbar(x, y, xerr=wide, color=COLORS[k % 8], marker=MARKERS[k % 8], ms=5, lw=1.2, capsize=2, label=curve, zorder=3)
    front = [row for row in found.front() if row.errors[error] > 0.0]
    axes.plot(*points(front, error), color="#d9b44a", lw=7, alpha=0.45, solid_capstyle="round", zorder=1, label="Pareto front")
    axes.set(xscale="log", yscale="log", xlabel="seconds (median; bars: quartiles)", ylabel=f"error in {error}")
    readable(axes)
    guides(axes, found, error)
    if found.floor:
        axes.axhspan(axes.get_ylim()[0], found.floor, color="#999999", alpha=0.15, lw=0)
    axes.set_title(title or f"{found.key}  {found.title}", loc="left", fontsize=10.5)
    axes.grid(which="major", color="#dddddd", lw=0.6)
    axes.legend(fontsize=8, framealpha=0.9)


def readable(axes: Any) -> None:
    """Seconds as plain numbers, some of them wherever the axis begins and ends."""
    low, high = axes.get_xlim()
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0,) if high > 60.0 * low else (1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def points(rows: Sequence[Row], error: str) -> tuple[list[float], list[float]]:
    """Seconds and errors."""
    return [row.seconds.median for row in rows], [row.errors[error] for row in rows]


def guides(axes: Any, found: Experiment, error: str) -> None:
    """Dashed lines of error ~ seconds^-p, within what is plotted."""
    low, high = axes.get_xlim()
    bottom, top = axes.get_ylim()
    for p in found.slopes:
        x = np.geomspace(low, high, 100)
        y = top * 0.5 * (x / low) ** -p
        seen = y > bottom
        if seen.any():
            axes.plot(x[seen], y[seen], color="#888888", ls=(0, (4, 4)), lw=0.8, zorder=0)
            at = int(seen.sum() * 0.8)
            axes.annotate(f"slope {-p:g}", (x[seen][at], y[seen][at]), fontsize=7.5, color="#666666", ha="left", va="bottom")
    axes.set(xlim=(low, high), ylim=(bottom, top))


def svg(found: Experiment) -> str:
    """The plot of an experiment, to put into a page."""
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(figsize=(7.2, 4.6), layout="constrained")
        if any(row.errors[next(iter(found.errors))] > 0.0 for row in found.rows):
            draw(axes, found)
        else:
            bars(axes, found)
        text = io.StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None})
        plt.close(figure)
    whole = text.getvalue()
    return whole[whole.index("<svg") :]


def bars(axes: Any, found: Experiment) -> None:
    """Seconds alone, where there is no error to plot."""
    rows = found.rows[::-1]
    values = [row.seconds.median for row in rows]
    wide = [[row.seconds.median - row.seconds.low for row in rows], [row.seconds.high - row.seconds.median for row in rows]]
    axes.barh([row.setting.curve for row in rows], values, xerr=wide, color=COLORS[0], height=0.6)
    axes.set(xscale="log", xlabel="seconds (median; bars: quartiles)")
    readable(axes)
    axes.set_title(f"{found.key}  {found.title}", loc="left", fontsize=10.5)


def central(path: Path, all_found: list[Experiment]) -> None:
    """The picture of the README: collisions beside gravity, as far as both were measured."""
    wanted = [found for key in CENTRAL for found in all_found if found.key == key]
    if not wanted:
        return
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(1, len(wanted), figsize=(5.2 * len(wanted), 4.4), layout="constrained", squeeze=False)
        for one, found in zip(axes[0], wanted, strict=True):
            draw(one, found, found.title)
        figure.savefig(path, dpi=110)
        plt.close(figure)
