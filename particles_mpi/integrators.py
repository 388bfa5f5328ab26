"""Integrators as sequences of kick and drift.

Leapfrog: V(h/2) D(h) V(h/2), with D the drift (straight paths, contacts on the way) and V the flow of the velocity alone:
forces, drag and friction at fixed positions, each advanced exactly. Both flows are symmetric, so the step is second order
with dissipation too, needs one force evaluation, and stays stable for any drag (an explicit -k v in the kicks would not).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from particles_mpi.lean import kernel
from particles_mpi.particles import Array, Particles
from particles_mpi.timers import Timers

Forces = Callable[[], Array | None]  # accelerations (n, d) at the positions of this moment, or None
Drift = Callable[[float], None]  # positions over a time


class Integrator(Protocol):
    """Advances particles by a step of length h, calling for forces and drifts as it needs them. Collective."""

    def advance(self, particles: Particles, h: float, forces: Forces, drift: Drift, timers: Timers) -> None: ...


class Leapfrog:
    """Kick - drift - kick with exact dissipation in the kicks (Strang splitting); `rest` keeps slow contacts after each kick."""

    def __init__(self, drag: Any | None, friction: Any | None, rest: Any | None):
        self.drag, self.friction, self.rest = drag, friction, rest
        self.known: tuple[int, int, float] | None = None

    def advance(self, particles: Particles, h: float, forces: Forces, drift: Drift, timers: Timers) -> None:
        """v to n+1/2, x to n+1 with contacts on the way, v to n+1."""
        with timers("forces"):
            a = forces()
        with timers("kick"):
            self.kick(particles, a, 0.5 * h, h if a is None and self.drag is None else 0.0)
        if self.rest:
            self.rest.keep(particles, a, h)
        drift(h)
        with timers("forces"):
            a = forces()
        with timers("kick"):
            self.kick(particles, a, 0.5 * h, 0.0)
        if self.rest:
            self.rest.keep(particles, a, h)

    def kick(self, particles: Particles, a: Array | None, h: float, coast: float) -> None:
        """The velocity flow over h."""
        if self.drag is None and self.friction is None:
            if a is not None:
                kick(particles.velocity, a, h)
            return
        if self.known != (particles.version, particles.edition, h):
            self.known = particles.version, particles.edition, h
            n = len(particles)
            self.factors = self.drag.factors(particles, h) if self.drag else (np.ones(n), np.full(n, h))
        decay, push = self.factors
        a = np.zeros_like(particles.velocity) if a is None else a
        if self.friction:
            self.friction.kick(particles, a, decay, push, h, coast)
        else:
            kick_with_drag(particles.velocity, a, decay, push)


class Taylor:
    """PBPhys's explicit rule, x += v h + (a - k v) h^2/2 and v += (a - k v) h: first order with drag, kept as its test.

    The same as a drift with the mean velocity v + (a - k v) h/2 between two kicks with the rate a - k v of the start.
    """

    def __init__(self, drag: Any | None):
        self.drag = drag

    def advance(self, particles: Particles, h: float, forces: Forces, drift: Drift, timers: Timers) -> None:
        """v to the mean of the step, x to its end, v to its end by the rate of its start."""
        with timers("forces"):
            a = forces()
        with timers("kick"):
            rate = particles["rate"]
            rate[:] = 0.0 if a is None else a
            if self.drag:
                rate -= particles["drag"][:, None] * particles.velocity
            kick(particles.velocity, rate, 0.5 * h)
        drift(h)
        with timers("kick"):
            kick(particles.velocity, particles["rate"], 0.5 * h)


class Order4:
    """SRKN_6^b of S. Blanes and P. C. Moan, J. Comput. Appl. Math. 142, 313 (2002): fourth order, six forces a step.

    Kicks and drifts by turns, symmetric and symplectic, for forces that do not depend on velocities. One drift goes back in
    time, so nothing may happen on the way.
    """

    B = (0.0829844064174052, 0.396309801498368, -0.0390563049223486)
    A = (0.245298957184271, 0.604872665711080)
    KICKS = (*B, 1.0 - 2.0 * sum(B), *B[::-1])
    DRIFTS = (*A, 0.5 - sum(A), 0.5 - sum(A), *A[::-1])

    def advance(self, particles: Particles, h: float, forces: Forces, drift: Drift, timers: Timers) -> None:
        """Seven kicks, six drifts between them."""
        for stage, weight in enumerate(self.KICKS):
            if stage:
                drift(self.DRIFTS[stage - 1] * h)
            with timers("forces"):
                a = forces()
            with timers("kick"):
                if a is not None:
                    kick(particles.velocity, a, weight * h)


@kernel
def kick(v, a, h):
    """v += a h, in place on v (n, d)."""
    for i in range(v.shape[0]):
        for k in range(v.shape[1]):
            v[i, k] += a[i, k] * h


@kernel
def kick_with_drag(v, a, decay, push):
    """v = v decay + a push, in place on v (n, d)."""
    for i in range(v.shape[0]):
        for k in range(v.shape[1]):
            v[i, k] = v[i, k] * decay[i] + a[i, k] * push[i]


@kernel
def free_drift(x, v, h):
    """x += v h, in place on x (n, d)."""
    for i in range(x.shape[0]):
        for k in range(x.shape[1]):
            x[i, k] += v[i, k] * h


@kernel
def wrap(x, lower, upper, length):
    """Positions back into [lower, upper) on periodic axes (length > 0), in place on x (n, d)."""
    for k in range(x.shape[1]):
        if length[k] > 0.0:
            for i in range(x.shape[0]):
                if x[i, k] < lower[k] or x[i, k] >= upper[k]:
                    y = lower[k] + (x[i, k] - lower[k]) % length[k]
                    x[i, k] = y if y < upper[k] else lower[k]


def places_of(particles: Particles) -> tuple[int, ...]:
    """(version, edition, fingerprint): the same as long as nobody moved rows, or a row, or changed one."""
    return particles.version, particles.edition, fingerprint(particles.position)


@kernel
def fingerprint(x):
    """A number that changes when somebody changes a row of x (n, d)."""
    total = np.int64(0)
    for number in x.reshape(-1).view(np.int64):
        total = (total ^ number) * np.int64(-7046029254386353131)
        total ^= total >> 29
    return total
