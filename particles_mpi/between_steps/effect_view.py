"""The effects of a scene while it runs: options that are read, and changed between two steps."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import ValidationError

from particles_mpi.errors import SceneError
from particles_mpi.scene.effect import EffectOptions
from particles_mpi.scene.model import faults_of
from particles_mpi.scene.schema import Scene


class RunningEffect:
    """`sim.effects["uniform_gravity"].acceleration = [0, 0, -1]`, `sim.effects["walls"].active = False`.

    The attributes are the keys of the effect's table in the scene file. A new value is checked as there (SceneError) and
    counts from the next step on. On several ranks all must set the same. Lists are shown as tuples: a vector is set whole.
    """

    def __init__(self, sim: Any, name: str):
        vars(self).update(_sim=sim, _name=name)

    @property
    def _options(self) -> EffectOptions:
        options: EffectOptions = self._sim.scene.effects[self._name]
        return options

    def __getattr__(self, key: str) -> Any:
        if key.startswith("_") or key not in type(self._options).model_fields:
            raise AttributeError(f"effects.{self._name}: no option {key!r}")
        value = getattr(self._options, key)
        return tuple(value) if isinstance(value, list) else value

    def __setattr__(self, key: str, value: Any) -> None:
        getattr(self, key)
        self._sim.change_effect(self._name, key, value)

    def __repr__(self) -> str:
        return f"{self._name}: {self._options!r}"


def changed_options(scene: Scene, name: str, key: str, value: Any) -> EffectOptions:
    """The options of an effect with another value of one key. Raises SceneError as a scene file with it would."""
    old: EffectOptions = scene.effects[name]
    kind = type(old)
    plain = value.tolist() if isinstance(value, np.ndarray | np.generic) else list(value) if isinstance(value, tuple) else value
    try:
        new = kind.model_validate(old.model_dump() | {key: plain})
    except ValidationError as error:
        raise SceneError(faults_of(error, kind, ("effects", name))) from None
    faults = [f"effects.{name}.{fault}" for fault in new.faults(scene)]
    if faults:
        raise SceneError(faults)
    return new
