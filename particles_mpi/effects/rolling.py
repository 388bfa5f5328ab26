"""Resistance to rolling: a contact that lasts exerts a couple against the rolling and spinning of its partners."""

from particles_mpi.scene.effect import EffectOptions, Force, Needs, RollingResistance
from particles_mpi.scene.model import NotNegative
from particles_mpi.scene.schema import Scene


class Options(EffectOptions):
    """`resistance`: the length b, usually a part of a radius. The largest couple of a contact with the normal force N is b N.

    The couple has that magnitude at any speed, and up to that at rest (Y. C. Zhou, B. D. Wright, R. Y. Yang, B. H. Xu and A. B.
    Yu, Physica A 269, 536 (1999), their directional constant torque). It needs friction, without which nothing rolls.
    """

    resistance: NotNegative

    def faults(self, scene: Scene) -> list[str]:
        if not scene.rough:
            return ["resistance: spheres roll only with friction in [effects.collisions] or [effects.walls]"]
        if not any(issubclass(options.effect_class(), Force) for options in scene.effects.values()):
            return ["resistance: acts only in lasting contacts, and there are none without a force"]
        return []


class Effect(RollingResistance):
    """Acts in the solution for contacts that last. A hit is over at once, so the couple has no time to act in it."""

    formula = "|couple| <= b N, against rolling in lasting contacts"
    needs = Needs(divides_by_mass=True, integrators=("leapfrog",))

    def __init__(self, options: Options, scene: Scene):
        self.resistance = options.resistance
