"""Leapfrog: V(h/2) D(h) V(h/2), with D the drift (straight paths, contacts on the way) and V the kick (`velocity_flow`).

Both are symmetric, so the step is of second order with dissipation too, needs one force evaluation, and stays stable for any
drag (an explicit -k v in the kicks would not).
"""

from __future__ import annotations

from typing import Any

from particles_mpi.integrators.integrator import Drift, Forces
from particles_mpi.integrators.velocity_flow import Kick
from particles_mpi.particles import Particles
from particles_mpi.timers import Timers


class Leapfrog:
    """Kick, drift, kick; `rest`, if given, keeps contacts that last after each kick."""

    def __init__(self, kick: Kick, rest: Any | None):
        self.kick, self.rest = kick, rest

    def advance(self, particles: Particles, h: float, forces: Forces, drift: Drift, timers: Timers) -> None:
        """v to n+1/2, x to n+1 with contacts on the way, v to n+1."""
        with timers("forces"):
            a = forces()
        with timers("kick"):
            self.kick.advance(particles, a, 0.5 * h, h)
        if self.rest:
            self.rest.keep(particles, a, h)
        drift(h)
        with timers("forces"):
            a = forces()
        with timers("kick"):
            self.kick.advance(particles, a, 0.5 * h)
        if self.rest:
            self.rest.keep(particles, a, h)
