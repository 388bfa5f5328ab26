"""The user's own acceleration of each particle: dv/dt = a_i, constant in time unless the user changes the field."""

import numpy as np

from particles_mpi.particles import FIELDS, Array, Particles, row_dot
from particles_mpi.scene.effect import EffectOptions, Force, Needs
from particles_mpi.scene.schema import Scene


class Options(EffectOptions):
    """No keys: the accelerations stand in `[[particles]]`."""


class Effect(Force):
    """Adds a_i. (PBPhys cleared it after the first step; here it stays.)"""

    of_movable = True
    formula = "dv/dt = a_i"
    place_dependent = False
    needs = Needs(columns={"acceleration": FIELDS["acceleration"]})

    def __init__(self, options: Options, scene: Scene):
        self.periodic = np.array(scene.periodic)

    def add(self, particles: Particles, acceleration: Array) -> None:
        acceleration += particles["acceleration"]

    def potential(self, particles: Particles) -> Array:
        """-m a_i.x; not a number for one along a periodic axis, which gives its particle more energy at each turn."""
        a = particles["acceleration"]
        energy = -particles.mass * row_dot(particles.position, a)
        return np.where((a[:, self.periodic] != 0.0).any(axis=1), np.nan, energy)
