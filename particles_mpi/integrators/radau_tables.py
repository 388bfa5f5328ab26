"""The eight Gauss-Radau nodes of a step, and integrals of the polynomials through them: for `collocation`."""

from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre

from particles_mpi.particles import Array
from particles_mpi.scene.schema import TOLERANCES

NODES = 8


class Tables(NamedTuple):
    """Coefficients for the Gauss-Radau nodes, as `radau` computes them. tolerance: that of the highest coefficient; coarsest: the
    largest tolerance that a scene may give.

    c (8,): nodes in [0, 1). twice (8, 8): what the accelerations at the nodes add to the positions there; once_end, twice_end
    (8,): to velocity and position at the end. lagrange (8, 8): polynomials; highest (8,): their highest coefficients. gain:
    round-off of the highest coefficient over that of accelerations.
    """

    c: Array
    twice: Array
    once_end: Array
    twice_end: Array
    lagrange: Array
    highest: Array
    gain: float
    tolerance: float
    coarsest: float


def radau(tolerance: float) -> Tables:
    """Compute the tables. L_j is the Lagrange polynomial of node j, whose coefficients are in `lagrange` (node, power).

    once_end[j] is the integral of L_j from 0 to 1; twice[i, j] the integral of its integral, from 0 to c_i; twice_end[j] to 1.
    """
    wide = np.longdouble
    c = np.sort(legendre.legroots([0.0] * (NODES - 1) + [1.0, 1.0])).astype(wide)[1:]  # P_7 + P_8: the first root is -1
    for _ in range(4):
        value, slope = np.add(_legendre(NODES - 1, c), _legendre(NODES, c))
        c -= value / slope
    c = np.append(wide(0), (c + 1) / 2)
    lagrange = np.zeros((NODES, NODES), wide)  # of powers of the time
    for j in range(NODES):
        poly = np.ones(1, wide)
        for other in np.delete(c, j):
            poly = np.convolve(poly, np.array([-other, 1], wide)) / (c[j] - other)
        lagrange[j] = poly
    power, ends = np.arange(NODES), np.append(c, wide(1))[:, None, None]
    once = (lagrange * ends ** (power + 1) / (power + 1)).sum(axis=-1).astype(float)
    twice = (lagrange * ends ** (power + 2) / ((power + 1) * (power + 2))).sum(axis=-1).astype(float)
    highest = lagrange[:, -1].astype(float)
    gain = 4.0 * float(np.sqrt((highest**2).sum()))
    return Tables(
        c.astype(float),
        twice[:-1].copy(),
        once[-1].copy(),
        twice[-1].copy(),
        lagrange.astype(float),
        highest,
        gain,
        tolerance,
        TOLERANCES[1],
    )


def _legendre(n: int, t: Array) -> tuple[Array, Array]:
    """P_n and its derivative at t, which is not 1 or -1, by the recurrence."""
    before, now = np.ones_like(t), t
    for k in range(1, n):
        before, now = now, ((2 * k + 1) * t * now - k * before) / (k + 1)
    return now, n * (t * now - before) / (t * t - 1)
