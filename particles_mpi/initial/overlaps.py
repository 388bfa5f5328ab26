"""Spheres that overlap at the start: found, and pushed apart where the scene allows them."""

from __future__ import annotations

import numpy as np

from particles_mpi.errors import listed
from particles_mpi.initial.placement import Container
from particles_mpi.kernels.geometry import image_shift, image_shifts
from particles_mpi.kernels.jit import inner, kernel
from particles_mpi.neighbours.candidates import touching
from particles_mpi.particles import Array, Particles

MOST_SWEEPS = 1000
TOUCH = 1e-12  # relative overlap that still counts as touching


def check_overlaps(particles: Particles, room: Container, allowed: bool, before: int) -> tuple[list[str], list[str]]:
    """Overlapping spheres are a fault, or a warning and pushed apart where the scene allows them."""
    first, second, depth = overlapping(particles, room.length, before)
    if not len(first):
        return [], []
    text = f"{listed_pairs(particles, first, second)} overlap{'s' if len(first) == 1 else ''} at the start"
    text = f"effects.collisions: {text} (deepest by {depth.max():.3g})"
    if not allowed:
        return [f"{text}; move them, or set allow_overlap = true"], []
    x, w, warnings = particles.position, particles.inverse_mass, [f"{text}; pushed apart"]
    for _ in range(MOST_SWEEPS):
        first, second, depth = overlapping(particles, room.length)
        if not len(first):
            return [], warnings
        separate(x, particles.radius, w, first, second, room.lower, room.upper, room.length, room.point, room.normal)
    first, second, depth = overlapping(particles, room.length)
    if len(first):
        left = f"{listed_pairs(particles, first, second)} still overlap after {MOST_SWEEPS} sweeps"
        warnings.append(f"effects.collisions: {left} (deepest by {depth.max():.3g})")
    return [], warnings


def overlapping(particles: Particles, length: Array, before: int = 0) -> tuple[Array, Array, Array]:
    """(first, second, depth): pairs of rows that overlap and are not both fixed, in order, and how deep.

    Without pairs among the first `before` rows.
    """
    x, radius, n = particles.position, particles.radius, len(particles)
    if n < 2 or not radius.any():
        return np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0)
    first, second = touching(x, radius, np.where(particles.fixed == 0, 1.0, 0.0), particles.id, length)
    order = np.lexsort((second, first))
    first, second = first[order].astype(np.int64), second[order].astype(np.int64)
    r = x[first] - x[second]
    r -= image_shifts(r, length)
    sum_of_radii = radius[first] + radius[second]
    depth = sum_of_radii - np.sqrt((r**2).sum(axis=1))
    deep = (depth > TOUCH * sum_of_radii) & (np.maximum(first, second) >= before)
    return first[deep], second[deep], depth[deep]


def listed_pairs(particles: Particles, first: Array, second: Array) -> str:
    """ "pairs 0-1 and 3-4": pairs of rows by their ids."""
    return listed([f"{i}-{j}" for i, j in zip(particles.id[first].tolist(), particles.id[second].tolist())], "pair")


@kernel
def separate(x, radius, w, first, second, lower, upper, length, point, normal):
    """Move the spheres of each pair apart, the lighter one further, in place on x; they stay inside walls and box."""
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
