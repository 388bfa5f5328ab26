"""The integrator `adaptive`: close encounters to round-off, by steps as long as the forces of the moment allow.

Collocation at the eight Gauss-Radau nodes of a step, order 15 (E. Everhart, in Dynamics of Comets, 1985; the choice of the
step follows H. Rein and D. S. Spiegel, MNRAS 446, 1424, 2015): the acceleration is a polynomial of the time whose values at
the nodes are those at the positions it leads to, found by iteration. Its highest coefficient over the largest
acceleration, to the power 1/7, tells how long the step may be.

Far from the origin, or where bodies are close, coordinates round the accelerations, and no step is short enough to make the
coefficient small (D. Pham, H. Rein, D. S. Spiegel, Open J. Astrophys. 7, 2024, show how steps then shrink for ever). So this
round-off is measured at the start of each step, by one more evaluation, at positions moved by their own round-off. Below it the
iteration has converged, and what it makes of the highest coefficient is the least tolerance. Positions carry their round-off
along (Kahan's sum). Nothing but the state is kept from one step of the scene to the next, so a resumed run has the same bits.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.polynomial import legendre

from particles_mpi.errors import StateError
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Array, Particles
from particles_mpi.scene.schema import TOLERANCES
from particles_mpi.timers import Timers

NODES = 8
TOLERANCE = 1e-9  # of the highest coefficient over the largest acceleration, where a scene gives none
MOST_ITERATIONS = 12
SHAKEN = 32.0  # units in the last place by which a coordinate is moved, at most, to see what its round-off does
ROUNDED = float(np.finfo(float).eps)  # round-off of a sum of forces, relative to the largest acceleration
CAUTION = 10.0  # times the change that the next iteration is expected to make
NOISY = 8.0  # times the round-off: changes from one iteration to the next that are nothing else
STALLED, DIVERGED = 1e-10, 1e-8  # of the largest acceleration: changes that need not shrink any more, and that must
SAFE, SHRINK, GROW = 0.25, 0.1, 4.0  # a step is taken if the next may be at least SAFE as long; bounds on the change
SHORTEST = 1e-11  # of a step of the scene: where masses meet head on there is no end to it
BLIND, MOST_BLIND = 4.0, 100  # times the largest tolerance: round-off that hides the motion; tries in a row before that is an end
FAR = 1.5  # times the last step: for longer ones its polynomial is no guess


def radau() -> tuple[Array, Array, Array, Array, Array, Array]:
    """(nodes c in [0, 1), velocity (8, 8), position (8, 8), the same at the end (8,) twice, Lagrange polynomials (8, powers)).

    velocity[i, j]: integral of the Lagrange polynomial of node j from 0 to c_i; position: the integral of that.
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
    return c.astype(float), once[:-1], twice[:-1], once[-1], twice[-1], lagrange.astype(float)


def _legendre(n: int, t: Array) -> tuple[Array, Array]:
    """P_n and its derivative at t, which is not 1 or -1, by the recurrence."""
    before, now = np.ones_like(t), t
    for k in range(1, n):
        before, now = now, ((2 * k + 1) * t * now - k * before) / (k + 1)
    return now, n * (t * now - before) / (t * t - 1)


def combine(weights: Array, at: Array) -> Array:
    """sum_j weights[j] at[j], one after the other: a BLAS product has other bits for other numbers of rows, or processors."""
    total = weights[0] * at[0]
    for weight, a in zip(weights[1:], at[1:], strict=True):
        total += weight * a
    return np.asarray(total)


def add(total: Array, lost: Array, change: Array) -> None:
    """total + lost += change, in place, where total is rounded and lost is what that took away (D. E. Knuth, TAOCP 2, 4.2.2)."""
    change = change + lost
    rounded = total + change
    part = rounded - total
    lost[:] = (total - (rounded - part)) + (change - part)
    total[:] = rounded


def random_signs(ids: Array, axes: int, number: int) -> Array:
    """Numbers in [-1, 1), shape (n, axes), that depend on the id, the axis and `number` alone: a multiplicative hash."""
    k: Array = ids.astype(np.uint64)[:, None] * np.uint64(axes) + np.arange(axes, dtype=np.uint64)
    k = (k + np.array(number << 32, np.uint64)) * np.uint64(0x9E3779B97F4A7C15)
    k = (k ^ (k >> np.uint64(32))) * np.uint64(0xD6E8FEB86659FD93)
    return np.asarray((k >> np.uint64(11)).astype(float) * 2.0**-52 - 1.0)


def still_to_come(change: float, before: float) -> float:
    """What the next iteration would change if changes go on shrinking as from `before` to `change`; with caution."""
    return min(change, CAUTION * change * (change / before)) if np.isfinite(before) else change


class Adaptive:
    """Order 15, with steps of its own choice; `substeps` counts those taken."""

    def __init__(self, ranks: Communicator, tolerance: float, forces: Callable[[], Array | None], timers: Timers):
        """`forces`: accelerations (n, d) at the positions of the moment, or None."""
        self.ranks, self.tolerance, self.sum_forces, self.timers = ranks, tolerance, forces, timers
        self.c, self.once, self.twice, self.once_end, self.twice_end, self.lagrange = radau()
        self.gain = 4.0 * float(np.sqrt((self.lagrange[:, -1] ** 2).sum()))  # of round-off, in the highest coefficient
        self.substeps = 0

    def advance(self, particles: Particles, h: float, drift: Callable[[float], None]) -> None:
        """All substeps of a step. What is known of the last one serves the next, within this step."""
        done, length = 0.0, h
        self.before: tuple[Array, float, float] | None = None
        self.lost = np.zeros_like(particles.position)
        self.tries = self.blind = 0
        while done < h:
            left = h - done
            length = left if length >= left else min(length, 0.5 * left)  # no crumb at the end
            next_length = self.substep(particles, length)
            self.tries += 1
            if next_length >= SAFE * length:
                done = h if length == left else done + length
                self.substeps += 1
            if done < h and (not next_length > SHORTEST * h or self.blind > MOST_BLIND):
                raise StateError(
                    f"time.integrator: {done:.6g} into it, steps get shorter than {next_length:.2g}: "
                    f"{self.who_meets(particles, self.accelerations(particles))}; softening helps"
                )
            length = next_length
        with self.timers("drift"):
            drift(0.0)  # whatever belongs to the end of a drift

    def substep(self, particles: Particles, h: float) -> float:
        """Try a step of length h; returns how long the next one may be. If that is too short, nothing has changed."""
        x, v = particles.position, particles.velocity
        x0 = x.copy()
        with self.timers("forces"):
            a = self.accelerations(particles)
            x += SHAKEN * np.spacing(np.abs(x)) * random_signs(particles.id, x.shape[1], self.tries)
            noise = float(np.abs(self.accelerations(particles) - a).max(initial=0.0)) / SHAKEN
            at = self.guess(a, h)
            change = np.inf
            for _ in range(MOST_ITERATIONS):
                last, before = at.copy(), change
                for i in range(1, NODES):
                    x[:] = x0 + (self.lost + (h * self.c[i] * v + h * h * combine(self.twice[i], at)))
                    at[i] = self.accelerations(particles)
                change, largest = (np.fmax.reduce(np.abs(a), axis=None, initial=0.0) for a in (at - last, at[1:]))
                top = np.abs(combine(self.lagrange[:, -1], at)).max(initial=0.0)
                largest, change, top, noise = self.ranks.allreduce_max(np.array([largest, change, top, noise]))
                round_off, left = noise + ROUNDED * largest, still_to_come(change, before)
                if not left > round_off or (change >= before and change < max(STALLED * largest, NOISY * round_off)):
                    break
            x[:] = x0
            self.blind = self.blind + 1 if self.gain * round_off > BLIND * TOLERANCES[1] * largest else 0
            least = min(self.gain * round_off, TOLERANCES[1] * largest)  # that the highest coefficient can tell
            if not np.isfinite(change) or left > max(DIVERGED * largest, NOISY * least / self.gain):  # far too long
                return SHRINK * h
        factor = (max(self.tolerance * largest, least) / top) ** (1.0 / 7.0) if top > 0.0 else GROW
        self.before = at, h, float(factor >= SAFE)
        if factor >= SAFE:
            add(x, self.lost, h * v + h * h * combine(self.twice_end, at))
            v += h * combine(self.once_end, at)
        return h * float(np.clip(factor, SHRINK, GROW))

    def guess(self, a: Array, h: float) -> Array:
        """Accelerations at the nodes of a step that begins with a: the last polynomial goes on, if not for too long."""
        if self.before is None or h > FAR * self.before[1]:
            return np.repeat(a[None], NODES, axis=0)
        at, length, begin = self.before
        moments = begin + self.c * (h / length)
        weights = combine(np.vander(moments, NODES, increasing=True).T[:, :, None], self.lagrange.T[:, None])
        return np.stack([a, *(combine(row, at) for row in weights[1:])])

    def accelerations(self, particles: Particles) -> Array:
        """Accelerations at the present positions, 0 where there are no forces."""
        a = self.sum_forces()
        return np.zeros_like(particles.position) if a is None else a

    def who_meets(self, particles: Particles, a: Array) -> str:
        """The particle of the largest acceleration and the one that is nearest to it, on all ranks. Collective."""
        size, ids = np.abs(a).max(axis=1), particles.id.tolist()
        mine = max(((size[i], -ids[i], particles.position[i]) for i in range(len(ids))), key=lambda one: one[:2], default=None)
        _, pulled, place = max((one for one in self.ranks.allgather(mine) if one), key=lambda one: one[:2])
        apart = np.sqrt(((particles.position - place) ** 2).sum(axis=1)).tolist()
        nearest = min(((distance, other) for distance, other in zip(apart, ids) if other != -pulled), default=None)
        others = [one for one in self.ranks.allgather(nearest) if one]
        if not others:
            return f"particle {-pulled} is pulled too strongly"
        distance, other = min(others)
        first, second = sorted((-pulled, other))
        return f"masses {first} and {second} meet, {distance:.1g} apart"
