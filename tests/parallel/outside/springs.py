"""A spring that ties each particle to a point: dv/dt = -k (x - centre)/m, with a stiffness k of its own."""

import numpy as np

from particles_mpi.effects import Column, EffectOptions, Force, Needs


class Options(EffectOptions):
    """`centre`: one component an axis."""

    centre: list[float]

    def faults(self, scene):
        n, d = len(self.centre), scene.dimension
        return [] if n == d else [f"centre: {n} components in dimension {d}"]


class Effect(Force):
    formula = "m dv/dt = -k (x - c)"
    needs = Needs(columns={"stiffness": Column(least=0.0)}, divides_by_mass=True)

    def __init__(self, options, scene):
        self.centre = np.array(options.centre)

    def add(self, particles, acceleration):
        acceleration -= (particles.position - self.centre) * (particles["stiffness"] * particles.inverse_mass)[:, None]

    def potential(self, particles):
        square = sum((particles.position[:, k] - c) ** 2 for k, c in enumerate(self.centre))
        return 0.5 * particles["stiffness"] * square
