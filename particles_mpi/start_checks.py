"""What can only be judged with the particles at hand: walls, overlaps, the length of a step. And pushing overlaps apart."""

from __future__ import annotations

from collections.abc import Iterable
from math import floor, log10

import numpy as np

from particles_mpi.lean import inner, kernel
from particles_mpi.neighbours.candidates import touching
from particles_mpi.particles import Array, Particles
from particles_mpi.placement import Room
from particles_mpi.scene import Scene

SHOWN = 5  # particles or pairs named in a fault
MOST_SWEEPS = 1000
MOST_CROSSINGS = 1e4  # of the box in a step
TOUCH = 1e-12  # relative overlap that still counts as touching


def listed(names: Iterable[object], what: str = "particle") -> str:
    """ "particle 3", "particles 3 and 7", "particles 0, 1, 2, 3, 4 and 12 more"."""
    texts = [str(n) for n in names]
    more = len(texts) - SHOWN
    parts = [*texts[:SHOWN], f"{more} more"] if more > 0 else texts
    return f"{what}{'s' if len(texts) > 1 else ''} " + (
        parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
    )


def pair_names(first: Array, second: Array) -> list[str]:
    return [f"{i}-{j}" for i, j in zip(first.tolist(), second.tolist())]


def check_start(scene: Scene, particles: Particles, room: Room | None) -> tuple[list[str], list[str]]:
    """(faults, warnings) of particles whose row is their id; overlaps that the scene allows are pushed apart in place."""
    faults = check_places(scene, particles, room) + check_crossings(scene, particles)
    warnings: list[str] = []
    if "collisions" in scene.effects and not faults and len(particles):
        faults, warnings = check_step(scene, particles)
        if not faults:
            more_faults, more_warnings = check_overlaps(scene, particles, room)
            faults, warnings = faults + more_faults, warnings + more_warnings
    return faults, warnings


def check_places(scene: Scene, particles: Particles, room: Room | None) -> list[str]:
    """Centres outside the box, and movable spheres that are not fully inside a wall (fixed ones may stand in it)."""
    x, faults = particles.position, []
    if scene.box is not None:
        lower, upper = np.array(scene.box.lower, float), np.array(scene.box.upper, float)
        out = np.flatnonzero(((x < lower) | (x > upper)).any(axis=1))
        if len(out):
            faults.append(f"box: {listed(out)} outside")
    if room is not None:
        movable = particles.fixed == 0
        for w, (point, normal) in enumerate(zip(room.point, room.normal, strict=True)):
            gap = (x - point) @ normal - particles.radius
            size = np.abs(point).max() + np.abs(x).max(axis=1, initial=0.0)
            out = np.flatnonzero(movable & (gap < -1e-9 * particles.radius - 1e-14 * size))
            if len(out):
                where = ", ".join(f"{p:g}" for p in point), ", ".join(f"{n:g}" for n in normal)
                faults.append(
                    f"effects.walls.planes[{w}]: {listed(out)} not fully inside the wall at ({where[0]}) with normal ({where[1]})"
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
    return [f"time.step: {listed(fast)} would cross the box more than {MOST_CROSSINGS:g} times in a step of {dt:g}"]


def check_step(scene: Scene, particles: Particles) -> tuple[list[str], list[str]]:
    """A step must be short against spheres (`rewind`), and against a periodic box."""
    faults, warnings, dt = [], [], scene.time.step
    speed = np.sqrt((particles.velocity**2).sum(axis=1))
    radius, moving = particles.radius, speed > 0.0
    points = np.flatnonzero(moving & (radius == 0.0))
    event = scene.effects["collisions"].mode == "event"
    if len(points) and not (event and scene.dimension == 1):
        warnings.append(f"particles: {listed(points)} with radius 0: points meet spheres, but never one another")
    fast = np.flatnonzero(moving & (radius > 0.0) & (speed * dt > 2.0 * radius))
    if not event and len(fast):
        safe = rounded_down(float((2.0 * radius[fast] / speed[fast]).min()))
        verb = "crosses more than its" if len(fast) == 1 else "cross more than their"
        faults.append(f"time.step: {listed(fast)} {verb} diameter in a step of {dt:g}; use a step <= {safe:g}")
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


def rounded_down(value: float) -> float:
    """To three digits, never up."""
    if not value > 1e-290:
        return value
    unit = 10.0 ** (floor(log10(value)) - 2)
    return floor(value / unit) * unit


def overlapping(particles: Particles, length: Array) -> tuple[Array, Array, Array]:
    """(first, second, depth): pairs of rows that overlap and are not both fixed, in order, and how deep."""
    x, radius, n = particles.position, particles.radius, len(particles)
    if n < 2 or not radius.any():
        return np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0)
    weight = np.where(particles.fixed == 0, 1.0, 0.0)
    first, second = touching(x, radius, weight, particles.id, length)
    order = np.lexsort((second, first))
    first, second = first[order].astype(np.int64), second[order].astype(np.int64)
    r = x[first] - x[second]
    r -= length * np.rint(np.divide(r, length, out=np.zeros_like(r), where=length > 0.0))
    sum_of_radii = radius[first] + radius[second]
    depth = sum_of_radii - np.sqrt((r**2).sum(axis=1))
    deep = depth > TOUCH * sum_of_radii
    return first[deep], second[deep], depth[deep]


def check_overlaps(scene: Scene, particles: Particles, room: Room | None) -> tuple[list[str], list[str]]:
    """Overlapping spheres are a fault, or a warning and pushed apart where the scene allows them."""
    length = periodic_length(scene)
    first, second, depth = overlapping(particles, length)
    if not len(first):
        return [], []
    pairs = listed(pair_names(first, second), "pair")
    text = f"{pairs} overlap{'s' if len(first) == 1 else ''} at the start (deepest by {depth.max():.3g})"
    if not scene.effects["collisions"].allow_overlap:
        return [f"effects.collisions: {text}; move them, or set allow_overlap = true"], []
    first, second, depth = push_apart(scene, particles, room)
    warnings = [f"effects.collisions: {text}; pushed apart"]
    if len(first):
        pairs = listed(pair_names(first, second), "pair")
        warnings.append(f"effects.collisions: {pairs} still overlap after {MOST_SWEEPS} sweeps (deepest by {depth.max():.3g})")
    return [], warnings


def periodic_length(scene: Scene) -> Array:
    """(d,): length of periodic axes, 0 of the others."""
    if scene.box is None:
        return np.zeros(scene.dimension)
    return np.where(scene.periodic, np.array(scene.box.upper, float) - np.array(scene.box.lower, float), 0.0)


def push_apart(scene: Scene, particles: Particles, room: Room | None) -> tuple[Array, Array, Array]:
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
            if length[k] > 0.0:
                r[k] -= length[k] * np.rint(r[k] / length[k])
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
