"""A table `[[particles]]` of a scene file, and what is wrong with it in its scene."""

from typing import Annotated, Any

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from particles_mpi.scene.model import (
    Flags,
    Model,
    Position,
    Scalar,
    Spin,
    SpinVector,
    Vectors,
    Velocity,
    key_of,
    suggestion,
    wrong_length,
)


class Population(Model):
    """Particles that are described together. Further keys are columns of effects from outside, which the scene checks."""

    model_config = ConfigDict(extra="allow")

    count: Annotated[int, Field(ge=0, le=10**18)] | None = None
    position: Position
    velocity: Velocity = None
    radius: Scalar = None
    mass: Scalar = None
    fixed: Flags = None
    drag: Scalar = None
    acceleration: Vectors = None
    spin: Any = None
    moment_of_inertia: Scalar = None


def population_faults(scene: Any, key: str, population: Population) -> list[str]:
    """What is wrong with a population in a `Scene`, each beginning with `key`; [] if nothing is."""
    d, position, faults = scene.dimension, population.position, []
    plummer = isinstance(position, dict) and "plummer" in position
    if population.count is None and (plummer or isinstance(position, str)):
        faults.append(f"{key}.count: needed with position = " + ("{plummer = a}" if plummer else f'"{position}"'))
    if scene.box is None and isinstance(position, str):
        faults.append(f'{key}.position: "{position}" needs a [box]')
    if plummer and d != 3:
        faults.append(f"{key}.position: a Plummer sphere needs dimension 3")
    if population.velocity == "equilibrium" and not (plummer and "mutual_gravity" in scene.effects):
        faults.append(f'{key}.velocity: "equilibrium" needs position = {{plummer = a}} and [effects.mutual_gravity]')
    for name in ("position", "velocity", "acceleration"):
        if (value := getattr(population, name)) != []:  # a list of no vectors is one for no particles
            faults += wrong_length(f"{key}.{name}", value, d)
    for name, value in (population.model_extra or {}).items():
        if name not in scene.columns:
            faults.append(f"{key_of((key, name))}: unknown key{suggestion(name, [*Population.model_fields, *scene.columns])}")
            continue
        vector = scene.columns[name].vector
        faults += wrong_value(f"{key}.{name}", value, Vectors if vector else Scalar, d if vector else 0)
    for name in ("spin", "moment_of_inertia"):
        if getattr(population, name) is not None and not (scene.rough or name in scene.columns):
            faults.append(f"{key}.{name}: spheres turn only with friction in [effects.collisions] or [effects.walls]")
    if population.spin is not None and (scene.rough or "spin" in scene.columns):
        faults += wrong_value(f"{key}.spin", population.spin, *((Spin, 0) if d == 2 else (SpinVector, 3)))
    for name, effect in (("drag", "drag"), ("acceleration", "user_acceleration")):
        if getattr(population, name) is not None and effect not in scene.effects and name not in scene.columns:
            faults.append(f"{key}.{name}: needs [effects.{effect}]")
    return faults


def wrong_value(key: str, value: Any, kind: Any, components: int) -> list[str]:
    """Return a fault if `value` is not of this `kind`, or not a vector of so many `components` (if not 0)."""
    try:
        TypeAdapter(kind).validate_python(value)
    except ValidationError as error:
        return [f"{key}: {error.errors()[0]['ctx']['error']}"]
    return wrong_length(key, value, components) if components and value != [] else []
