"""A run as it is compared with others: where all are at a few moments, energies on the way, counts at the end."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from time import perf_counter

import numpy as np

from particles_mpi import Simulation
from particles_mpi.errors import StoppedError
from particles_mpi.kernels.geometry import image_shifts
from particles_mpi.particles import Array
from particles_mpi.study.recommending.starts import Start, places

LOOKS = 4  # moments, evenly over the run, at which places are compared; all numbers of steps are multiples of it
ENERGIES = 32  # moments at which energies are, about


class TooLongError(StoppedError):
    """A run that takes more seconds than it was given."""


@dataclass
class Track:
    """`places` (LOOKS, N, d) and `energy` (LOOKS) at the looks; `energies` and `kinetic` at more moments, the start too;
    `collisions`, `hits`: of walls, over all; `heights`: of the centre along gravity at the looks; `seconds`: of the whole run,
    looks and all, on the slowest rank."""

    places: Array
    energy: Array
    energies: Array
    kinetic: Array
    collisions: int
    hits: int
    heights: Array
    duration: float
    seconds: float


def whole(steps: float) -> int:
    """The number of steps, not less, that the looks divide."""
    return LOOKS * max(1, int(np.ceil(steps / LOOKS * (1.0 - 1e-12))))


def follow(start: Start, sim: Simulation, patience: float = np.inf) -> Track:
    """Run a simulation to the end of its scene. Collective; TooLongError after `patience` seconds."""
    steps, ranks = sim.scene.steps, sim.ranks
    look, peek, began = steps // LOOKS, max(1, steps // ENERGIES), perf_counter()
    rows, at_looks, seen = [], [], [energy(sim)]
    while sim.steps_done < steps:
        sim.step()
        if sim.steps_done % peek == 0 or sim.steps_done == steps:
            seen.append(energy(sim))
            took = float(ranks.allreduce_max(perf_counter() - began)[0])
            if took > patience and sim.steps_done < steps:
                raise TooLongError(f"longer than {patience:.3g} s")
        if sim.steps_done % look == 0:
            rows.append(places(ranks, sim))
            at_looks.append(energy(sim)[0])
    sim.watch()
    counts = ranks.allreduce_sum(np.array([sim.totals["collisions"], sim.totals["wall_hits"]], np.int64)).tolist()
    found = np.array(rows).reshape(LOOKS, start.total, sim.scene.dimension)
    size = float(np.sqrt((sim.g**2).sum()))
    up = -sim.g / size if size > 0.0 else sim.g
    heights = (found.mean(axis=1) * up).sum(axis=1) if start.total else np.zeros(LOOKS)
    table: Array = np.array(seen)
    took = float(ranks.allreduce_max(perf_counter() - began)[0])
    return Track(found, np.array(at_looks), table[:, 0], table[:, 1], counts[0], counts[1], heights, steps * sim.h, took)


def energy(sim: Simulation) -> tuple[float, float]:
    """Total and kinetic; the kinetic alone where a force along a periodic axis leaves the total without a meaning."""
    row = sim.measure()
    return row["total_energy"] if isfinite(row["total_energy"]) else row["kinetic"], row["kinetic"]


def apart(one: Array, other: Array, length: Array) -> float:
    """The largest distance of any particle in one from itself in the other, over all looks; the shorter way round."""
    away = one - other
    away -= image_shifts(away, length)
    return float(np.sqrt((away**2).sum(axis=-1)).max(initial=0.0))


def extrapolated(column: list[Array]) -> tuple[Array, float]:
    """The limit of values at steps h, h/2, h/4 ... with an error in even powers of h (Romberg), and how much it may be wrong.

    Where higher powers do not help (corners in a motion) fewer are taken: those whose last two values are closest.
    """
    rows: list[list[Array]] = [[column[0]]]
    for value in column[1:]:
        row: list[Array] = [value]
        for k, before in enumerate(rows[-1], 1):
            row.append(row[-1] + (row[-1] - before) / (4.0**k - 1.0))
        rows.append(row)
    last, earlier = rows[-1], rows[-2]
    changes = [float(np.abs(last[k] - earlier[k]).max(initial=0.0)) for k in range(len(earlier))]
    best = int(np.argmin(changes))
    return last[best], changes[best]
