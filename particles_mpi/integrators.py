"""Integrators as sequences of kick and drift.

Leapfrog: V(h/2) D(h) V(h/2), with D the drift (straight paths, contacts on the way) and V the flow of the velocity alone:
forces, drag and friction at fixed positions, each advanced exactly. Both flows are symmetric, so the step is second order
with dissipation too, needs one force evaluation, and stays stable for any drag (an explicit -k v in the kicks would not).
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numba import njit

from particles_mpi.particles import Array, Particles


class Integrator(Protocol):
    """What a step does to velocities before and after the drift. `a`: accelerations at the positions of that moment."""

    def open(self, particles: Particles, a: Array | None, h: float) -> None: ...

    def close(self, particles: Particles, a: Array | None, h: float) -> None: ...


class Leapfrog:
    """Kick - drift - kick with exact dissipation in the kicks (Strang splitting)."""

    def __init__(self, drag: Any | None, friction: Any | None):
        self.drag, self.friction = drag, friction
        self.known: tuple[int, float] | None = None

    def open(self, particles: Particles, a: Array | None, h: float) -> None:
        """Velocities from n to n+1/2."""
        self.kick(particles, a, 0.5 * h, h if a is None and self.drag is None else 0.0)

    def close(self, particles: Particles, a: Array | None, h: float) -> None:
        """Velocities from n+1/2 to n+1."""
        self.kick(particles, a, 0.5 * h, 0.0)

    def kick(self, particles: Particles, a: Array | None, h: float, coast: float) -> None:
        """The velocity flow over h."""
        if self.drag is None and self.friction is None:
            if a is not None:
                kick(particles.velocity, a, h)
            return
        if self.known != (particles.version, h):
            self.known = particles.version, h
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

    def open(self, particles: Particles, a: Array | None, h: float) -> None:
        """Velocities from the start of the step to its mean."""
        rate = particles["rate"]
        rate[:] = 0.0 if a is None else a
        if self.drag:
            rate -= particles["drag"][:, None] * particles.velocity
        kick(particles.velocity, rate, 0.5 * h)

    def close(self, particles: Particles, a: Array | None, h: float) -> None:
        """Velocities from the mean of the step to its end, by the rate of its start."""
        kick(particles.velocity, particles["rate"], 0.5 * h)


@njit(cache=True)
def kick(v, a, h):
    """v += a h, in place on v (n, d)."""
    for i in range(v.shape[0]):
        for k in range(v.shape[1]):
            v[i, k] += a[i, k] * h


@njit(cache=True)
def kick_with_drag(v, a, decay, push):
    """v = v decay + a push, in place on v (n, d)."""
    for i in range(v.shape[0]):
        for k in range(v.shape[1]):
            v[i, k] = v[i, k] * decay[i] + a[i, k] * push[i]


@njit(cache=True)
def free_drift(x, v, h):
    """x += v h, in place on x (n, d)."""
    for i in range(x.shape[0]):
        for k in range(x.shape[1]):
            x[i, k] += v[i, k] * h


@njit(cache=True)
def wrap(x, lower, upper, length):
    """Positions back into [lower, upper) on periodic axes (length > 0), in place on x (n, d)."""
    for k in range(x.shape[1]):
        if length[k] > 0.0:
            for i in range(x.shape[0]):
                if x[i, k] < lower[k] or x[i, k] >= upper[k]:
                    y = lower[k] + (x[i, k] - lower[k]) % length[k]
                    x[i, k] = y if y < upper[k] else lower[k]
