"""The options of effects as a user sees and changes them between two steps."""

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from pydantic import BaseModel, ValidationError

from particles_mpi.between_steps.views import read_only
from particles_mpi.errors import SceneError
from particles_mpi.initial.checks import divided_masses
from particles_mpi.parallel.agreement import raising_together, same_on_all
from particles_mpi.scene.active import ActiveEffects
from particles_mpi.scene.calls import built, faults_in
from particles_mpi.scene.effect import EffectOptions, Force
from particles_mpi.scene.model import faults_of, python_values, suggestion
from particles_mpi.scene.schema import Scene


class Part(Mapping[str, Any]):
    """A table within an option, as it is shown: for reading only."""

    def __init__(self, table: BaseModel):
        vars(self).update(_table=table)

    def __getattr__(self, key: str) -> Any:
        if key == "_table":  # while it is copied
            raise AttributeError(key)
        return frozen(getattr(self._table, key))

    def __getitem__(self, key: str) -> Any:
        return frozen(dict(self._table)[key])

    def __iter__(self) -> Iterator[str]:
        return iter(dict(self._table))

    def __len__(self) -> int:
        return len(dict(self._table))

    def __setattr__(self, key: str, value: Any) -> None:
        raise AttributeError(f"{key}: a part of an option cannot be set; set the option as a whole")

    def __eq__(self, other: object) -> bool:
        return bool(self._table == (other._table if isinstance(other, Part) else other))

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return repr(self._table)


def frozen(value: Any) -> Any:
    """Return an option as a user sees it: read-only, because a change to a part of it would have no effect."""
    if isinstance(value, list | tuple):
        return tuple(map(frozen, value))
    if isinstance(value, dict):
        return MappingProxyType({key: frozen(inner) for key, inner in value.items()})
    if isinstance(value, np.ndarray):
        return read_only(value.view())
    return Part(value) if isinstance(value, BaseModel) else value


class RunningEffect:
    """`sim.effects["uniform_gravity"].acceleration = [0, 0, -1]`, `sim.effects["walls"].active = False`.

    The attributes are the keys of the effect's table in the scene file. A new value is checked as in the file (SceneError) and
    counts from the next step on. All ranks must set the same value. Lists appear as tuples: a vector can only be set as a whole.
    """

    def __init__(self, sim: Any, name: str):
        vars(self).update(_sim=sim, _name=name)

    @property
    def _options(self) -> Any:
        return self._sim.scene.effects[self._name]

    def __getattr__(self, key: str) -> Any:
        if key.startswith("_") or key not in type(self._options).model_fields:
            raise AttributeError(f"effects.{self._name}: no option {key!r}")
        return frozen(getattr(self._options, key))

    def __setattr__(self, key: str, value: Any) -> None:
        getattr(self, key)  # an unknown key is an error
        change_effect(self._sim, self._name, key, value)

    def __repr__(self) -> str:
        return f"{self._name}: {self._options!r}"


class RunningEffects(dict[str, RunningEffect]):
    """The effects of a scene by name."""

    def __missing__(self, name: str) -> RunningEffect:
        raise KeyError(f"effects: the scene has no {name}{suggestion(name, list(self)) if self else ''}")


def changed_options(scene: Scene, name: str, key: str, value: Any) -> EffectOptions:
    """Return the options of an effect with another value of one key. Raises SceneError if a scene file with it would."""
    old: EffectOptions = scene.effects[name]
    kind = type(old)
    if key == "file":
        raise SceneError(f"effects.{name}.file: cannot be changed between two steps; make another scene")
    try:
        new = kind.model_validate(old.model_dump() | {key: python_values(value)})
    except ValidationError as error:
        raise SceneError(faults_of(error, kind, ("effects", name))) from None
    if faults := faults_in(name, new, scene):
        raise SceneError(faults)
    return new


def require_masses(sim: Any, scene: Scene, name: str, key: str) -> None:
    """Raise SceneError if the effect, as in `scene`, divides by masses and there is a particle without one. Collective."""
    p = sim.rows
    without = p.id[divided_masses(scene, p.fixed).get(name, False) & (p.mass == 0.0)]
    first = sim.ranks.least(float(without.min()) if len(without) else np.inf)
    if first < np.inf:
        raise SceneError([f"effects.{name}.{key}: it divides by masses, but particle {first:.0f} has none"])


def change_effect(sim: Any, name: str, key: str, value: Any) -> None:
    """Give an option of an effect another value, from the next step on; checked as in a scene file. Collective.

    `sim`: a `State`.
    """
    same_on_all(sim.ranks, {"effects": {name: {key: python_values(value)}}})
    options = changed_options(sim.scene, name, key, value).running()
    sim.take_changes()
    scene = sim.scene.model_copy(update={"effects": {**sim.scene.effects, name: options}})
    require_masses(sim, scene, name, key)
    if scene.outside:
        with raising_together(sim.ranks):  # what cannot be made or bound leaves all as it is
            ActiveEffects(scene).bind(sim.context)
    options.effect_class().option_changed(sim.rows, sim.scene.effects[name], options)
    sim.particles.show()
    sim.scene = scene
    # An effect of a file may have read the option, too
    if issubclass(options.effect_class(), Force) and not scene.outside and options.active and key != "active":
        force = built(name, options, scene)
        force.bind(sim.context)
        sim.accelerations.replace(name, force)
        sim.active.all[name] = sim.active.forces[name] = force
        sim.look_for_many_steps()
        sim.rows.edition += 1
        sim.forget_contacts()
    else:
        sim.build()
