"""Makes a scene with more particles, or fewer, at the same density, for weak scaling."""

from math import prod

from particles_mpi.errors import SceneError
from particles_mpi.initial.columns import is_listed
from particles_mpi.scene.schema import Scene


def scale_scene(scene: Scene, factor: float) -> Scene:
    """`factor` times the particles in `factor` times the space: every length of the layout grows by factor^(1/d), no radius does.

    A Plummer sphere keeps the mass of a particle and its density, hence also its dynamical time and what a step means.
    Raises SceneError, a line a fault, for a scene that lists particles.
    """
    tables, stretch = scene.to_dict(), factor ** (1.0 / scene.dimension)
    origin = tables["box"]["lower"] if scene.box else [0.0] * scene.dimension
    if faults := unable_to_grow(scene):
        raise SceneError(faults)

    def moved(point: list[float]) -> list[float]:
        return [o + (x - o) * stretch for o, x in zip(origin, point, strict=True)]

    if scene.box:
        tables["box"]["upper"] = moved(tables["box"]["upper"])
    for population in tables["particles"]:
        population["count"] = max(1, round(population["count"] * factor))
        if isinstance(population["position"], dict):
            population["position"] = {"plummer": population["position"]["plummer"] * stretch}
    for plane in tables["effects"].get("walls", {}).get("planes", []):
        plane["point"] = moved(plane["point"])
    return Scene.from_dict(tables, scene.folder)


def unable_to_grow(scene: Scene) -> list[str]:
    """Return a line for each value that is given particle by particle, which fixes their number; [] if the scene can grow."""
    faults = []
    for number, population in enumerate(scene.to_dict()["particles"]):
        for name, value in population.items():
            if is_listed(name, value, scene.dimension):
                faults.append(f"particles[{number}].{name}: is a list, with a value for each particle")
            if isinstance(value, dict) and "file" in value:
                faults.append(f"particles[{number}].{name}: comes from a file")
    return faults


def edges(scene: Scene) -> tuple[float, ...]:
    """Return the edges of the box, in units in which its volume is 1; open space counts as a cube."""
    if scene.box is None:
        return (1.0,) * scene.dimension
    sides = [high - low for low, high in zip(scene.box.lower, scene.box.upper, strict=True)]
    unit = prod(sides) ** (1.0 / len(sides))
    return tuple(side / unit for side in sides)
