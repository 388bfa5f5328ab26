"""Plummer's sphere: places, and speeds that keep it as it is. H. Plummer, MNRAS 71, 460 (1911).

Density ~ (1 + r^2/a^2)^(-5/2); drawn as S. Aarseth, M. Henon and R. Wielen do, Astron. Astrophys. 37, 183 (1974). Plain arrays.
"""

from __future__ import annotations

import numpy as np

from particles_mpi.particles import Array

MOST = 0.999  # of the mass: the rest would be further out than 38 a


def plummer_places(random: np.random.Generator, a: float, mass: Array) -> Array:
    """Places (n, 3) around the origin, at which their centre of mass is; `a` is the scale length."""
    inside = MOST * random.random(len(mass))
    radius = a / np.sqrt(np.maximum(inside, 1e-12) ** (-2.0 / 3.0) - 1.0)
    return centered(radius[:, None] * directions(random, len(mass)), mass)


def plummer_velocities(random: np.random.Generator, x: Array, a: float, mass: Array, G: float) -> Array:
    """Isotropic velocities (n, 3) in equilibrium, without momentum; q = speed over escape, of density q^2 (1 - q^2)^(7/2)."""
    n = len(mass)
    q, rest = np.zeros(n), np.arange(n)
    while len(rest):
        tried, height = random.random(len(rest)), 0.1 * random.random(len(rest))
        good = height < tried**2 * (1.0 - tried**2) ** 3.5
        q[rest[good]] = tried[good]
        rest = rest[~good]
    escape = np.sqrt(2.0 * G * mass.sum()) * ((x**2).sum(axis=1) + a**2) ** -0.25
    return centered((q * escape)[:, None] * directions(random, n), mass)


def directions(random: np.random.Generator, n: int) -> Array:
    """Unit vectors (n, 3), no direction preferred."""
    normal = random.standard_normal((n, 3))
    return normal / np.sqrt((normal**2).sum(axis=1))[:, None]


def centered(vectors: Array, mass: Array) -> Array:
    """Less their mean, weighted by mass."""
    total = mass.sum()
    return vectors - (mass[:, None] * vectors).sum(axis=0) / total if total > 0.0 else vectors
