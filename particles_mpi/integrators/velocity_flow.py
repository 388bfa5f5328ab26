"""A kick: velocities advance at fixed positions, by forces and by all that acts on velocities."""

from __future__ import annotations

import numpy as np

from particles_mpi.kernels.motion import kick, kick_with_drag
from particles_mpi.particles import Array, Particles
from particles_mpi.scene.active import ActiveEffects


class Kick:
    """dv/dt = a + the effects on velocities, over a time h.

    Force and damping are advanced together, exactly, and friction with them. Other flows act one after the other for h/2
    before, and in reverse order for h/2 after (Strang splitting), so that the whole is symmetric and of second order.
    """

    def __init__(self, effects: ActiveEffects):
        self.damping, self.friction, self.flows = effects.damping, effects.friction, list(effects.flows.values())
        self.known: tuple[int, int, float] | None = None

    def advance(self, particles: Particles, a: Array | None, h: float, drift: float = 0.0) -> None:
        """Velocities after h under accelerations a (n, d). `drift`: length of the drift that follows, if it does."""
        for flow in self.flows:
            flow.advance(particles, 0.5 * h)
        self.force_and_losses(particles, a, h, drift if a is None and not self.damping and not self.flows else 0.0)
        for flow in reversed(self.flows):
            flow.advance(particles, 0.5 * h)
        if self.flows:
            particles.velocity[particles.fixed != 0] = 0.0

    def force_and_losses(self, particles: Particles, a: Array | None, h: float, coast: float) -> None:
        """The same without the other flows. `coast`: length of a drift that follows in which nothing but friction acts."""
        if self.damping is None and self.friction is None:
            if a is not None:
                kick(particles.velocity, a, h)
            return
        if self.known != (particles.version, particles.edition, h):
            self.known = particles.version, particles.edition, h
            n = len(particles)
            self.factors = self.damping.factors(particles, h) if self.damping else (np.ones(n), np.full(n, h))
        decay, push = self.factors
        a = np.zeros_like(particles.velocity) if a is None else a
        if self.friction:
            self.friction.kick(particles, a, decay, push, h, coast)
        else:
            kick_with_drag(particles.velocity, a, decay, push)

    def rate(self, particles: Particles) -> Array | None:
        """dv/dt (n, d) by the other flows at the present velocities, or None without any."""
        if not self.flows:
            return None
        total = sum((flow.rate(particles) for flow in self.flows), np.zeros_like(particles.velocity))
        total[particles.fixed != 0] = 0.0
        return total
