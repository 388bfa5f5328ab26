"""What can only be judged with the particles at hand: walls, overlaps, the length of a step."""

from __future__ import annotations

from math import floor, log10

import numpy as np

from particles_mpi.initial.names import listed, pair_names
from particles_mpi.initial.overlaps import check_overlaps
from particles_mpi.initial.placement import Container
from particles_mpi.particles import FIELDS, Array, Particles
from particles_mpi.scene.effect import ConstantFriction
from particles_mpi.scene.model import LARGEST
from particles_mpi.scene.schema import Scene

MOST_CROSSINGS = 1e4  # of the box in a step


def check_start(scene: Scene, particles: Particles, room: Container | None, before: int = 0) -> tuple[list[str], list[str]]:
    """(faults, warnings) of particles in id order; overlaps that the scene allows are pushed apart in place.

    The first `before` of them were there already: nothing is asked of them but that the others do not overlap them.
    """
    new = particles.select(np.arange(before, len(particles))) if before else particles
    faults = check_places(scene, new, room) + check_crossings(scene, new)
    warnings: list[str] = []
    if "collisions" in scene.effects and not faults and len(new):
        faults, warnings = check_step(scene, new)
        if not faults:
            more_faults, more_warnings = check_overlaps(scene, particles, room, before)
            faults, warnings = faults + more_faults, warnings + more_warnings
    return faults, warnings + endless_falls(scene, particles) + coincident(scene, particles)


def endless_falls(scene: Scene, particles: Particles) -> list[str]:
    """Warnings of forces with a component along a periodic axis: their work has no potential, for each turn takes more of it."""
    axes = np.flatnonzero(scene.periodic)
    drawn: list[tuple[str, Array]] = []
    if "uniform_gravity" in scene.effects:
        along = np.array(scene.effects["uniform_gravity"].acceleration)[axes] != 0.0
        drawn += [("uniform_gravity.acceleration: not zero", along)]
    if "user_acceleration" in scene.effects:
        pushed = (particles["acceleration"][:, axes] != 0.0) & (particles.fixed == 0)[:, None]
        who = particles.id[pushed.any(axis=1)]
        drawn += [(f"user_acceleration: not zero for {listed(who)}", pushed.any(axis=0))] if len(who) else []
    return [
        f"effects.{what} along periodic {'axis' if along.sum() == 1 else 'axes'} {' and '.join(map(str, axes[along]))}:"
        " there is no potential energy along an axis without an end; potential and total_energy will be nan"
        for what, along in drawn
        if along.any()
    ]


def coincident(scene: Scene, particles: Particles) -> list[str]:
    """A warning of bodies at the same place that attract one another without softening: the law has no value there."""
    gravity = scene.effects.get("mutual_gravity")
    if gravity is None or gravity.softening > 0.0 or (scene.G if gravity.G is None else gravity.G) == 0.0:
        return []
    x = particles.position
    order = np.argsort(x[:, 0], kind="stable")
    equal = x[order[1:], 0] == x[order[:-1], 0]
    shared = np.append(equal, False) | np.append(False, equal)  # with a neighbour in this order
    rows = order[shared[: len(order)]]  # few or none, but for a lattice
    rows = rows[np.lexsort((particles.id[rows], *x[rows].T))]
    parted = (x[rows[1:]] != x[rows[:-1]]).any(axis=1)
    begins = np.flatnonzero(np.append(True, parted)[: len(rows)])  # of those at one place
    if not len(begins):
        return []
    active = np.maximum.reduceat(particles.fixed[rows] == 0, begins) & np.maximum.reduceat(particles.mass[rows] > 0.0, begins)
    met = ~parted & np.repeat(active, np.diff(np.append(begins, len(rows))))[1:]
    if not met.any():
        return []
    first, second = particles.id[rows[:-1][met]], particles.id[rows[1:][met]]
    order = np.argsort(first)
    pairs = pair_names(first[order], second[order])
    return [
        f"effects.mutual_gravity: {listed(pairs, 'pair')} {'are' if len(pairs) > 1 else 'is'} at the same place at the start:"
        " no force acts between the two; move one, or give a softening"
    ]


def check_places(scene: Scene, particles: Particles, room: Container | None) -> list[str]:
    """Centres outside the box, and movable spheres that are not fully inside a wall (fixed ones may stand in it)."""
    x, faults = particles.position, []
    if scene.box is not None:
        lower, upper = np.array(scene.box.lower, float), np.array(scene.box.upper, float)
        out = np.flatnonzero(((x < lower) | (x > upper)).any(axis=1))
        if len(out):
            faults.append(f"box: {listed(particles.id[out])} outside")
    if room is not None:
        movable = particles.fixed == 0
        for w, (point, normal) in enumerate(zip(room.point, room.normal, strict=True)):
            gap = (x - point) @ normal - particles.radius
            size = np.abs(point).max() + np.abs(x).max(axis=1, initial=0.0)
            out = np.flatnonzero(movable & (gap < -1e-9 * particles.radius - 1e-14 * size))
            if len(out):
                where = ", ".join(f"{p:g}" for p in point), ", ".join(f"{n:g}" for n in normal)
                faults.append(
                    f"effects.walls.planes[{w}]: {listed(particles.id[out])} not fully inside the wall at ({where[0]})"
                    f" with normal ({where[1]})"
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


def check_step(scene: Scene, particles: Particles) -> tuple[list[str], list[str]]:
    """A step must be short against spheres (`rewind`), and against a periodic box."""
    faults, warnings, dt = [], [], scene.time.step
    speed = np.sqrt((particles.velocity**2).sum(axis=1))
    radius, moving = particles.radius, speed > 0.0
    points = np.flatnonzero(moving & (radius == 0.0))
    event = scene.effects["collisions"].mode == "event"
    if len(points) and not (event and scene.dimension == 1):
        warnings.append(f"particles: {listed(particles.id[points])} with radius 0: points meet spheres, but never one another")
    fast = np.flatnonzero(moving & (radius > 0.0) & (speed * dt > 2.0 * radius))
    if not event and len(fast):
        safe = rounded_down(float((2.0 * radius[fast] / speed[fast]).min()))
        verb = "crosses more than its" if len(fast) == 1 else "cross more than their"
        faults.append(f"time.step: {listed(particles.id[fast])} {verb} diameter in a step of {dt:g}; use a step <= {safe:g}")
    if event:
        return faults + small_boxes(scene, particles), warnings
    reach = 2.0 * (2.0 * float(radius.max()) + 2.0 * float(speed.max()) * dt)
    if scene.box is not None:
        for k, (lo, hi) in enumerate(zip(scene.box.lower, scene.box.upper, strict=True)):
            if scene.periodic[k] and hi - lo < reach:
                faults.append(
                    f"box: periodic axis {k} is {hi - lo:g} long, but collisions need 2 (2 R + 2 v dt) = {reach:g}"
                    " for the largest and the fastest particle"
                )
    return faults, warnings


def small_boxes(scene: Scene, particles: Particles) -> list[str]:
    """Periodic axes on which a sphere could meet two images of another."""
    if scene.box is None:
        return []
    movable = particles.radius[particles.fixed == 0].max(initial=0.0)
    least = 2.0 * float(particles.radius.max(initial=0.0) + movable) * 1.01
    return [
        f"box: periodic axis {k} is {hi - lo:g} long, but collisions need two contact distances, {least:g}"
        for k, (lo, hi) in enumerate(zip(scene.box.lower, scene.box.upper, strict=True))
        if scene.periodic[k] and not hi - lo > least
    ]


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
