"""PBPhys's explicit rule, x += v h + (a - k v) h^2/2 and v += (a - k v) h: first order with drag, kept as its test."""

from __future__ import annotations

from particles_mpi.integrators.integrator import Drift, Forces
from particles_mpi.integrators.velocity_flow import Kick
from particles_mpi.kernels.motion import kick
from particles_mpi.particles import Particles
from particles_mpi.timers import Timers


class Taylor:
    """The same as a drift with the mean velocity v + (a - k v) h/2 between two kicks with the rate a - k v of the start."""

    def __init__(self, kick: Kick):
        self.damped, self.kick = kick.damping is not None, kick

    def advance(self, particles: Particles, h: float, forces: Forces, drift: Drift, timers: Timers) -> None:
        """v to the mean of the step, x to its end, v to its end by the rate of its start."""
        with timers("forces"):
            a = forces()
        with timers("kick"):
            rate = particles["rate"]
            rate[:] = 0.0 if a is None else a
            if self.damped:
                rate -= particles["drag"][:, None] * particles.velocity
            by_flows = self.kick.rate(particles)
            if by_flows is not None:
                rate += by_flows
            kick(particles.velocity, rate, 0.5 * h)
        drift(h)
        with timers("kick"):
            kick(particles.velocity, particles["rate"], 0.5 * h)
