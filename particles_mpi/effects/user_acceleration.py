"""The user's own acceleration of each particle: dv/dt = a_i, constant in time unless the user changes the field."""

from particles_mpi.particles import Array, Particles, row_dot
from particles_mpi.scene import EffectOptions, Scene


class Options(EffectOptions):
    """No keys: the accelerations stand in `[[particles]]`."""


class Effect:
    """Adds a_i. (PBPhys cleared it after the first step; here it stays.)"""

    role = "force"
    fields = ("acceleration",)
    formula = "dv/dt = a_i"
    constant = False  # the field is the user's to change between steps

    def __init__(self, options: Options, scene: Scene):
        pass

    def add(self, particles: Particles, acceleration: Array) -> None:
        """acceleration (n, d) += a_i."""
        acceleration += particles["acceleration"]

    def potential(self, particles: Particles) -> Array:
        """-m a_i.x of each particle, shape (n,): a constant acceleration is conservative."""
        return -particles.mass * row_dot(particles.position, particles["acceleration"])
