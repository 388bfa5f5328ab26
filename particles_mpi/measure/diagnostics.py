"""The columns of `diagnostics.csv`: energies, momentum and speeds, summed exactly over the particles of all ranks."""

from __future__ import annotations

from math import nan

import numpy as np

from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exact_sum import exact_sums
from particles_mpi.particles import Array, Particles, row_dot

COUNTS = ("collisions", "wall_hits", "missed", "exchanges")  # of what happened since the row before
ROTATION_PLANES = {2: ((0, 1),), 3: ((1, 2), (2, 0), (0, 1))}  # of the components of the angular momentum, by dimension


def measure(ranks: Communicator, particles: Particles, potentials: dict[str, Array]) -> dict[str, float]:
    """Kinetic, potential and total energy, momentum and largest speed of all movable particles. Collective.

    `potentials`: the potential energy (n,) of this rank's particles for each force that has one, by name; with mutual gravity
    the columns of `measure_gravity` are added. Sums are correctly rounded, and so the same on any number of ranks. If a movable
    particle has a potential of nan, `potential` and `total_energy` are nan.
    """
    movable = particles.fixed == 0
    square = row_dot(particles.velocity, particles.velocity)
    momentum = particles.mass[:, None] * particles.velocity * movable[:, None]
    columns = [0.5 * particles.mass * square * movable]
    columns += [momentum[:, k] for k in range(particles.dimension)]
    columns += [np.where(movable, u, 0.0) for u in potentials.values()]
    kinetic, *sums = exact_sums(ranks, columns)
    potential = float(sum(sums[particles.dimension :]))
    row = {"kinetic": kinetic, "potential": potential, "total_energy": kinetic + potential}
    names = momentum_names(particles.dimension)
    row.update(zip(names, sums, strict=False))
    row["max_speed"] = float(np.sqrt(ranks.allreduce_max(square.max(initial=0.0))[0]))
    if "mutual_gravity" in potentials:
        row |= measure_gravity(ranks, particles, row["kinetic"], potentials["mutual_gravity"])
    return row


def measure_gravity(ranks: Communicator, p: Particles, kinetic: float, potential: Array) -> dict[str, float]:
    """Angular momentum about the origin (in two and three dimensions), centre of mass, and 2 K/|W|. Collective."""
    movable = p.fixed == 0
    mass, d = p.mass * movable, p.dimension
    columns = [potential * movable, mass, *(mass * p.position[:, k] for k in range(d))]
    for i, j in ROTATION_PLANES.get(d, ()):
        columns.append(mass * (p.position[:, i] * p.velocity[:, j] - p.position[:, j] * p.velocity[:, i]))
    binding, total, *sums = exact_sums(ranks, columns)
    row = dict(zip(gravity_names(d), [*sums[d:], *(x / total if total else nan for x in sums[:d])], strict=False))
    return row | {"virial_ratio": 2.0 * kinetic / abs(binding) if binding else nan}


def gravity_names(dimension: int) -> list[str]:
    """The columns of `measure_gravity`, in order."""
    momenta = [f"angular_momentum_{'xyz'[3 - i - j]}" for i, j in ROTATION_PLANES.get(dimension, ())]
    return [*momenta, *(name.replace("momentum", "center") for name in momentum_names(dimension)), "virial_ratio"]


def momentum_names(dimension: int) -> list[str]:
    """momentum_x, _y, _z; beyond three axes momentum_0, momentum_1, ..."""
    return [f"momentum_{'xyz'[k] if dimension <= 3 else k}" for k in range(dimension)]


def columns(dimension: int, observables: bool = False, gravity: bool = False) -> list[str]:
    """The columns of diagnostics.csv, in order."""
    energies = ["kinetic", "potential", "total_energy"]
    row = ["step", "time", "particles", *energies, *momentum_names(dimension), "max_speed", *COUNTS, "imbalance"]
    if gravity:
        row += gravity_names(dimension)
    if observables:
        from particles_mpi.measure.observables import OBSERVABLES

        row += OBSERVABLES
    return row
