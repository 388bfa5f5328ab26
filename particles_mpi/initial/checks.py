"""What can only be judged with the particles at hand: walls, overlaps, the length of a step. And pushing overlaps apart."""

from __future__ import annotations

from collections.abc import Sequence
from math import floor, log10

import numpy as np

from particles_mpi.initial.placement import Container
from particles_mpi.kernels.geometry import image_shift, image_shifts
from particles_mpi.kernels.jit import inner, kernel
from particles_mpi.neighbours.candidates import touching
from particles_mpi.particles import Array, Particles
from particles_mpi.scene.schema import LARGEST, Scene

SHOWN = 5  # particles or pairs named in a fault
MOST_SWEEPS = 1000
MOST_CROSSINGS = 1e4  # of the box in a step
TOUCH = 1e-12  # relative overlap that still counts as touching


def listed(names: Sequence[object] | Array, what: str = "particle") -> str:
    """ "particle 3", "particles 3 and 7", "particles 0, 1, 2, 3, 4 and 12 more"."""
    parts, more = [str(n) for n in names[:SHOWN]], len(names) - SHOWN
    parts += [f"{more} more"] if more > 0 else []
    return f"{what}{'s' if len(names) > 1 else ''} " + (
        parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
    )


def pair_names(first: Array, second: Array) -> list[str]:
    return [f"{i}-{j}" for i, j in zip(first.tolist(), second.tolist())]


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
    for name in ("radius", "drag"):
        if name in values:
            allowed[name] = (values[name] >= 0.0) & (values[name] <= LARGEST)
    if {"mass", "fixed"} & values.keys():
        mass, fixed = (values.get(name, particles[name]) for name in ("mass", "fixed"))
        needed = np.zeros(len(mass), bool)  # something divides by it
        if "friction" in scene.effects:
            needed[:] = True
        elif "collisions" in scene.effects:
            needed |= fixed == 0
        possible = (mass >= 1.0 / LARGEST) | ((mass == 0.0) & ~needed)
        allowed["mass" if "mass" in values else "fixed"] = possible & (mass <= LARGEST)
    return allowed


def rounded_down(value: float) -> float:
    """To three digits, never up."""
    if not value > 1e-290:
        return value
    unit = 10.0 ** (floor(log10(value)) - 2)
    return floor(value / unit) * unit


def overlapping(particles: Particles, length: Array, before: int = 0) -> tuple[Array, Array, Array]:
    """(first, second, depth): pairs of rows that overlap and are not both fixed, in order, and how deep.

    Without pairs among the first `before` rows.
    """
    x, radius, n = particles.position, particles.radius, len(particles)
    if n < 2 or not radius.any():
        return np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0)
    weight = np.where(particles.fixed == 0, 1.0, 0.0)
    first, second = touching(x, radius, weight, particles.id, length)
    order = np.lexsort((second, first))
    first, second = first[order].astype(np.int64), second[order].astype(np.int64)
    r = x[first] - x[second]
    r -= image_shifts(r, length)
    sum_of_radii = radius[first] + radius[second]
    depth = sum_of_radii - np.sqrt((r**2).sum(axis=1))
    deep = (depth > TOUCH * sum_of_radii) & (np.maximum(first, second) >= before)
    return first[deep], second[deep], depth[deep]


def check_overlaps(scene: Scene, particles: Particles, room: Container | None, before: int = 0) -> tuple[list[str], list[str]]:
    """Overlapping spheres are a fault, or a warning and pushed apart where the scene allows them."""
    length = periodic_length(scene)
    first, second, depth = overlapping(particles, length, before)
    if not len(first):
        return [], []
    pairs = listed(pair_names(particles.id[first], particles.id[second]), "pair")
    text = f"{pairs} overlap{'s' if len(first) == 1 else ''} at the start (deepest by {depth.max():.3g})"
    if not scene.effects["collisions"].allow_overlap:
        return [f"effects.collisions: {text}; move them, or set allow_overlap = true"], []
    first, second, depth = push_apart(scene, particles, room)
    warnings = [f"effects.collisions: {text}; pushed apart"]
    if len(first):
        pairs = listed(pair_names(particles.id[first], particles.id[second]), "pair")
        warnings.append(f"effects.collisions: {pairs} still overlap after {MOST_SWEEPS} sweeps (deepest by {depth.max():.3g})")
    return [], warnings


def periodic_length(scene: Scene) -> Array:
    """(d,): length of periodic axes, 0 of the others."""
    if scene.box is None:
        return np.zeros(scene.dimension)
    return np.where(scene.periodic, np.array(scene.box.upper, float) - np.array(scene.box.lower, float), 0.0)


def push_apart(scene: Scene, particles: Particles, room: Container | None) -> tuple[Array, Array, Array]:
    """Move overlapping spheres apart, pair by pair in id order, the lighter one further; returns the overlaps that are left.

    Positions only: no velocity changes, so no kinetic energy comes in.
    """
    length, d = periodic_length(scene), scene.dimension
    lower, upper = np.full(d, -np.inf), np.full(d, np.inf)
    if scene.box is not None:
        lower, upper = np.array(scene.box.lower, float), np.array(scene.box.upper, float)
    point, normal = (room.point, room.normal) if room is not None else (np.empty((0, d)), np.empty((0, d)))
    x, w = particles.position, particles.inverse_mass
    for _ in range(MOST_SWEEPS):
        first, second, depth = overlapping(particles, length)
        if not len(first):
            break
        separate(x, particles.radius, w, first, second, lower, upper, length, point, normal)
    else:
        first, second, depth = overlapping(particles, length)
    return first, second, depth


@kernel
def separate(x, radius, w, first, second, lower, upper, length, point, normal):
    """One sweep over the pairs, in place on x; spheres stay inside walls and box."""
    d = x.shape[1]
    r = np.zeros(d)
    for i, j in zip(first, second):
        if w[i] + w[j] == 0.0:
            continue
        r2 = 0.0
        for k in range(d):
            r[k] = x[i, k] - x[j, k]
            r[k] -= image_shift(r[k], length[k])
            r2 += r[k] * r[k]
        distance = r2**0.5
        diameter = (radius[i] + radius[j]) * (1.0 + 1e-9)
        push = diameter - distance
        if push <= 0.0:
            continue
        if distance < 1e-9 * diameter:  # coincident centres have no direction: take one from the ids
            r2 = 0.0
            for k in range(d):
                r[k] = (i * 7919 + j * 104729 + (k + 1) * 1299709) % 1021 - 510.5
                r2 += r[k] * r[k]
            distance = r2**0.5
        for k in range(d):
            step = push * r[k] / (distance * (w[i] + w[j]))
            x[i, k] += step * w[i]
            x[j, k] -= step * w[j]
        for row in (i, j):
            if w[row] > 0.0:
                hold_inside(x, row, radius[row], lower, upper, length, point, normal)


@inner
def hold_inside(x, i, radius, lower, upper, length, point, normal):
    """Bring row i back inside each wall, and into the box."""
    for w in range(len(point)):
        gap = -radius
        for k in range(x.shape[1]):
            gap += (x[i, k] - point[w, k]) * normal[w, k]
        if gap < 0.0:
            for k in range(x.shape[1]):
                x[i, k] -= gap * normal[w, k]
    for k in range(x.shape[1]):
        if length[k] > 0.0:
            if x[i, k] < lower[k]:
                x[i, k] += length[k]
            elif x[i, k] >= upper[k]:
                x[i, k] -= length[k]
        x[i, k] = min(max(x[i, k], lower[k]), upper[k])
