"""Spheres that overlap at the start: found, and pushed apart where the scene allows them."""

from __future__ import annotations

import numpy as np

from particles_mpi.initial.names import listed, pair_names
from particles_mpi.initial.placement import Container
from particles_mpi.kernels.geometry import image_shift, image_shifts
from particles_mpi.kernels.jit import inner, kernel
from particles_mpi.neighbours.candidates import touching
from particles_mpi.particles import Array, Particles
from particles_mpi.scene.schema import Scene, periodic_length

MOST_SWEEPS = 1000


TOUCH = 1e-12  # relative overlap that still counts as touching


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
