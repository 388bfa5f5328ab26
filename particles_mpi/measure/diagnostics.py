"""What a run tells about itself: energies, momentum and speeds, summed exactly over all particles of all ranks."""

from __future__ import annotations

from math import nan

import numpy as np

from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exact_sum import exact_sums
from particles_mpi.particles import Array, Particles, row_dot

TURNS = {2: ((0, 1),), 3: ((1, 2), (2, 0), (0, 1))}  # planes of the components of the angular momentum


def measure(ranks: Communicator, particles: Particles, potentials: dict[str, Array]) -> dict[str, float]:
    """Kinetic, potential and total energy, momentum and largest speed of all movable particles. Collective.

    `potentials`: the potential energy (n,) of each force that has one; with mutual gravity among them also what `attracted`
    gives. The sums are correctly rounded, so every figure is the same on any number of ranks. A potential that is not a number
    for a movable particle makes `potential` and `total_energy` nan.
    """
    movable = particles.fixed == 0
    square = row_dot(particles.velocity, particles.velocity)
    momentum = particles.mass[:, None] * particles.velocity * movable[:, None]
    columns = [0.5 * particles.mass * square * movable]
    columns += [momentum[:, k] for k in range(particles.dimension)]
    columns += [np.where(movable, u, 0.0) for u in potentials.values()]
    sums = exact_sums(ranks, columns)
    potential = float(sum(sums[1 + particles.dimension :]))
    row = {"kinetic": sums[0], "potential": potential, "total_energy": sums[0] + potential}
    names = momentum_names(particles.dimension)
    row.update(zip(names, sums[1:], strict=False))
    row["max_speed"] = float(np.sqrt(ranks.allreduce_max(square.max(initial=0.0))[0]))
    if "mutual_gravity" in potentials:
        row |= attracted(ranks, particles, row["kinetic"], potentials["mutual_gravity"])
    return row


def attracted(ranks: Communicator, p: Particles, kinetic: float, potential: Array) -> dict[str, float]:
    """Angular momentum about the origin (in two and three dimensions), centre of mass, and 2 K/|W|. Collective."""
    movable = p.fixed == 0
    mass, d = p.mass * movable, p.dimension
    columns = [potential * movable, mass, *(mass * p.position[:, k] for k in range(d))]
    for i, j in TURNS.get(d, ()):
        columns.append(mass * (p.position[:, i] * p.velocity[:, j] - p.position[:, j] * p.velocity[:, i]))
    binding, total, *sums = exact_sums(ranks, columns)
    row = dict(zip(attracted_names(d), [*sums[d:], *(x / total if total else nan for x in sums[:d])], strict=False))
    return row | {"virial_ratio": 2.0 * kinetic / abs(binding) if binding else nan}


def attracted_names(dimension: int) -> list[str]:
    """The columns of `attracted`, in order."""
    turns = [f"angular_momentum_{'xyz'[3 - i - j]}" for i, j in TURNS.get(dimension, ())]
    return [*turns, *(name.replace("momentum", "center") for name in momentum_names(dimension)), "virial_ratio"]


def momentum_names(dimension: int) -> list[str]:
    """momentum_x, _y, _z; beyond three axes momentum_0, momentum_1, ..."""
    return [f"momentum_{'xyz'[k] if dimension <= 3 else k}" for k in range(dimension)]


def columns(dimension: int, observables: bool = False, gravity: bool = False) -> list[str]:
    """The columns of diagnostics.csv, in order."""
    energies = ["kinetic", "potential", "total_energy"]
    counts = ["collisions", "wall_hits", "missed", "exchanges", "imbalance"]
    row = ["step", "time", "particles", *energies, *momentum_names(dimension), "max_speed", *counts]
    if gravity:
        row += attracted_names(dimension)
    if observables:
        from particles_mpi.measure.observables import OBSERVABLES

        row += OBSERVABLES
    return row


COUNTS = ("collisions", "wall_hits", "missed", "exchanges")
