"""What can only be judged with the particles at hand: walls, overlaps, the length of a step."""

from __future__ import annotations

from math import floor, log10

import numpy as np

from particles_mpi.errors import listed
from particles_mpi.initial.overlaps import check_overlaps, listed_pairs
from particles_mpi.initial.placement import Container
from particles_mpi.particles import FIELDS, Array, Particles
from particles_mpi.scene.effect import ConstantFriction
from particles_mpi.scene.model import LARGEST
from particles_mpi.scene.schema import Scene, periodic_length

MOST_CROSSINGS = 1e4  # of the box in a step


def check_start(scene: Scene, particles: Particles, room: Container, before: int = 0) -> tuple[list[str], list[str]]:
    """(faults, warnings) of particles in id order; overlaps that the scene allows are pushed apart in place.

    The first `before` of them were there already: nothing is asked of them but that the others do not overlap them.
    """
    new = particles.select(np.arange(before, len(particles))) if before else particles
    faults, warnings = check_places(new, room) + check_crossings(scene, new), endless_falls(scene, particles)
    if "collisions" in scene.effects and not faults and len(new):
        collisions = scene.effects["collisions"]
        faults, more = check_step(scene, new, collisions.mode == "event")
        if not faults:
            faults, overlaps = check_overlaps(particles, room, collisions.allow_overlap, before)
            more += overlaps
        warnings = more + warnings
    return faults, warnings + coincident(scene, particles)


def endless_falls(scene: Scene, particles: Particles) -> list[str]:
    """Warnings of forces with a component along a periodic axis: their work has no potential, for each turn takes more of it."""
    axes, drawn = np.flatnonzero(scene.periodic), []
    if "uniform_gravity" in scene.effects:
        along = np.array(scene.effects["uniform_gravity"].acceleration)[axes] != 0.0
        drawn.append(("uniform_gravity.acceleration: not zero", axes[along]))
    if "user_acceleration" in scene.effects:
        pushed = (particles["acceleration"][:, axes] != 0.0) & (particles.fixed == 0)[:, None]
        who = particles.id[pushed.any(axis=1)]
        if len(who):
            drawn.append((f"user_acceleration: not zero for {listed(who)}", axes[pushed.any(axis=0)]))
    return [
        f"effects.{what} along periodic {'axis' if len(along) == 1 else 'axes'} {' and '.join(map(str, along))}:"
        " there is no potential energy along an axis without an end; potential and total_energy will be nan"
        for what, along in drawn
        if len(along)
    ]


def coincident(scene: Scene, particles: Particles) -> list[str]:
    """A warning of bodies at the same place that attract one another without softening: the law has no value there."""
    gravity = scene.effects.get("mutual_gravity")
    if gravity is None or gravity.softening > 0.0 or (scene.G if gravity.G is None else gravity.G) == 0.0:
        return []
    x, ids = particles.position, particles.id
    order = np.argsort(x[:, 0], kind="stable")
    equal = x[order[1:], 0] == x[order[:-1], 0]
    rows = order[(np.append(equal, False) | np.append(False, equal))[: len(order)]]  # few or none, but for a lattice
    if not len(rows):
        return []
    place = np.unique(x[rows], axis=0, return_inverse=True)[1]
    by_id = np.lexsort((ids[rows], place))
    rows, place = rows[by_id], place[by_id]
    active = (np.bincount(place, particles.fixed[rows] == 0) > 0) & (np.bincount(place, particles.mass[rows] > 0.0) > 0)
    met = (place[1:] == place[:-1]) & active[place[1:]]
    if not met.any():
        return []
    first, second = rows[:-1][met], rows[1:][met]
    order = np.argsort(ids[first])
    return [
        f"effects.mutual_gravity: {listed_pairs(particles, first[order], second[order])}"
        f" {'are' if len(first) > 1 else 'is'} at the same place at the start:"
        " no force acts between the two; move one, or give a softening"
    ]


def check_places(particles: Particles, room: Container) -> list[str]:
    """Centres outside the box, and movable spheres that are not fully inside a wall (fixed ones may stand in it)."""
    x, faults = particles.position, []
    out = np.flatnonzero(((x < room.lower) | (x > room.upper)).any(axis=1))
    if len(out):
        faults.append(f"box: {listed(particles.id[out])} outside")
    for w, (point, normal) in enumerate(zip(room.point, room.normal, strict=True)):
        gap = (x - point) @ normal - particles.radius
        size = np.abs(point).max() + np.abs(x).max(axis=1, initial=0.0)
        out = np.flatnonzero((particles.fixed == 0) & (gap < -1e-9 * particles.radius - 1e-14 * size))
        if len(out):
            place, direction = (", ".join(f"{number:g}" for number in vector) for vector in (point, normal))
            faults.append(
                f"effects.walls.planes[{w}]: {listed(particles.id[out])} not fully inside the wall at ({place})"
                f" with normal ({direction})"
            )
    return faults


def check_crossings(scene: Scene, particles: Particles) -> list[str]:
    """Who would meet so many others, or walls, in one step that the step would never end."""
    if scene.box is None or not {"walls", "collisions"} & scene.effects.keys():
        return []
    edge, dt = min(hi - lo for lo, hi in zip(scene.box.lower, scene.box.upper, strict=True)), scene.time.step
    pull = np.abs(particles.arrays.get("acceleration", np.zeros((1, 1)))).max(axis=1)
    if "uniform_gravity" in scene.effects:
        pull = pull + max(map(abs, scene.effects["uniform_gravity"].acceleration))
    speed = np.abs(particles.velocity).max(axis=1) + dt * pull
    fast = np.flatnonzero((particles.fixed == 0) & ~(speed * dt <= MOST_CROSSINGS * edge))
    if not len(fast):
        return []
    return [f"time.step: {listed(particles.id[fast])} would cross the box more than {MOST_CROSSINGS:g} times in a step of {dt:g}"]


def check_step(scene: Scene, particles: Particles, event: bool) -> tuple[list[str], list[str]]:
    """A step must be short against spheres (`rewind`), and contacts against a periodic box."""
    faults, warnings, dt = [], [], scene.time.step
    speed = np.sqrt((particles.velocity**2).sum(axis=1))
    radius, moving = particles.radius, speed > 0.0
    points = np.flatnonzero(moving & (radius == 0.0))
    if len(points) and not (event and scene.dimension == 1):
        warnings.append(f"particles: {listed(particles.id[points])} with radius 0: points meet spheres, but never one another")
    fast = np.flatnonzero(moving & (radius > 0.0) & (speed * dt > 2.0 * radius))
    if not event and len(fast):
        safe = rounded_down(float((2.0 * radius[fast] / speed[fast]).min()))
        verb = "crosses more than its" if len(fast) == 1 else "cross more than their"
        faults.append(f"time.step: {listed(particles.id[fast])} {verb} diameter in a step of {dt:g}; use a step <= {safe:g}")
    if event:  # a sphere must not meet two images of another
        least = 2.0 * float(radius.max() + radius[particles.fixed == 0].max(initial=0.0)) * 1.01
        need = f"two contact distances, {least:g}"
    else:
        least = 2.0 * (2.0 * float(radius.max()) + 2.0 * float(speed.max()) * dt)
        need = f"2 (2 R + 2 v dt) = {least:g} for the largest and the fastest particle"
    for k, length in enumerate(periodic_length(scene)):
        if 0.0 < length < least:
            faults.append(f"box: periodic axis {k} is {length:g} long, but collisions need {need}")
    return faults, warnings


def value_limits(scene: Scene, particles: Particles, values: dict[str, Array]) -> dict[str, Array]:
    """Which of the values (n,) given to some fields are possible, by name. Those that are no numbers are found elsewhere."""
    allowed: dict[str, Array] = {}
    for name in values.keys() & FIELDS.keys():
        if FIELDS[name].least > -np.inf and not FIELDS[name].vector:
            allowed[name] = (values[name] >= FIELDS[name].least) & (values[name] <= LARGEST)
    if {"mass", "fixed"} & values.keys():
        mass, fixed = (values.get(name, particles[name]) for name in ("mass", "fixed"))
        needed = np.zeros(len(mass), bool)
        for dividing in divided_masses(scene, fixed).values():
            needed |= dividing
        possible = (mass >= 1.0 / LARGEST) | ((mass == 0.0) & ~needed)
        allowed["mass" if "mass" in values else "fixed"] = possible & (mass <= LARGEST)
    return allowed


def divided_masses(scene: Scene, fixed: Array) -> dict[str, Array]:
    """By effect that divides by masses: does it by that of each particle (n,)? Friction by all, others by those not `fixed`."""
    classes = {name: options.effect_class() for name, options in scene.effects.items()}
    return {
        name: np.full(len(fixed), True) if issubclass(effect, ConstantFriction) else fixed == 0
        for name, effect in classes.items()
        if effect.needs.divides_by_mass
    }


def rounded_down(value: float) -> float:
    """To three digits, never up."""
    if not value > 1e-290:
        return value
    unit = 10.0 ** (floor(log10(value)) - 2)
    return floor(value / unit) * unit
