"""Compares runs in mode rewind with one in mode event: the collisions that they miss, and how that falls with the step."""

from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from run_files import BLUE, GREY, RED, stop

from particles_mpi import Run

OTHER = {"title", "time", "output"}  # parts of a scene in which the runs may differ, and keys of its collisions
OTHER_COLLISIONS = {"mode", "passes", "contact_duration"}
SETTLED = 0.2  # of the run, which is left out: the start is not the gas that is measured


def mode_of(run: Run) -> str:
    """ "event", "rewind", or nothing for a run without collisions."""
    return str(run.about.get("scene", {}).get("effects", {}).get("collisions", {}).get("mode", ""))


def compared(run: Run) -> dict[str, Any]:
    """Return the tables of the scene that all runs must share."""
    scene = run.about["scene"]
    collisions = {key: value for key, value in scene["effects"]["collisions"].items() if key not in OTHER_COLLISIONS}
    tables = {name: table for name, table in scene.items() if name not in OTHER}
    return tables | {"effects": scene["effects"] | {"collisions": collisions}}


def measured(run: Run) -> dict[str, Any]:
    """Return step, collisions per unit time with their standard error, share of missed ones, and seconds of the loop.

    The seconds are nan if the run has not ended.
    """
    rows, about = run.columns, run.about
    time = rows["time"]
    kept = time >= time[:1] + SETTLED * (time[-1:] - time[:1])
    kept[1:] &= kept[:-1]  # counts belong to the interval before their row
    kept[:1] = False
    if not kept.any():
        enough = max(1, about["scene"]["time"]["steps"] // 10)
        stop(f"{run.folder}: has too few rows of diagnostics; [output] diagnostics_every = {enough} has ten")
    length = np.diff(time, prepend=time[0])[kept]
    rates = rows["collisions"][kept] / length
    return {
        "run": str(run.folder),
        "step": about["scene"]["time"]["step"],
        "rate": rows["collisions"][kept].sum() / length.sum(),
        "error": rates.std() / np.sqrt(len(rates)),
        "missed": rows["missed"][kept].sum() / max(rows["collisions"][kept].sum(), 1),
        "seconds": about["timers"]["loop"]["max"] if "timers" in about else np.nan,
    }


def report(reference: Run, runs: list[Run]) -> tuple[str, dict[str, Any], list[dict[str, Any]]]:
    """Return (table, reference, runs from the longest step to the shortest); lost = 1 - rate/rate_event, as for Z - 1."""
    shared = compared(reference)
    for run in runs:
        if compared(run) != shared:
            may = f"only {', '.join(sorted(OTHER))}, and {', '.join(sorted(OTHER_COLLISIONS))} of collisions may differ"
            stop(f"{run.folder}: is of another scene than {reference.folder}: {may}")
    exact = measured(reference)
    if not exact["rate"]:
        stop(f"{reference.folder}: has no collisions in the last {1 - SETTLED:.0%} of its time: no run can lose any")
    found = sorted((measured(run) for run in runs), key=lambda row: -row["step"])
    names = ("step", "collisions/time", "missed of them", "lost against event", "order", "seconds")
    lines = ["{:>10} {:>16} {:>15} {:>19} {:>6} {:>8}  run".format(*names)]
    lines.append(f"{'event':>10} {exact['rate']:16.6g} {'':15} {'':19} {'':6} {exact['seconds']:8.3g}  {exact['run']}")
    for k, row in enumerate(found):
        row["lost"] = 1.0 - row["rate"] / exact["rate"]
        row["noise"] = float(np.hypot(row["error"], exact["error"])) / exact["rate"]
        order = ""
        if k and row["lost"] > 2 * row["noise"] and found[k - 1]["lost"] > 0.0:
            order = f"{np.log(found[k - 1]['lost'] / row['lost']) / np.log(found[k - 1]['step'] / row['step']):.2f}"
        lost = f"{row['lost']:.2e} +- {row['noise']:.0e}"
        start = f"{row['step']:10.4g} {row['rate']:16.6g} {row['missed']:15.2e}"
        lines.append(f"{start} {lost:>19} {order:>6} {row['seconds']:8.3g}  {row['run']}")
    return "\n".join(lines), exact, found


def draw(exact: dict[str, Any], found: list[dict[str, Any]], title: str) -> Figure:
    """Draw the lost collisions against the step, with a guide line, and against the time of the run."""
    figure, panels = plt.subplots(1, 2, figsize=(11, 4.6), dpi=130, layout="constrained", sharey=True)
    lost = np.array([abs(row["lost"]) for row in found])
    noise = np.array([row["noise"] for row in found])
    sure = lost > 2 * noise
    step, seconds = (np.array([row[name] for row in found]) for name in ("step", "seconds"))
    some = lost.max() > 0.0  # else there is nothing that a logarithm could show
    for axes, x, label in ((panels[0], step, "time step"), (panels[1], seconds, "seconds of the loop")):
        axes.errorbar(x, lost, noise, fmt="-", color=RED, capsize=3)
        axes.plot(x[sure], lost[sure], "o", color=RED, label="rewind")
        axes.plot(x[~sure], lost[~sure], "o", color=RED, mfc="white", label="rewind, below the noise")
        axes.set(xscale="log", yscale="log" if some else "linear", xlabel=label)
        axes.grid(which="both")
    panels[0].set_xticks(step, [f"{s:g}" for s in step])
    panels[0].minorticks_off()
    if lost[0] > 0.0:
        for order, style in ((1, ":"), (2, "--")):
            panels[0].plot(step, lost[0] * (step / step[0]) ** order, style, color=GREY, label=f"order {order}")
    panels[0].set_ylabel("share of collisions lost (error of Z - 1)")
    panels[1].axvline(exact["seconds"], color=BLUE, label="event")
    for axes in panels:
        axes.legend()
    figure.suptitle(title, fontsize=13, parse_math=False)
    return figure
