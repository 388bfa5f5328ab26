"""A charge in a uniform magnetic field: m dv/dt = q v x B, a rotation of the velocity about B, advanced exactly."""

from math import cos, sin, sqrt

import numpy as np

from particles_mpi.effects import Column, EffectOptions, Needs, VelocityFlow, kernel


class Options(EffectOptions):
    """`field`: B, three components."""

    field: list[float]

    def faults(self, scene):
        faults = [] if len(self.field) == 3 else [f"field: {len(self.field)} components, not 3"]
        return faults + ([] if scene.dimension == 3 else [f"field: needs dimension 3, not {scene.dimension}"])


class Effect(VelocityFlow):
    """Turns each velocity by the angle -q |B| h/m about B."""

    formula = "m dv/dt = q v x B"
    needs = Needs(columns={"charge": Column(default=1.0)}, divides_by_mass=True, integrators=("leapfrog", "taylor"))

    def __init__(self, options, scene):
        self.field = np.array(options.field)

    def advance(self, particles, h):
        turn(particles.velocity, particles["charge"], particles.inverse_mass, self.field, h)

    def rate(self, particles):
        return np.cross(particles.velocity, self.field) * (particles["charge"] * particles.inverse_mass)[:, None]


@kernel
def turn(v, charge, w, field, h):
    """Rodrigues' formula, row by row, in place."""
    size = sqrt(field[0] ** 2 + field[1] ** 2 + field[2] ** 2)
    if size == 0.0:
        return
    bx, by, bz = field[0] / size, field[1] / size, field[2] / size
    for i in range(len(v)):
        angle = -charge[i] * w[i] * size * h
        c, s = cos(angle), sin(angle)
        x, y, z = v[i, 0], v[i, 1], v[i, 2]
        along = (bx * x + by * y + bz * z) * (1.0 - c)
        v[i, 0] = x * c + (by * z - bz * y) * s + bx * along
        v[i, 1] = y * c + (bz * x - bx * z) * s + by * along
        v[i, 2] = z * c + (bx * y - by * x) * s + bz * along
