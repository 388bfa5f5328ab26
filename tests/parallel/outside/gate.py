"""A gate in the plane x = `place`: whoever went through it in a drift keeps a part of the velocity, and is counted."""

from typing import Annotated

import numpy as np
from pydantic import Field

from particles_mpi.effects import Column, EffectOptions, Event, Needs


class Options(EffectOptions):
    """`place`, and the part of the velocity that is kept."""

    place: float
    kept: Annotated[float, Field(gt=0.0, le=1.0)] = 0.5


class Effect(Event):
    formula = "v = kept v at x = place"
    needs = Needs(columns={"crossings": Column("int64")}, integrators=("leapfrog",))

    def __init__(self, options, scene):
        self.place, self.kept = options.place, options.kept

    def act(self, particles, h):
        after = particles.position[:, 0] - self.place
        before = after - particles.velocity[:, 0] * h
        through = (before < 0.0) != (after < 0.0)
        particles["crossings"] += through
        particles.velocity *= np.where(through, self.kept, 1.0)[:, None]
        return int(through.sum())
