"""Warnings about a start that is allowed, but whose results may surprise the user."""

import numpy as np

from particles_mpi.initial.faults import listed_ids
from particles_mpi.initial.overlaps import listed_pairs
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.decomposition import bisect, to_owners
from particles_mpi.particles import Array, Particles
from particles_mpi.scene.schema import Scene

POINT = 1e-13  # of a coordinate: a radius that is nothing but its round-off
IDLE = {  # by effect: the field by which it acts on a particle, and what is said where it is 0 for all
    "drag": ("drag", "slows no particle: it has no rate, and no particle has a drag of its own"),
    "user_acceleration": ("acceleration", "moves no particle: none has an acceleration"),
    "mutual_gravity": ("mass", "moves no particle: none has a mass"),
}


def rounded_end(scene: Scene) -> list[str]:
    """A warning where no whole number of steps ends at `time.end`."""
    step, end, steps = scene.time.step, scene.time.end, scene.steps
    if end is None or abs(steps * step - end) <= 1e-6 * step:
        return []
    ends = f"the run ends at t = {steps * step:g}, after step {steps}"
    return [f"time.end: {end:g} is not a whole number of steps of {step:g}: {ends}"]


def planes_that_end(scene: Scene) -> list[str]:
    """Warnings of planes that stop at the border of the box, where particles go round."""
    planes = (scene.active["walls"].planes or []) if "walls" in scene.active else []
    axes = [[k for k in np.flatnonzero(scene.periodic).tolist() if plane.normal[k] != 0.0] for plane in planes]
    return [
        f"effects.walls.planes[{number}].normal: not zero along periodic axis {crossed[0]}:"
        " a particle that leaves the box there may come back behind the plane"
        for number, crossed in enumerate(axes)
        if crossed
    ]


def endless_falls(scene: Scene, particles: Particles, ranks: Communicator) -> list[str]:
    """Warn of forces along a periodic axis, which have no potential: a particle gains energy in each turn around the box."""
    axes, drawn = np.flatnonzero(scene.periodic), []
    if "uniform_gravity" in scene.active:
        along = np.array(scene.active["uniform_gravity"].acceleration)[axes] != 0.0
        drawn.append(("uniform_gravity.acceleration: not zero", axes[along]))
    if "user_acceleration" in scene.active and len(axes):
        pushed = (particles["acceleration"][:, axes] != 0.0) & (particles.fixed == 0)[:, None]
        named = listed_ids(ranks, particles.id[pushed.any(axis=1)])
        along = ranks.allreduce_max(pushed.any(axis=0).astype(np.int64)) > 0
        drawn.append((f"user_acceleration: not zero for {named}", axes[along]))
    return [
        f"effects.{what} along periodic {'axis' if len(along) == 1 else 'axes'} {' and '.join(map(str, along))}:"
        " such a force has no potential energy; potential and total_energy will be nan"
        for what, along in drawn
        if len(along)
    ]


def idle_effects(scene: Scene, particles: Particles, ranks: Communicator) -> list[str]:
    """Warnings of effects that change nothing: they have no strength, or no particle has what they act by."""
    effects, gravity = scene.active, scene.active.get("mutual_gravity")
    names = [name for name in IDLE if name in effects]
    acting = ranks.total(*(np.count_nonzero(particles[IDLE[name][0]]) for name in names)) if names else []
    idle = [f"effects.{name}: {IDLE[name][1]}" for name, some in zip(names, acting, strict=True) if not some]
    weak = {
        "uniform_gravity.acceleration": "uniform_gravity" in effects and not any(effects["uniform_gravity"].acceleration),
        "friction.strength": "friction" in effects and effects["friction"].strength == 0.0,
        "mutual_gravity.G": gravity is not None and gravity.strength(scene) == 0.0,
    }
    return idle + [f"effects.{key}: 0, which changes nothing" for key, is_weak in weak.items() if is_weak]


def points_that_stick(scene: Scene, particles: Particles, ranks: Communicator) -> list[str]:
    """Warn of points on a line that lose energy to one another: at one place, nothing says which one is on which side."""
    pairs = scene.active.get("collisions")
    if scene.dimension > 1 or pairs is None or pairs.mode != "event" or pairs.restitution in (None, 1.0):
        return []
    small = particles.radius <= POINT * np.abs(particles.position[:, 0])
    points, total = ranks.total(np.count_nonzero(small), len(particles))
    if points < 2 or total < 3:
        return []
    advice = "give them a radius above the round-off of their places"
    return [f"effects.collisions: points that stick together on a line let a third one pass: {advice}"]


def coincident(scene: Scene, particles: Particles, ranks: Communicator) -> list[str]:
    """A warning of bodies at the same place that attract one another without softening: the law has no value there."""
    gravity = scene.active.get("mutual_gravity")
    if gravity is None or gravity.softening > 0.0 or gravity.strength(scene) == 0.0:
        return []
    columns = {name: particles[name] for name in ("id", "position", "mass", "fixed")}
    if ranks.size > 1:  # those at the same place to the same rank
        columns = to_owners(ranks, columns, bisect(ranks, particles.position, 1.0))
    pairs = coincident_pairs(columns)
    text = listed_pairs(ranks, *pairs)
    if not text:
        return []
    verb = "are" if text.startswith("pairs") else "is"
    return [
        f"effects.mutual_gravity: {text} {verb} at the same place: no force acts between these two; move one, or set softening"
    ]


def coincident_pairs(columns: dict[str, Array]) -> tuple[Array, Array]:
    """(lower ids, higher ids) of particles at the same place, each one with the next id there.

    Only of places where at least one particle has mass and at least one is not fixed.
    """
    x, ids, mass, fixed = (columns[name] for name in ("position", "id", "mass", "fixed"))
    order = np.argsort(x[:, 0], kind="stable")
    equal = x[order[1:], 0] == x[order[:-1], 0]
    rows = order[(np.append(equal, False) | np.append(False, equal))[: len(order)]]  # few or none, but for a lattice
    if not len(rows):
        return ids[:0], ids[:0]
    place = np.unique(x[rows], axis=0, return_inverse=True)[1].ravel()
    by_id = np.lexsort((ids[rows], place))
    rows, place = rows[by_id], place[by_id]
    active = (np.bincount(place, fixed[rows] == 0) > 0) & (np.bincount(place, mass[rows] > 0.0) > 0)
    met = (place[1:] == place[:-1]) & active[place[1:]]
    return ids[rows[:-1][met]], ids[rows[1:][met]]
