"""Friction of constant magnitude: m dv/dt = -alpha v/|v|, advanced exactly; a particle at rest stays at rest."""

from particles_mpi.kernels.sliding import kick_with_friction
from particles_mpi.particles import Array, Particles
from particles_mpi.scene.effect import ConstantFriction, EffectOptions, Needs
from particles_mpi.scene.model import NotNegative
from particles_mpi.scene.schema import Scene


class Options(EffectOptions):
    """`strength`: alpha, a force."""

    strength: NotNegative


class Effect(ConstantFriction):
    """Friction for h/2, force for h, friction for h/2. What stops within h, under a force below alpha, rests exactly."""

    formula = "m dv/dt = -alpha v/|v|"
    needs = Needs(divides_by_mass=True, integrators=("leapfrog",))

    def __init__(self, options: Options, scene: Scene):
        self.strength = options.strength

    def kick(self, particles: Particles, a: Array, decay: Array, force_time: Array, h: float, coast: float) -> None:
        kick_with_friction(particles.velocity, a, particles.mass, decay, force_time, self.strength, h, coast)
