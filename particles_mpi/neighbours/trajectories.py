"""Where particles will be for some steps: straight paths, which they follow give or take a tolerance.

Every row has a *path*: a straight line x0 + v0 (t - t0) that it is expected to follow until the `Horizon`. A pair can touch only
if, at some moment until then, its paths come nearer than R_i + R_j + 2 tolerance: those are the candidates, which hold as
long as rows stay within the tolerance of their paths. A row that does not (a contact turned it, a force bent its way) gets a new
path, and partners are sought for that row alone. Times count from the last search for all candidates.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from particles_mpi.kernels.geometry import nearest
from particles_mpi.kernels.jit import kernel
from particles_mpi.particles import Array


class Horizon(NamedTuple):
    """What candidates are good for."""

    valid_until: float  # the time until which they hold
    tolerance: float  # how far a row may be from its path
    bound: float  # how far a row may get from the midpoint of its first path, tolerance included
    slack: float  # how far rows may get out of their rank's box: see `halo_region`


AT_REST = Horizon(0.0, 0.0, 0.0, 0.0)


class Spheres(NamedTuple):
    """What does not change from step to step, of all rows: first the `owned` ones of this rank, then ghosts."""

    radius: Array
    inverse_mass: Array  # 1/m, or 0 if fixed
    id: Array
    owned: int


class Paths(NamedTuple):
    """The paths of all rows, and what encloses them until the horizon."""

    path: Array  # (n, 2d + 2): a row is (x0, v0, t0, R), so that all of it lies together in memory
    midpoint: Array  # (n, d) where the row will be halfway to the horizon
    bounding_radius: Array  # (n,) R, tolerance and path lie within that distance of the midpoint
    level: Array  # (n,) int8, how rows are held by their bounding radius: see `search_index`
    first_midpoint: Array  # (n, d) as it was at the search


@kernel
def fastest(x, v):
    """Largest speed of the rows of v; not a number if a coordinate or velocity is not finite."""
    most = 0.0
    wrong = 0.0  # or nan
    for i in range(len(v)):
        v2 = 0.0
        for k in range(x.shape[1]):
            v2 += v[i, k] * v[i, k]
            wrong += x[i, k] * 0.0
        wrong += v2 * 0.0
        most = most if most >= v2 else v2
    return most**0.5 + wrong


def start_paths(x: Array, v: Array, radius: Array, horizon: Horizon) -> tuple[Array, Array, Array]:
    """(path, midpoint, bounding radius) of rows that all start now, at time 0: see `Paths`."""
    path, midpoint, bounding_radius = np.empty((len(x), 2 * x.shape[1] + 2)), np.empty_like(x), np.empty(len(x))
    fill_paths((0,) * x.shape[1], x, v, radius, horizon.tolerance, 0.5 * horizon.valid_until, path, midpoint, bounding_radius)
    return path, midpoint, bounding_radius


@kernel
def fill_paths(axes, x, v, radius, tolerance, half, path, midpoint, bounding_radius):
    """The columns of `start_paths`; `half` of the time until the horizon."""
    d = len(axes)
    for i in range(len(x)):
        v2 = 0.0
        for k in range(d):
            path[i, k], path[i, d + k] = x[i, k], v[i, k]
            midpoint[i, k] = x[i, k] + half * v[i, k]
            v2 += v[i, k] * v[i, k]
        path[i, 2 * d], path[i, 2 * d + 1] = 0.0, radius[i]
        bounding_radius[i] = radius[i] + tolerance + half * sqrt(v2)


@kernel
def rows_leaving(axes, x, v, path, time, h, tolerance, length):
    """Rows that a drift over h from `time` takes away from their paths."""
    d, rows = len(axes), np.empty(len(x), np.int32)
    found = 0
    for i in range(len(x)):
        passed = time + h - path[i, 2 * d]
        r2 = 0.0
        for k in range(d):
            r = nearest(x[i, k] + v[i, k] * h - (path[i, k] + path[i, d + k] * passed), length[k])
            r2 += r * r
        if not r2 <= tolerance * tolerance:
            rows[found] = i
            found += 1
    return rows[:found]


@kernel
def rows_turned(x, v, start, path, rows, time, horizon, length):
    """Those of `rows` whose segment, begun at time + start_i, leaves the path before the horizon; reorders `rows`.

    Segment and path are straight: where they end decides.
    """
    d = x.shape[1]
    until, tolerance, _, _ = horizon
    found = 0
    for i in rows:
        outside = False
        for t in (time + start[i], until):
            r2 = 0.0
            for k in range(d):
                at = x[i, k] + v[i, k] * (t - time - start[i])
                r = nearest(at - (path[i, k] + path[i, d + k] * (t - path[i, 2 * d])), length[k])
                r2 += r * r
            outside |= not r2 <= tolerance * tolerance
        if outside:
            rows[found] = i
            found += 1
    return rows[:found]


@kernel
def find_near_walls(rows, path, horizon, owned, point, normal, marked, near, count):
    """Owned ones of `rows` that may touch a wall before the horizon; behind the first `count` of `near` that are not marked.

    Returns the number then.
    """
    d = normal.shape[1]
    until, tolerance, _, _ = horizon
    kept = 0
    for p in range(count):
        near[kept] = near[p]
        kept += not marked[near[p]]
    for i in rows:
        if i >= owned:
            continue
        window = until - path[i, 2 * d]
        size = path[i, 2 * d + 1] + tolerance * 1.000001
        travel = 0.0
        for k in range(d):
            travel += path[i, d + k] ** 2
        travel = sqrt(travel) * window
        touches = False
        for m in range(len(point)):
            begin = 0.0
            for k in range(d):
                begin += (path[i, k] - point[m, k]) * normal[m, k]
            if not begin - travel > size:  # most are too far to ask which way they go
                speed = 0.0
                for k in range(d):
                    speed += path[i, d + k] * normal[m, k]
                touches |= not min(begin, begin + speed * window) > size
        if touches:
            near[kept] = i
            kept += 1
    return kept
