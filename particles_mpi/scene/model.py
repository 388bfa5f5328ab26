"""The base of all tables of a scene file: strict, and sealed while a simulation goes by it."""

from __future__ import annotations

import sys
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, PrivateAttr


class Model(BaseModel):
    """Strict: an unknown key, or a number given as text, is a fault and not a guess."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    _running: bool = PrivateAttr(False)  # does a simulation go by it?

    def __setattr__(self, name: str, value: Any) -> None:
        if name in type(self).model_fields and self._running:
            raise AttributeError(
                f"{name}: the scene of a simulation stays as it is, for the simulation would not see the change;"
                " set sim.h, sim.time, or an option of sim.effects[name]"
            )
        super().__setattr__(name, value)

    def running(self) -> Self:
        """A copy, down to the tables, that a simulation goes by and that can no longer be changed."""
        tables = {name: value.running() for name in type(self).model_fields if isinstance(value := getattr(self, name), Model)}
        copy = self.model_copy(update=tables)
        copy._running = True
        return copy


class EffectOptions(Model):
    """The keys of a table `[effects.NAME]`. An effect that is not `active` does nothing until it is switched on.

    `file`: where an effect from outside the program stands, relative to the scene file.
    """

    active: bool = True
    file: str | None = None

    @classmethod
    def effect_class(cls) -> Any:
        """The class `Effect` of the file in which these options are defined."""
        return vars(sys.modules[cls.__module__])["Effect"]

    def build(self, scene: Any) -> Any:
        """The effect with these options."""
        return self.effect_class()(self, scene)

    def described(self, scene: Any, total: int) -> str:
        """How the effect is computed for `total` particles, in a few words for the plan; "" if there is only one way."""
        return ""

    def faults(self, scene: Any) -> list[str]:
        """What is wrong with these options in this scene, each beginning with the key; [] if nothing is."""
        return []
