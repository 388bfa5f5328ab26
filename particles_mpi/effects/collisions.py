"""Collisions of spheres: hard contacts with an impulse along the normal, by the operator that `mode` names."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field

from particles_mpi.collide.contact import loss
from particles_mpi.scene import NOT_YET, Fraction, Model, Scene


def _mode(value: object) -> object:
    if value == "event":
        raise ValueError(NOT_YET["event"].split(": ", 1)[1])
    if value != "rewind":
        raise ValueError(f'must be "rewind" or "event" (got {value!r})')
    return value


class Options(Model):
    """`mode`; `restitution` e (momentum is conserved) or `damping` alpha (the course's rule: it is not); `passes` a step."""

    mode: Annotated[str, BeforeValidator(_mode)] = "rewind"
    restitution: Fraction | None = None
    damping: Fraction | None = None
    allow_overlap: bool = False
    passes: Annotated[int, Field(ge=1)] = 10

    def faults(self, scene: Scene) -> list[str]:
        both = self.restitution is not None and self.damping is not None
        return ["restitution: give restitution or damping, not both"] if both else []


class Effect:
    """Pairs of spheres collide. The operator lives in `collide/`; this names what it needs."""

    role = "event"
    fields = ()
    formula = "v_i -= (1+e) mu/m_i (k.v_r) k at |x_i - x_j| = R_i + R_j"
    pairs = True
    divides_by_mass = True

    def __init__(self, options: Options, scene: Scene):
        self.options = options
        self.restitution, self.keep = loss(options.restitution, options.damping)
