"""The curves of a run: the columns of diagnostics.csv over time, in a few panels."""

from __future__ import annotations

from typing import Any

import numpy as np

from particles_mpi.particles import Array

MOST_ROWS = 800  # of a curve: longer tables are thinned, counts summed up
SHORT_NAMES = {"total_energy": "total", "max_speed": "fastest particle", "wall_hits": "wall hits"}
ENERGIES = ("kinetic", "rotational", "potential", "total_energy")  # the second where spheres turn
EVENTS = ("collisions", "wall_hits", "missed")


def curves(rows: dict[str, Array]) -> list[dict[str, Any]]:
    """Panels of curves: {"title", "time": (rows,), "lines": {name: (rows,)}}. Counts are per unit time, since the row before."""
    time = rows.get("time", np.zeros(0))
    if len(time) < 2:
        return []
    group = 1 + len(time) // MOST_ROWS
    edges, events = rates(rows, MOST_ROWS)
    panels = [
        _panel("energy", edges, {n: rows[n][::group] for n in ENERGIES if n in rows}),
        _panel("momentum", edges, {n: row[::group] for n, row in rows.items() if n.startswith("momentum_")}),
        _panel("speed", edges, {"max_speed": rows["max_speed"][::group]}),
        _panel("events per unit time", edges[1:], {n: row for n, row in events.items() if row.any()}),
    ]
    return [panel for panel in panels if panel["lines"] and len(panel["time"]) > 1]


def rates(rows: dict[str, Array], most: int) -> tuple[Array, dict[str, Array]]:
    """(moments (n + 1,), {name: (n,)}): events per unit time between these moments, n being at most about `most`."""
    group = 1 + len(rows["time"]) // most
    edges = rows["time"][::group]
    end = (len(edges) - 1) * group + 1
    lasting = np.diff(edges)
    lasting = np.where(lasting > 0.0, lasting, np.inf)  # the user has set the clock back: no rate is known for that interval
    counts = {name: np.add.reduceat(rows[name][:end], np.arange(1, end, group)) for name in EVENTS}
    return edges, {name: row / lasting for name, row in counts.items()}


def _panel(title: str, time: Array, lines: dict[str, Array]) -> dict[str, Any]:
    """Without curves that are not numbers everywhere: a force along a periodic axis has no potential."""
    numbers = {name: line for name, line in lines.items() if np.isfinite(line).all()}
    shown = {SHORT_NAMES.get(name, name.removeprefix("momentum_")): _rounded(line) for name, line in numbers.items()}
    return {"title": title, "time": _rounded(time), "lines": shown}


def _rounded(values: Array) -> list[float]:
    """With as many digits as a curve shows."""
    return [float(f"{value:.6g}") for value in values]
