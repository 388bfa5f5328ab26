"""Plummer's sphere: places, and velocities that keep it as it is. H. Plummer, MNRAS 71, 460 (1911).

Density ~ (1 + r^2/a^2)^(-5/2); drawn as S. Aarseth, M. Henon and R. Wielen do, Astron. Astrophys. 37, 183 (1974). Plain arrays.

Powers are products and roots here: those of numpy have other last bits on processors with longer vectors.
"""

from math import cbrt

import numpy as np

from particles_mpi.initial.random_numbers import directions
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exact_sum import exact_sums
from particles_mpi.particles import Array

MASS_SHARE = 0.999  # of the mass: the rest would be further out than 38 a


def plummer_places(random: np.random.Generator, a: float, mass: Array) -> Array:
    """Places (n, 3) around the origin, at which their centre of mass is; `a` is the scale length."""
    return centered(Communicator.alone(), plummer_points(random, len(mass), a), mass)


def plummer_points(random: np.random.Generator, n: int, a: float) -> Array:
    """Places (n, 3) around the centre of the sphere."""
    inside = np.maximum(MASS_SHARE * random.random(n), 1e-12)
    root = np.array([cbrt(mass) for mass in inside.tolist()])
    radius = a / np.sqrt(1.0 / (root * root) - 1.0)
    return radius[:, None] * directions(random, n, 3)


def scaled_velocities(random: np.random.Generator, n: int) -> Array:
    """Isotropic velocities (n, 3) in units of the escape speed; their length q has the density q^2 (1 - q^2)^(7/2)."""
    q, rest = np.zeros(n), np.arange(n)
    while len(rest):
        tried, height = random.random(len(rest)), 0.1 * random.random(len(rest))
        rest_of_one = 1.0 - tried**2
        good = height < tried**2 * rest_of_one**2 * rest_of_one * np.sqrt(rest_of_one)
        q[rest[good]] = tried[good]
        rest = rest[~good]
    return q[:, None] * directions(random, n, 3)


def plummer_velocities(ranks: Communicator, scaled: Array, x: Array, a: float, mass: Array, G: float, whole: Array) -> Array:
    """Velocities (n, 3) in equilibrium without momentum: `scaled` (n, 3) times the escape speed at x (n, 3). Collective.

    `whole`: this rank's masses of all populations that make up the sphere, of which these particles may be one.
    """
    total = exact_sums(ranks, [whole])[0]
    escape = np.sqrt(2.0 * G * total) / np.sqrt(np.sqrt((x**2).sum(axis=1) + a**2))
    return centered(ranks, escape[:, None] * scaled, mass)


def centered(ranks: Communicator, vectors: Array, mass: Array) -> Array:
    """The vectors (n, d) less the mean of those of all ranks, weighted by mass. Collective."""
    total, *sums = exact_sums(ranks, [mass, *(mass[:, None] * vectors).T])
    return vectors - np.array(sums) / total if total > 0.0 else vectors
