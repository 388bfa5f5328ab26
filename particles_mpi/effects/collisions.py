"""Collisions of spheres: hard contacts with an impulse along the normal, by the operator that `mode` names."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from particles_mpi.contacts.law import loss
from particles_mpi.scene.effect import FORWARD, Needs, PairContacts
from particles_mpi.scene.model import EffectOptions
from particles_mpi.scene.schema import Fraction, Scene


class Options(EffectOptions):
    """`mode`; `restitution` e (momentum is conserved) or `damping` alpha (the course's rule: it is not).

    `passes` a step, in mode rewind. `contact_duration` t_c, in mode event: a contact within t_c of the last one of either
    partner takes no energy, which keeps inelastic collapse from stopping the clock; a ten-thousandth of a step if not given.
    """

    mode: Literal["rewind", "event"] = "rewind"
    restitution: Fraction | None = None
    damping: Fraction | None = None
    allow_overlap: bool = False
    passes: Annotated[int, Field(ge=1)] = 10
    contact_duration: Annotated[float, Field(ge=0.0)] | None = None

    def faults(self, scene: Scene) -> list[str]:
        faults = []
        if self.restitution is not None and self.damping is not None:
            faults.append("restitution: give restitution or damping, not both")
        for key, mode in (("passes", "rewind"), ("contact_duration", "event")):
            if getattr(self, key) != type(self).model_fields[key].default and self.mode != mode:
                faults.append(f'{key}: only in mode "{mode}"')
        return faults


class Effect(PairContacts):
    """Pairs of spheres collide. The operator lives in `contacts/`; this names what it needs."""

    formula = "v_i -= (1+e) mu/m_i (k.v_r) k at |x_i - x_j| = R_i + R_j"
    needs = Needs(divides_by_mass=True, integrators=FORWARD)

    def __init__(self, options: Options, scene: Scene):
        self.options = options
        self.restitution, self.keep = loss(options.restitution, options.damping)
        self.lossy = self.restitution < 1.0 or self.keep < 1.0
