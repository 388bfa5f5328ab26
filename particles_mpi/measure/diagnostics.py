"""The columns of `diagnostics.csv`: energies, momentum, speeds and observables, of sums that are exact on any number of ranks.

Observables of a gas of spheres: D axes, N movable particles, T in units of energy (k = 1); rates since they were last computed.

- temperature: sum m (v - V)^2 / (D (N - 1)), with V the velocity of the centre of mass
- moment_ratio: <v^4>/<v^2>^2 of v - V; Maxwell-Boltzmann gives (1 + 2/D) n/(n + 2), n = D (N - 1)
- packing: volume of all spheres over that of the box
- collision_rate: Gamma = 2 C/(N t), collisions of a particle in unit time; free_time 1/Gamma, free_path <|v - V|>/Gamma; these
  and the following are nan where some are fixed, for a collision with these is not of two particles, and where
  particles were added, removed, fixed or freed, or collisions were switched on or off, in that time
- z_virial: p V/(N T) = 1 + sum(-r.dp)/(D N T t) over the collisions, r from partner to partner, dp the momentum it gives; T is
  that of the end of the interval
- z_rate: 1 + sigma Gamma sqrt(pi m/T)/(2 D), for spheres of diameter sigma and mass m that were equal and elastic all that time
  (Enskog; M. P. Allen and D. J. Tildesley, Computer Simulation of Liquids, 1987, for both)
"""

from dataclasses import dataclass, replace
from functools import cache
from math import gamma, nan, pi, sqrt
from typing import Any

import numpy as np

from particles_mpi.contacts.drift import COUNTS
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exact_sum import exact_sums_by_name
from particles_mpi.particles import Array, Particles, part_of, row_dot

OBSERVABLES = ("temperature", "moment_ratio", "packing", "collision_rate", "free_time", "free_path", "z_virial", "z_rate")
ROTATION_PLANES = {2: ((0, 1),), 3: ((1, 2), (2, 0), (0, 1))}  # of the components of the angular momentum, by dimension


def energies_and_momenta(ranks: Communicator, p: Particles, potentials: dict[str, Array], gravity: bool) -> dict[str, float]:
    """Kinetic, potential and total energy, momentum and largest speed of all movable particles. Collective.

    `potentials`: the potential energy (n,) of this rank's particles for each force that has one, by name; nan of one of them
    makes the sums nan. With mutual `gravity`, which may be switched off: angular momentum about the origin (in two and three
    dimensions), centre of mass, and virial ratio 2 K/|W|. Where spheres turn: the energy of spins, which is part of the total,
    and angular momentum with spins.
    """
    d, turning = p.dimension, "spin" in p.arrays
    fastest = 0.0

    def terms(rows: slice) -> dict[str, Array]:
        """What each row (n,) adds to the sums, by name; fixed ones only energies."""
        nonlocal fastest
        part = part_of(p, rows)
        square, mass = row_dot(part.velocity, part.velocity), part.mass * (part.fixed == 0)
        fastest = square.max(initial=fastest)
        found = {"kinetic": 0.5 * mass * square}
        found |= dict(zip(vector_names("momentum", d), mass * part.velocity.T, strict=True))
        found |= {f"potential of {name}": energy[rows] for name, energy in potentials.items()}
        if gravity or turning:
            found |= angular_momenta(part, mass)
        if gravity:
            found |= {"mass": mass} | dict(zip(vector_names("center", d), mass * part.position.T, strict=True))
        if turning:
            found |= spins(part)
        return found

    sums = exact_sums_by_name(ranks, len(p), terms)
    kinetic, potential = sums["kinetic"], float(sum(sums[f"potential of {name}"] for name in potentials))
    row = {"kinetic": kinetic, "potential": potential, "total_energy": kinetic + potential}
    row |= {name: sums[name] for name in vector_names("momentum", d)}
    row["max_speed"] = float(np.sqrt(ranks.largest(fastest)[0]))
    row |= {name: sums[name] for name in angular_names(d) if gravity or turning}
    if gravity:
        binding, total = sums.get("potential of mutual_gravity", 0.0), sums["mass"]
        row |= {name: sums[name] / total if total else nan for name in vector_names("center", d)}
        row["virial_ratio"] = 2.0 * kinetic / abs(binding) if binding else nan
    if turning:
        row["rotational"] = sums["rotational"]
        row["total_energy"] += row["rotational"]
        row |= {name: sums[name] + sums[f"spins' {name}"] for name in angular_names(d)}
    return row


def spins(p: Particles) -> dict[str, Array]:
    """Energy of the spin of each particle (n,), I s^2/2, and its angular momentum I s by component."""
    moment = p["moment_of_inertia"] * (p.fixed == 0)
    own = {f"spins' {name}": part for name, part in zip(angular_names(p.dimension), moment * p["spin"].T, strict=True)}
    return {"rotational": 0.5 * moment * row_dot(p["spin"], p["spin"])} | own


def angular_momenta(p: Particles, mass: Array) -> dict[str, Array]:
    """m x cross v of each particle (n,), by component; nothing in one dimension and beyond three."""
    x, v, planes = p.position.T, p.velocity.T, ROTATION_PLANES.get(p.dimension, ())
    return dict(zip(angular_names(p.dimension), [mass * (x[i] * v[j] - x[j] * v[i]) for i, j in planes], strict=True))


@cache
def angular_names(dimension: int) -> tuple[str, ...]:
    """Names of the components of the angular momentum."""
    return tuple(f"angular_momentum_{'xyz'[3 - i - j]}" for i, j in ROTATION_PLANES.get(dimension, ()))


@cache
def vector_names(vector: str, dimension: int) -> tuple[str, ...]:
    """Names of the components of a vector: momentum_x, _y, _z; beyond three axes momentum_0, momentum_1, ..."""
    return tuple(f"{vector}_{'xyz'[k] if dimension <= 3 else k}" for k in range(dimension))


def column_names(dimension: int, observables: bool, gravity: bool, spins: bool) -> list[str]:
    """The columns of diagnostics.csv, in order."""
    row = ["step", "time", "particles", "kinetic", "potential", "total_energy", *vector_names("momentum", dimension), "max_speed"]
    about_gravity = [*angular_names(dimension), *vector_names("center", dimension), "virial_ratio"] if gravity else []
    turning = ["rotational", *(angular_names(dimension) if not gravity else ())] if spins else []
    row += [*COUNTS, "imbalance", *about_gravity, *turning]
    return [*row, *(OBSERVABLES if observables else ())]


@dataclass
class Since:
    """The moment since which rates are, and what was counted until then; `step`: how many steps were done.

    `mixed`: were particles added, removed, fixed or freed after then, or collisions switched on or off? `changed`: were masses,
    radii, or whether collisions take energy? A rank knows only what happened to its own particles.
    """

    time: float = 0.0
    step: int = 0
    collisions: int = 0
    virial: float = 0.0
    mixed: bool = False
    changed: bool = False

    @classmethod
    def read(cls, saved: Any) -> "Since":
        """Return what was saved as a dict; earlier versions saved a list of time, collisions and virial."""
        if not isinstance(saved, dict):
            return cls(saved[0], 0, int(saved[1]), saved[2])
        return cls(**{"changed" if name == "lossy" else name: value for name, value in saved.items()})


def observe(ranks: Communicator, p: Particles, volume: float, now: Since, since: Since, elastic: bool) -> dict[str, float]:
    """Return the observables. Rates are for the time since `since`, which becomes `now`. Collective.

    `now`: time, step, and collisions of all ranks since the start; `volume`: of the box, nan without one; `elastic`: do all
    collisions keep the energy? What is not defined is nan.
    """
    d, movable = p.dimension, p.fixed == 0
    sums = exact_sums_by_name(ranks, len(p), lambda rows: numbers_and_momentum(part_of(p, rows)))
    mass, count, fixed, given_so_far = (sums[name] for name in ("mass", "movable", "fixed", "virial"))
    whole = np.array([sums[name] for name in vector_names("momentum", d)]) / mass if mass > 0.0 else np.zeros(d)
    moments = exact_sums_by_name(ranks, len(p), lambda rows: moments_of_velocity(part_of(p, rows), whole))
    heat, second, fourth, speed = moments.values()
    extremes = (part.max(initial=-np.inf) for q in (p.radius, p.mass) for part in (q[movable], -q[movable]))
    largest, minus_smallest, heaviest, minus_lightest, mixed, changed = ranks.largest(
        *extremes, float(since.mixed), float(since.changed)
    )
    lasted, happened, given = now.time - since.time, now.collisions - since.collisions, given_so_far - since.virial
    vars(since).update(vars(replace(now, virial=given_so_far)))
    row: dict[str, Any] = dict.fromkeys(OBSERVABLES, nan)
    row["packing"] = sums["balls"] * pi ** (d / 2) / gamma(d / 2 + 1) / volume
    if count < 2 or not heat > 0.0:
        return row
    temperature = row["temperature"] = heat / (d * (count - 1.0))
    if fourth > 0.0:  # else it is below the range of numbers
        row["moment_ratio"] = fourth / second * count / second
    if not lasted > 0.0 or fixed or mixed:
        return row
    rate = row["collision_rate"] = 2.0 * happened / (count * lasted)
    if (pressed := d * count * temperature * lasted) > 0.0:
        row["z_virial"] = 1.0 + given / pressed
    if rate > 0.0:
        row["free_time"], row["free_path"] = 1.0 / rate, speed / count / rate
    if elastic and not changed and largest == -minus_smallest and heaviest == -minus_lightest:
        row["z_rate"] = 1.0 + 2.0 * largest * rate * sqrt(pi * heaviest / temperature) / (2.0 * d)
    return row


def numbers_and_momentum(p: Particles) -> dict[str, Array]:
    """What each row (n,) adds to the sums that `observe` needs first, by name."""
    movable = p.fixed == 0
    mass = p.mass * movable
    terms = {"mass": mass, "movable": movable, "fixed": ~movable, "virial": p.virial, "balls": p.radius**p.dimension}
    return terms | dict(zip(vector_names("momentum", p.dimension), mass * p.velocity.T, strict=True))


def moments_of_velocity(p: Particles, whole: Array) -> dict[str, Array]:
    """m w^2, w^2, w^4 and |w| of each row (n,), with w the velocity relative to that of the `whole`; 0 of fixed particles."""
    movable, own = p.fixed == 0, p.velocity - whole
    square = row_dot(own, own)
    return {
        "m w^2": p.mass * movable * square,
        "w^2": square * movable,
        "w^4": square**2 * movable,
        "|w|": np.sqrt(square) * movable,
    }
