"""Uniform gravity: dv/dt = g, the same for every particle, whatever its mass."""

import numpy as np

from particles_mpi.particles import Array, Particles, row_dot
from particles_mpi.scene.effect import EffectOptions, Force
from particles_mpi.scene.model import wrong_length
from particles_mpi.scene.schema import Scene


class Options(EffectOptions):
    """`acceleration`: g, one component an axis (length/time^2)."""

    acceleration: list[float]

    def faults(self, scene: Scene) -> list[str]:
        return wrong_length("acceleration", self.acceleration, scene.dimension)


class Effect(Force):
    """Adds g; its potential energy is -m g.x."""

    of_movable = True
    formula = "dv/dt = g"
    place_dependent = False

    def __init__(self, options: Options, scene: Scene):
        self.g: Array = np.array(options.acceleration, float)
        self.periodic = np.array(scene.periodic)

    def add(self, particles: Particles, acceleration: Array) -> None:
        acceleration += self.g

    def potential(self, particles: Particles) -> Array:
        """Return -m g.x (n,); NaN if g has a component along a periodic axis, where there is no height."""
        if self.g[self.periodic].any():
            return np.full(len(particles), np.nan)
        return -particles.mass * row_dot(particles.position, self.g)
