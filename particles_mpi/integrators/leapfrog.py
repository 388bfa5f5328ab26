"""Integrators as sequences of kick and drift.

Leapfrog: V(h/2) D(h) V(h/2), with D the drift (straight paths, contacts on the way) and V the flow of the velocity alone:
forces, drag and friction at fixed positions, each advanced exactly. Both flows are symmetric, so the step is second order
with dissipation too, needs one force evaluation, and stays stable for any drag (an explicit -k v in the kicks would not).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from particles_mpi.integrators.integrator import Drift, Forces
from particles_mpi.kernels.motion import kick, kick_with_drag
from particles_mpi.particles import Array, Particles
from particles_mpi.timers import Timers


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
