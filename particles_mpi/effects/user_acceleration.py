"""The user's own acceleration of each particle: dv/dt = a_i, constant in time unless the user changes the field."""

import numpy as np

from particles_mpi.particles import FIELDS, Array, Particles, row_dot
from particles_mpi.scene.effect import EffectOptions, Force, Needs
from particles_mpi.scene.schema import Scene


class Options(EffectOptions):
    """This table has no keys of its own: the accelerations are given in `[[particles]]`."""


class Effect(Force):
    """Adds a_i in every step. (PBPhys set it to 0 after the first step.)"""

    of_movable = True
    formula = "dv/dt = a_i"
    place_dependent = False
    needs = Needs(columns={"acceleration": FIELDS["acceleration"]})

    def __init__(self, options: Options, scene: Scene):
        self.periodic = np.array(scene.periodic)

    def add(self, particles: Particles, acceleration: Array) -> None:
        acceleration += particles["acceleration"]

    def potential(self, particles: Particles) -> Array:
        """Return -m a_i.x (n,); NaN where a_i has a component along a periodic axis, which adds energy in each turn."""
        a = particles["acceleration"]
        energy = -particles.mass * row_dot(particles.position, a)
        return np.where((a[:, self.periodic] != 0.0).any(axis=1), np.nan, energy)
