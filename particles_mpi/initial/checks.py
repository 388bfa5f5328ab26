"""Checks of a start that need the particles: walls, overlaps, the length of a step. All of it is collective."""

from math import floor, inf, log10

import numpy as np

from particles_mpi.initial.faults import Faults, listed_ids
from particles_mpi.initial.overlaps import check_overlaps
from particles_mpi.initial.room import Room
from particles_mpi.initial.start_warnings import (
    coincident,
    endless_falls,
    idle_effects,
    planes_that_end,
    points_that_stick,
    rounded_end,
)
from particles_mpi.kernels.jit import kernel
from particles_mpi.particles import BUILT_IN, FIELDS, Array, Particles, row_dot
from particles_mpi.scene.effect import ConstantFriction
from particles_mpi.scene.model import LARGEST_NUMBER
from particles_mpi.scene.schema import Scene

MOST_CROSSINGS = 1e4  # of the box in a step
ROOM_FOR_SKINS = 1.001  # by which a periodic box is longer than two contact distances: lists of neighbours need room
FARTHEST = 1e6  # lengths of a periodic box, from which a given place can be brought back into it


def check_start(
    scene: Scene, particles: Particles, room: Room, faults: Faults, before: int = 0, judged: Array | None = None
) -> list[str]:
    """Return warnings about this rank's particles and add `faults`; overlaps that the scene allows are removed. Collective.

    The first `before` rows existed already, and are only checked for overlaps with new ones. Rows that are not `judged` (n,)
    overlap no other by the way they were made.
    """
    ranks = faults.ranks
    new = particles.select(np.arange(before, len(particles))) if before else particles
    check_places(new, room, faults)
    check_crossings(scene, new, faults)
    warnings, more = endless_falls(scene, particles, ranks) + ([] if before else rounded_end(scene) + planes_that_end(scene)), []
    if "collisions" in scene.effects and not faults.found and ranks.total(len(new))[0]:
        collisions = scene.effects["collisions"]
        more = check_step(scene, new, collisions.mode == "event", faults)
        if not faults.found:
            judged = np.ones(len(particles), bool) if judged is None else judged
            more += check_overlaps(particles, room, collisions.allow_overlap, before, judged, faults)
    return [
        *more,
        *warnings,
        *coincident(scene, particles, ranks),
        *points_that_stick(scene, particles, ranks),
        *idle_effects(scene, particles, ranks),
    ]


def check_places(particles: Particles, room: Room, faults: Faults) -> None:
    """Find centres outside the box, and movable spheres that are not fully inside a wall (fixed ones may stand in it)."""
    x = particles.position
    out = outside(x, room.lower, room.upper)
    faults.name("box: ", particles.id[out], " outside")
    for w, (point, normal) in enumerate(zip(room.point, room.normal, strict=True)):
        out = inside_wall(x, particles.radius, point, normal) & (particles.fixed == 0)
        place, direction = (", ".join(f"{number:g}" for number in vector) for vector in (point, normal))
        what = f" not fully on the free side of the wall at ({place}) with normal ({direction})"
        faults.name(f"effects.walls.planes[{w}]: ", particles.id[out], what)


@kernel
def outside(x, lower, upper):
    """Which rows of x (n, d) are outside of the box? (n,) bool."""
    out = np.zeros(len(x), np.bool_)
    for i in range(len(x)):
        for k in range(x.shape[1]):
            out[i] |= (x[i, k] < lower[k]) | (x[i, k] > upper[k])
    return out


@kernel
def inside_wall(x, radius, point, normal):
    """Which spheres at x (n, d) are at least in part inside the wall at `point` with `normal` (d,)? (n,) bool."""
    out = np.zeros(len(x), np.bool_)
    for i in range(len(x)):
        gap, size, shift = -radius[i], 0.0, 0.0
        for k in range(x.shape[1]):
            gap += (x[i, k] - point[k]) * normal[k]
            size, shift = max(size, abs(x[i, k])), max(shift, abs(point[k]))
        out[i] = gap < -1e-9 * radius[i] - 1e-14 * (size + shift)
    return out


def largest_component(vectors: Array) -> Array:
    """The largest absolute value of each row of (n, d); column by column, which is the faster way."""
    return np.asarray(np.max([np.abs(vectors[:, k]) for k in range(vectors.shape[1])], axis=0))


def check_crossings(scene: Scene, particles: Particles, faults: Faults) -> None:
    """Find particles that would cross the box so often in one step that the step would never end."""
    dt = scene.time.step
    speed = largest_component(particles.velocity) + dt * largest_pull(scene, particles)
    fast = (particles.fixed == 0) & crosses_too_often(scene, speed, dt)
    what = f" would cross the box more than {MOST_CROSSINGS:g} times in a step of {dt:g}; use a shorter step"
    faults.name("time.step: ", particles.id[fast], what)


def crosses_too_often(scene: Scene, speed: Array, dt: float) -> Array:
    """Would particles of these speeds (n,) cross the box so often in a step that it would never end?"""
    if scene.box is None or not {"walls", "collisions"} & scene.effects.keys():
        return np.zeros(len(speed), bool)
    edge = min(hi - lo for lo, hi in zip(scene.box.lower, scene.box.upper, strict=True))
    return ~(speed * dt <= MOST_CROSSINGS * edge)


def largest_pull(scene: Scene, particles: Particles) -> Array:
    """The largest component of the acceleration of each particle (n,) by the forces that are known before the start."""
    pull = largest_component(particles.arrays.get("acceleration", np.zeros((len(particles), 1))))
    if "uniform_gravity" in scene.effects:
        pull = pull + max(map(abs, scene.effects["uniform_gravity"].acceleration))
    return pull


def check_step(scene: Scene, particles: Particles, event: bool, faults: Faults) -> list[str]:
    """A step must be short against spheres (`rewind`), and contacts against a periodic box; returns warnings."""
    warnings, dt, ranks = [], scene.time.step, faults.ranks
    speed = np.sqrt(row_dot(particles.velocity, particles.velocity))
    radius, moving = particles.radius, speed > 0.0
    points = listed_ids(ranks, particles.id[moving & (radius == 0.0)])
    if points and not (event and scene.dimension == 1):
        line = ' (on a line they do in mode "event")' if scene.dimension == 1 else ""
        warnings.append(f"particles: {points} with radius 0: points collide with spheres, but never with one another{line}")
    if not event:
        fast = moving & (radius > 0.0) & (speed * dt > 2.0 * radius)
        safe = ranks.least((2.0 * radius[fast] / speed[fast]).min(initial=inf))
        verb = "crosses more than its" if ranks.total(np.count_nonzero(fast))[0] == 1 else "cross more than their"
        what = f" {verb} diameter in a step of {dt:g}; use a step <= {rounded_down(safe):g}" if safe < inf else ""
        faults.name("time.step: ", particles.id[fast], what)
    pull = largest_pull(scene, particles)
    coarse = (particles.fixed == 0) & (radius > 0.0) & (pull * dt * dt > radius)
    fine = ranks.least(np.sqrt(radius[coarse] / pull[coarse]).min(initial=inf))
    pushed = listed_ids(ranks, particles.id[coarse])
    if pushed:
        what = f"forces move {pushed} by more than a radius in a step of {dt:g}"
        warnings.append(
            f"time.step: {what}: contacts will be inaccurate, and piles slow; better use a step <= {rounded_down(fine):g}"
        )
    movable_radius = radius[particles.fixed == 0]
    widest, movable, fastest = ranks.largest(*(column.max(initial=0.0) for column in (radius, movable_radius, speed)))
    if event:  # a sphere must not meet two images of another
        least = 2.0 * (widest + movable) * ROOM_FOR_SKINS
        need = f"{ROOM_FOR_SKINS:g} times two contact distances, {least:.5g}"
    else:
        least = 2.0 * (widest + movable + 2.0 * fastest * dt)
        need = f"2 (R + R' + 2 v dt) = {least:g}, with R of the largest particle, R' of the largest moving, v of the fastest"
    for k, length in enumerate(scene.periodic_length):
        if 0.0 < length <= least:
            faults.add(f"box: periodic axis {k} is {length:g} long, but collisions need more than {need}")
    return warnings


def value_limits(scene: Scene, particles: Particles, values: dict[str, Array], h: float) -> dict[str, Array]:
    """Which of the values (n,) or (n, width) given to some fields are possible, in steps of h, by name: (n,) bool each."""
    allowed: dict[str, Array] = {}
    for name in values.keys() & FIELDS.keys():
        if FIELDS[name].least > -np.inf:
            allowed[name] = (values[name] >= FIELDS[name].least) & (values[name] <= LARGEST_NUMBER)
        elif name in BUILT_IN and FIELDS[name].dtype == "float64":
            numbers = np.isfinite(values[name]) | (values[name] == FIELDS[name].default)
            allowed[name] = numbers.reshape(len(numbers), -1).all(axis=1)
    if "position" in values and scene.box:
        lower, length = np.array(scene.box.lower), np.subtract(scene.box.upper, scene.box.lower)
        within_reach = np.abs(values["position"] - lower) <= FARTHEST * np.where(scene.box.periodic, length, np.inf)
        allowed["position"] &= within_reach.all(axis=1)  # from further away round-off leaves no place in the box
    if "velocity" in values:
        allowed["velocity"] &= ~crosses_too_often(scene, largest_component(values["velocity"]), h)
    if "fixed" in values:
        allowed["fixed"] = values["fixed"] <= 1
    if {"mass", "fixed"} & values.keys():
        mass, fixed = (values.get(name, particles[name]) for name in ("mass", "fixed"))
        needed = np.zeros(len(mass), bool)
        for dividing in divided_masses(scene, fixed).values():
            needed |= dividing
        possible = (mass >= 1.0 / LARGEST_NUMBER) | ((mass == 0.0) & ~needed)
        name = "mass" if "mass" in values else "fixed"
        allowed[name] = allowed.get(name, True) & possible & (mass <= LARGEST_NUMBER)
    return allowed


def divided_masses(scene: Scene, fixed: Array) -> dict[str, Array]:
    """By effect that divides by masses: does it by that of each particle (n,)? Friction by all, others by those not `fixed`."""
    return {
        name: np.full(len(fixed), True) if issubclass(options.effect_class(), ConstantFriction) else fixed == 0
        for name, options in scene.effects.items()
        if options.divides_by_mass
    }


def rounded_down(value: float) -> float:
    """To three digits, never up."""
    if not value > 1e-290:
        return value
    unit = 10.0 ** (floor(log10(value)) - 2)
    return floor(value / unit) * unit
