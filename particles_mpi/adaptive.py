"""The integrator `adaptive`: close encounters to round-off, by steps as long as the forces of the moment allow.

Collocation at the eight Gauss-Radau nodes of a step, order 15 (E. Everhart, in Dynamics of Comets, 1985; the choice of the
step follows H. Rein and D. S. Spiegel, MNRAS 446, 1424, 2015): the acceleration is a polynomial of the time whose values at
the nodes are those at the positions it leads to, found by iteration. Its highest coefficient over the largest
acceleration, to the power 1/7, tells how long the step may be.

A scene's step is cut into as many of these as it takes and ends exactly where it should. Nothing is kept from one to the
next but the state, so that a resumed run has the same bits.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import legendre

from particles_mpi.errors import StoppedError
from particles_mpi.integrators import Drift, Forces
from particles_mpi.parallel.ranks import Ranks
from particles_mpi.particles import Array, Particles
from particles_mpi.timers import Timers

NODES = 8
TOLERANCE = 1e-9  # of the highest coefficient over the largest acceleration, where a scene gives none
MOST_ITERATIONS = 12
SETTLED = 1e-16  # change of the acceleration from one iteration to the next, of the largest one
SAFE, SHRINK, GROW = 0.25, 0.1, 4.0  # a step is taken if the next may be at least SAFE as long; bounds on the change
SHORTEST = 1e-11  # of a step of the scene: where masses meet head on there is no end to it
FAR = 1.5  # times the last step: for longer ones its polynomial is no guess


def radau() -> tuple[Array, Array, Array, Array, Array, Array]:
    """(nodes c in [0, 1), velocity (8, 8), position (8, 8), the same at the end (8,) twice, Lagrange polynomials (8, powers)).

    velocity[i, j]: integral of the Lagrange polynomial of node j from 0 to c_i; position: the integral of that.
    """
    wide = np.longdouble
    c = np.sort(legendre.legroots([0.0] * (NODES - 1) + [1.0, 1.0])).astype(wide)  # P_7 + P_8: -1 is one of the roots
    for _ in range(4):
        c -= (_legendre(NODES - 1, c)[0] + _legendre(NODES, c)[0]) / (_legendre(NODES - 1, c)[1] + _legendre(NODES, c)[1])
    c = (c + 1) / 2
    c[0] = 0
    lagrange = np.zeros((NODES, NODES), wide)  # of powers of the time
    for j in range(NODES):
        poly = np.ones(1, wide)
        for k in range(NODES):
            if k != j:
                poly = np.convolve(poly, np.array([-c[k], 1], wide)) / (c[j] - c[k])
        lagrange[j] = poly
    powers = np.arange(NODES)
    ends = np.append(c, wide(1))
    once = np.array([[(lagrange[j] * t ** (powers + 1) / (powers + 1)).sum() for j in range(NODES)] for t in ends])
    twice = np.array(
        [[(lagrange[j] * t ** (powers + 2) / ((powers + 1) * (powers + 2))).sum() for j in range(NODES)] for t in ends]
    )
    once, twice = once.astype(float), twice.astype(float)
    return c.astype(float), once[:-1], twice[:-1], once[-1], twice[-1], lagrange.astype(float)


def _legendre(n: int, t: Array) -> tuple[Array, Array]:
    """P_n and its derivative at t, by the recurrence."""
    before, now = np.ones_like(t), t
    for k in range(1, n):
        before, now = now, ((2 * k + 1) * t * now - k * before) / (k + 1)
    inner = np.where(np.abs(t * t - 1) < 1e-12, 1, t * t - 1)
    slope = np.where(np.abs(t * t - 1) < 1e-12, t ** (n + 1) * (n * (n + 1)) / 2, n * (t * now - before) / inner)
    return now, slope


def combine(weights: Array, at: Array) -> Array:
    """sum_j weights[j] at[j], one after the other: a BLAS product has other bits for another number of rows."""
    total = weights[0] * at[0]
    for weight, a in zip(weights[1:], at[1:], strict=True):
        total += weight * a
    return np.asarray(total)


class Adaptive:
    """Order 15, with steps of its own choice; `substeps` counts those taken, `rejected` those that were too long."""

    def __init__(self, ranks: Ranks, tolerance: float):
        self.ranks, self.tolerance = ranks, tolerance
        self.c, self.once, self.twice, self.once_end, self.twice_end, self.lagrange = radau()
        self.substeps = self.rejected = 0

    def advance(self, particles: Particles, h: float, forces: Forces, drift: Drift, timers: Timers) -> None:
        """All substeps of a step. What is known of the last one serves the next, within this step."""
        done, length = 0.0, h
        self.before: tuple[Array, float, float] | None = None
        while done < h:
            left = h - done
            length = left if length >= left else min(length, 0.5 * left)  # no crumb at the end
            next_length = self.substep(particles, length, forces, timers)
            if next_length >= SAFE * length:
                done = h if length == left else done + length
                self.substeps += 1
            else:
                self.rejected += 1
            if done < h and not next_length > SHORTEST * h:
                raise StoppedError(f"time.integrator: steps get shorter than {next_length:.2g}: masses meet; softening helps")
            length = next_length
        with timers("drift"):
            drift(0.0)  # whatever belongs to the end of a drift

    def substep(self, particles: Particles, h: float, forces: Forces, timers: Timers) -> float:
        """Try a step of length h; returns how long the next one may be. If that is too short, nothing has changed."""
        x, v = particles.position, particles.velocity
        x0, v0 = x.copy(), v.copy()
        with timers("forces"):
            a = self.forces(forces, x)
            at = self.guess(a, h)
            change = np.inf
            for _ in range(MOST_ITERATIONS):
                largest = 0.0
                before, change = change, 0.0
                for i in range(1, NODES):
                    x[:] = x0 + (h * self.c[i] * v0 + h * h * combine(self.twice[i], at))
                    new = self.forces(forces, x)
                    change = max(change, float(np.abs(new - at[i]).max(initial=0.0)))
                    largest = max(largest, float(np.abs(new).max(initial=0.0)))
                    at[i] = new
                top = np.abs(combine(self.lagrange[:, -1], at)).max(initial=0.0)
                largest, change, top = self.ranks.largest(np.array([largest, change, top]))
                if not change > SETTLED * largest or (change >= before and change < 1e-10 * largest):
                    break
            if not np.isfinite(change) or change > 1e-8 * largest:  # the iteration does not lead anywhere: far too long
                x[:] = x0
                return SHRINK * h
        ratio = top / largest if largest > 0.0 else 0.0
        factor = (self.tolerance / ratio) ** (1.0 / 7.0) if ratio > 0.0 else GROW
        self.before = at, h, float(factor >= SAFE)
        if factor < SAFE:
            x[:] = x0
        else:
            x[:] = x0 + (h * v0 + h * h * combine(self.twice_end, at))
            v[:] = v0 + h * combine(self.once_end, at)
        return h * float(np.clip(factor, SHRINK, GROW))

    def guess(self, a: Array, h: float) -> Array:
        """Accelerations at the nodes of a step that begins with a: the last polynomial goes on, if not for too long."""
        if self.before is None or h > FAR * self.before[1]:
            return np.repeat(a[None], NODES, axis=0)
        at, length, begin = self.before
        moments = begin + self.c * (h / length)
        weights = (moments[:, None] ** np.arange(NODES)) @ self.lagrange.T
        return np.stack([a, *(combine(row, at) for row in weights[1:])])

    def forces(self, forces: Forces, x: Array) -> Array:
        """Accelerations at the present positions, none where there are none."""
        a = forces()
        return np.zeros_like(x) if a is None else a
