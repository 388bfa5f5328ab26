"""The columns of `diagnostics.csv`: energies, momentum and speeds, summed exactly over the particles of all ranks."""

from math import nan

import numpy as np

from particles_mpi.contacts.drift import COUNTS
from particles_mpi.measure.observables import OBSERVABLES
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exact_sum import exact_sums
from particles_mpi.particles import Array, Particles, row_dot

ROTATION_PLANES = {2: ((0, 1),), 3: ((1, 2), (2, 0), (0, 1))}  # of the components of the angular momentum, by dimension


def measure(ranks: Communicator, particles: Particles, potentials: dict[str, Array]) -> dict[str, float]:
    """Kinetic, potential and total energy, momentum and largest speed of all movable particles. Collective.

    `potentials`: the potential energy (n,) of this rank's particles for each force that has one, by name; with mutual gravity
    the columns of `measure_gravity` are added. Sums are correctly rounded, and so the same on any number of ranks. If a movable
    particle has a potential of nan, `potential` and `total_energy` are nan.
    """
    d, movable = particles.dimension, particles.fixed == 0
    square = row_dot(particles.velocity, particles.velocity)
    momentum = particles.mass[:, None] * particles.velocity * movable[:, None]
    columns = [0.5 * particles.mass * square * movable, *(momentum[:, k] for k in range(d))]
    kinetic, *sums = exact_sums(ranks, columns + [np.where(movable, u, 0.0) for u in potentials.values()])
    potential = float(sum(sums[d:]))
    row = {"kinetic": kinetic, "potential": potential, "total_energy": kinetic + potential}
    row |= dict(zip(momentum_names(d), sums))
    row["max_speed"] = float(np.sqrt(ranks.allreduce_max(square.max(initial=0.0))[0]))
    if "mutual_gravity" in potentials:
        row |= measure_gravity(ranks, particles, kinetic, potentials["mutual_gravity"])
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
    row = ["step", "time", "particles", "kinetic", "potential", "total_energy", *momentum_names(dimension), "max_speed"]
    row += [*COUNTS, "imbalance", *(gravity_names(dimension) if gravity else ())]
    return [*row, *(OBSERVABLES if observables else ())]
