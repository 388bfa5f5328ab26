"""The columns of `diagnostics.csv`: energies, momentum, speeds and observables, of sums that are exact on any number of ranks.

Observables of a gas of spheres: D axes, N movable particles, T in units of energy (k = 1); rates since they were last computed.

- temperature: sum m (v - V)^2 / (D (N - 1)), with V the velocity of the centre of mass
- moment_ratio: <v^4>/<v^2>^2 of v - V; Maxwell-Boltzmann gives (1 + 2/D) n/(n + 2), n = D (N - 1)
- packing: volume of all spheres over that of the box
- collision_rate: Gamma = 2 C/(N t), collisions of a particle in unit time; free_time 1/Gamma, free_path <|v - V|>/Gamma
- z_virial: p V/(N T) = 1 + sum(-r.dp)/(D N T t) over the collisions, r from partner to partner, dp the momentum it gives
- z_rate: 1 + sigma Gamma sqrt(pi m/T)/(2 D), for equal spheres of diameter sigma and mass m; nan for others
  (Enskog; M. P. Allen and D. J. Tildesley, Computer Simulation of Liquids, 1987, for both)
"""

from math import gamma, nan, pi, sqrt
from typing import Any

import numpy as np

from particles_mpi.contacts.drift import COUNTS
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exact_sum import exact_sums
from particles_mpi.particles import Array, Particles, row_dot

OBSERVABLES = ("temperature", "moment_ratio", "packing", "collision_rate", "free_time", "free_path", "z_virial", "z_rate")
ROTATION_PLANES = {2: ((0, 1),), 3: ((1, 2), (2, 0), (0, 1))}  # of the components of the angular momentum, by dimension


def measure(ranks: Communicator, particles: Particles, potentials: dict[str, Array]) -> dict[str, float]:
    """Kinetic, potential and total energy, momentum and largest speed of all movable particles. Collective.

    `potentials`: the potential energy (n,) of this rank's particles for each force that has one, by name; nan of one of them
    makes the sums nan. With mutual gravity the columns of `measure_gravity` are added, and where spheres turn those of
    `measure_spins`; the energy in their spins is part of the total.
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
    if "spin" in particles.arrays:
        row |= measure_spins(ranks, particles)
        row["total_energy"] += row["rotational"]
    return row


def measure_spins(ranks: Communicator, p: Particles) -> dict[str, float]:
    """Energy of all spins, I s^2/2, and the angular momentum about the origin with them. Collective."""
    moment = p["moment_of_inertia"] * (p.fixed == 0)
    orbital, own = angular_momenta(p), (moment[:, None] * p["spin"]).T
    columns = [0.5 * moment * row_dot(p["spin"], p["spin"]), *(part for pair in zip(orbital, own, strict=True) for part in pair)]
    rotational, *sums = exact_sums(ranks, columns)
    return {"rotational": rotational} | dict(zip(angular_names(p.dimension), np.add(sums[::2], sums[1::2]).tolist(), strict=True))


def angular_momenta(p: Particles) -> list[Array]:
    """m x cross v of each particle (n,), for each component; nothing in one dimension and beyond three."""
    mass, planes = p.mass * (p.fixed == 0), ROTATION_PLANES.get(p.dimension, ())
    return [mass * (p.position[:, i] * p.velocity[:, j] - p.position[:, j] * p.velocity[:, i]) for i, j in planes]


def angular_names(dimension: int) -> list[str]:
    """Names of its components."""
    return [f"angular_momentum_{'xyz'[3 - i - j]}" for i, j in ROTATION_PLANES.get(dimension, ())]


def measure_gravity(ranks: Communicator, p: Particles, kinetic: float, potential: Array) -> dict[str, float]:
    """Angular momentum about the origin (in two and three dimensions), centre of mass, and 2 K/|W|. Collective."""
    movable = p.fixed == 0
    mass, d = p.mass * movable, p.dimension
    columns = [potential * movable, mass, *(mass * p.position[:, k] for k in range(d)), *angular_momenta(p)]
    binding, total, *sums = exact_sums(ranks, columns)
    row = dict(zip(gravity_names(d), [*sums[d:], *(x / total if total else nan for x in sums[:d])], strict=False))
    return row | {"virial_ratio": 2.0 * kinetic / abs(binding) if binding else nan}


def gravity_names(dimension: int) -> list[str]:
    """The columns of `measure_gravity`, in order."""
    return [
        *angular_names(dimension),
        *(name.replace("momentum", "center") for name in momentum_names(dimension)),
        "virial_ratio",
    ]


def momentum_names(dimension: int) -> list[str]:
    """momentum_x, _y, _z; beyond three axes momentum_0, momentum_1, ..."""
    return [f"momentum_{'xyz'[k] if dimension <= 3 else k}" for k in range(dimension)]


def columns(dimension: int, observables: bool = False, gravity: bool = False, spins: bool = False) -> list[str]:
    """The columns of diagnostics.csv, in order."""
    row = ["step", "time", "particles", "kinetic", "potential", "total_energy", *momentum_names(dimension), "max_speed"]
    turning = ["rotational", *(angular_names(dimension) if not gravity else ())] if spins else []
    row += [*COUNTS, "imbalance", *(gravity_names(dimension) if gravity else ()), *turning]
    return [*row, *(OBSERVABLES if observables else ())]


def observe(
    ranks: Communicator, p: Particles, volume: float, time: float, collisions: int, since: list[float]
) -> dict[str, float]:
    """The observables, with rates over the interval since `since` = [time, collisions, virial], which is updated. Collective.

    `collisions`: of all ranks since the start; `volume`: of the box, nan without one. What is not defined is nan.
    """
    d, movable = p.dimension, p.fixed == 0
    m = p.mass * movable
    columns = [m, movable.astype(float), *[m * p.velocity[:, k] for k in range(d)], p.virial, p.radius**d]
    mass, count, *momentum, virial, balls = exact_sums(ranks, columns)
    whole = np.array(momentum) / mass if mass > 0.0 else np.zeros(d)
    own = p.velocity - whole
    square = row_dot(own, own)
    largest, minus_smallest, heaviest, minus_lightest = ranks.allreduce_max(
        np.array([part.max(initial=-np.inf) for q in (p.radius, p.mass) for part in (q[movable], -q[movable])], float)
    )
    heat, second, fourth, speed = exact_sums(
        ranks, [m * square, square * movable, square**2 * movable, np.sqrt(square) * movable]
    )
    lasted, happened, given = time - since[0], collisions - since[1], virial - since[2]
    since[:] = time, float(collisions), virial
    row: dict[str, Any] = dict.fromkeys(OBSERVABLES, nan)
    row["packing"] = balls * pi ** (d / 2) / gamma(d / 2 + 1) / volume
    if count < 2 or not heat > 0.0:
        return row
    temperature = row["temperature"] = heat / (d * (count - 1.0))
    row["moment_ratio"] = fourth * count / second**2
    if not lasted > 0.0:
        return row
    rate = row["collision_rate"] = 2.0 * happened / (count * lasted)
    row["z_virial"] = 1.0 + given / (d * count * temperature * lasted)
    if rate > 0.0:
        row["free_time"], row["free_path"] = 1.0 / rate, speed / count / rate
    if largest == -minus_smallest and heaviest == -minus_lightest:
        row["z_rate"] = 1.0 + 2.0 * float(largest) * rate * sqrt(pi * float(heaviest) / temperature) / (2.0 * d)
    return row
