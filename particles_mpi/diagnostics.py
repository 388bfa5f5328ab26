"""What a run tells about itself: energies, momentum and speeds, summed exactly over all particles of all ranks."""

from __future__ import annotations

import numpy as np

from particles_mpi.parallel.ranks import Ranks
from particles_mpi.parallel.sums import exact_sums
from particles_mpi.particles import Array, Particles, row_dot


def measure(ranks: Ranks, particles: Particles, potentials: list[Array]) -> dict[str, float]:
    """Kinetic, potential and total energy, momentum and largest speed of all movable particles. Collective.

    `potentials`: the potential energy (n,) of each force that has one. The sums are correctly rounded, so every figure is
    the same on any number of ranks.
    """
    movable = particles.fixed == 0
    square = row_dot(particles.velocity, particles.velocity)
    momentum = particles.mass[:, None] * particles.velocity * movable[:, None]
    columns = [0.5 * particles.mass * square * movable]
    columns += [momentum[:, k] for k in range(particles.dimension)]
    columns += [u * movable for u in potentials]
    sums = exact_sums(ranks, columns)
    potential = float(sum(sums[1 + particles.dimension :]))
    row = {"kinetic": sums[0], "potential": potential, "total_energy": sums[0] + potential}
    names = momentum_names(particles.dimension)
    row.update(zip(names, sums[1:], strict=False))
    row["max_speed"] = float(np.sqrt(ranks.largest(square.max(initial=0.0))[0]))
    return row


def momentum_names(dimension: int) -> list[str]:
    """momentum_x, _y, _z; beyond three axes momentum_0, momentum_1, ..."""
    return [f"momentum_{'xyz'[k] if dimension <= 3 else k}" for k in range(dimension)]


def columns(dimension: int, observables: bool = False) -> list[str]:
    """The columns of diagnostics.csv, in order."""
    energies = ["kinetic", "potential", "total_energy"]
    counts = ["collisions", "wall_hits", "missed", "exchanges", "imbalance"]
    row = ["step", "time", "particles", *energies, *momentum_names(dimension), "max_speed", *counts]
    if observables:
        from particles_mpi.observables import OBSERVABLES

        row += OBSERVABLES
    return row
