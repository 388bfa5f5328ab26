"""Linear drag: dv/dt = -k v, advanced exactly together with a constant acceleration."""

import math

import numpy as np

from particles_mpi.particles import FIELDS, Array, Particles
from particles_mpi.scene.effect import FORWARD, Damping, EffectOptions, Needs
from particles_mpi.scene.model import NotNegative


class Options(EffectOptions):
    """`rate`: k (1/time) where a population gives no `drag`. A new rate between two steps is for all that had the old one."""

    rate: NotNegative = 0.0


class Effect(Damping):
    """v(h) = v e^{-kh} + a (1 - e^{-kh})/k: exact for constant a, so stable at any k h and monotone towards a/k."""

    formula = "dv/dt = -k v"
    needs = Needs(columns={"drag": FIELDS["drag"]}, integrators=FORWARD)

    @staticmethod
    def option_changed(particles: Particles, before: Options, after: Options) -> None:
        """Particles with the rate that all had by default get the new one."""
        particles["drag"][particles["drag"] == before.rate] = after.rate

    def factors(self, particles: Particles, h: float) -> tuple[Array, Array]:
        """See `Damping.factors`. `math.exp`, once a distinct rate: a vectorised exp rounds differently at the end of arrays."""
        rates, which = np.unique(particles["drag"], return_inverse=True)
        decay = np.array([math.exp(-k * h) for k in rates])
        force_time = np.array([-math.expm1(-k * h) / k if k > 0.0 else h for k in rates])
        return decay[which], force_time[which]
