"""Where particles will be in the next steps: straight paths, which they follow within a tolerance.

Every row has a *path*: a straight line x0 + v0 (t - t0) that it is expected to follow until the candidates are no longer valid
(`Horizon`). A pair can touch only if, at some time until then, its paths come nearer than R_i + R_j + 2 tolerance: such pairs are
the candidates, and `pair_search` finds them. They hold for as long as rows stay within the tolerance of their paths. A row that
does not (a contact turned it, a force bent its path) gets a new path, and partners are sought for that row alone.

A path is found in cells by its midpoint and by a radius around that: see `Paths`. A test here may find that two rows can meet
which do not: that costs time, and never changes a result. Times count from the last search for all candidates.
"""

from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from particles_mpi.kernels.geometry import nearest
from particles_mpi.kernels.jit import inner, kernel, prefetch
from particles_mpi.kernels.markers import RADIUS, START
from particles_mpi.neighbours.rank_boxes import index_of, time_in_box, time_to_box
from particles_mpi.particles import Array


class Horizon(NamedTuple):
    """How long, and within which distances, candidates are valid.

    valid_until: the time until which they hold. tolerance: how far a row may be from its path. bound: how far it may get from the
    midpoint of its first path, tolerance included.
    """

    valid_until: float
    tolerance: float
    bound: float


AT_REST = Horizon(0.0, 0.0, 0.0)
ROWS_AHEAD = 16  # rows: a loop over rows that are scattered in memory fetches the row so many places later into the cache


class Spheres(NamedTuple):
    """What does not change from step to step, for all rows: radius, inverse_mass = 1/m or 0 if fixed, id (n,).

    The first `owned` rows are those of this rank, and ghosts follow.
    """

    radius: Array
    inverse_mass: Array
    id: Array
    owned: int


class Paths(NamedTuple):
    """The paths of all rows, and what encloses them until the horizon.

    path (n, 2d + 2 or more): a row is (x0, v0, t0, R), so that all of it lies together in memory, in whole lines of the cache.
    midpoint (n, d): where the row will be halfway to the horizon. bounding_radius (n,): R, tolerance and path lie within that
    distance of the midpoint. level (n,) int8: how rows are held by their bounding radius (`search_index`). first_midpoint (n, d):
    as it was at the search; without rows where no axis is periodic, because there is no bound then.
    """

    path: Array
    midpoint: Array
    bounding_radius: Array
    level: Array
    first_midpoint: Array


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


@kernel
def start_paths(axes, x, v, radius, horizon, owned, path):
    """Paths of rows that all start now, at time 0, into `path`.

    Returns (midpoint, bounding radius, the mean of it, bounds (2, d) of the midpoints, those of the first `owned` rows).
    """
    d = len(axes)
    until, tolerance = horizon.valid_until, horizon.tolerance
    midpoint, bounding_radius = np.empty((len(x), d)), np.empty(len(x))
    box = np.empty((2, d))
    box[0], box[1] = inf, -inf
    own_box = box.copy()
    total = 0.0
    for i in range(len(x)):
        v2 = 0.0
        if i == owned:
            own_box = box.copy()
        for k in range(d):
            path[i, k] = x[i, k]
            path[i, d + k] = v[i, k]
            midpoint[i, k] = x[i, k] + 0.5 * until * v[i, k]
            box[0, k] = box[0, k] if box[0, k] <= midpoint[i, k] else midpoint[i, k]
            box[1, k] = box[1, k] if box[1, k] >= midpoint[i, k] else midpoint[i, k]
            v2 += v[i, k] * v[i, k]
        path[i, 2 * d + START] = 0.0
        path[i, 2 * d + RADIUS] = radius[i]
        bounding_radius[i] = radius[i] + tolerance + sqrt(v2) * 0.5 * until
        total += bounding_radius[i]
    if owned == len(x):
        own_box = box.copy()
    return midpoint, bounding_radius, total / max(len(x), 1), box, own_box


@kernel
def rows_leaving(axes, x, v, path, time, h, tolerance, length, rows):
    """Write to `rows` those that a drift over h from `time` takes away from their paths; returns how many."""
    d = len(axes)
    found = 0
    for i in range(len(x)):
        passed = time + h - path[i, 2 * d + START]
        r2 = 0.0
        for k in range(d):
            r = nearest(x[i, k] + v[i, k] * h - (path[i, k] + path[i, d + k] * passed), length[k])
            r2 += r * r
        if not r2 <= tolerance * tolerance:
            rows[found] = i
            found += 1
    return found


@inner
def rows_turned(x, v, start, path, rows, time, horizon, length):
    """Move those of `rows` to the front whose present segment, begun at time + start_i, leaves the path before the horizon.

    Returns how many. Segment and path are straight, so it is enough to compare where they end.
    """
    d = x.shape[1]
    until, tolerance, _ = horizon
    found = 0
    for p in range(len(rows)):
        i = rows[p]
        if p + ROWS_AHEAD < len(rows):
            ahead = rows[p + ROWS_AHEAD]
            prefetch(x, ahead)
            prefetch(v, ahead)
            prefetch(start, ahead)
            prefetch(path, ahead)
        outside = False
        for t in (time + start[i], until):
            r2 = 0.0
            for k in range(d):
                at = x[i, k] + v[i, k] * (t - time - start[i])
                r = nearest(at - (path[i, k] + path[i, d + k] * (t - path[i, 2 * d + START])), length[k])
                r2 += r * r
            outside |= not r2 <= tolerance * tolerance
        if outside:
            rows[found] = i
            found += 1
    return found


@inner(error_model="numpy")
def renew_paths(rows, segments, owned, paths, region, horizon, length, time, h):
    """New paths for `rows` along their present segments, in the drift over h from `time`; in place on `paths`.

    Returns (needed, until). needed: 0, or, if a row would break bound or region within this drift, how far such a row gets from
    its midpoint (in a periodic box, its first one), tolerance included, the largest of all; inf if that is not a number. until:
    the time until which candidates are valid now. Rows that could get further than the bound, or out of their `HaloRegion`,
    before the horizon bring it nearer.
    """
    x, v, starts, _ = segments
    path, midpoint, bounding_radius, _, first_midpoint = paths
    end, tolerance, bound = horizon
    own, others, sent, known = region
    d = x.shape[1]
    needed = 0.0
    for p in range(len(rows)):
        i = rows[p]
        if p + ROWS_AHEAD < len(rows):
            prefetch(path, rows[p + ROWS_AHEAD])
            prefetch(midpoint, rows[p + ROWS_AHEAD])
            prefetch(bounding_radius, rows[p + ROWS_AHEAD])
        start = time + starts[i]
        now = 0.0
        soon = 0.0
        late = 0.0
        speed = 0.0
        for k in range(d):
            origin = first_midpoint[i, k] if len(first_midpoint) else midpoint[i, k]
            r = nearest(x[i, k] - origin, length[k])
            path[i, k] = origin + r
            path[i, d + k] = v[i, k]
            now += r * r
            soon += (r + v[i, k] * (time + h - start)) ** 2
            late += (r + v[i, k] * (end - start)) ** 2
            speed += v[i, k] * v[i, k]
        path[i, 2 * d + START] = start
        now, soon, late = sqrt(now) + tolerance, sqrt(soon) + tolerance, sqrt(late) + tolerance
        speed = sqrt(speed)
        until = max(time + h, start + (bound - now) / speed) if late > bound else inf
        if i < owned:
            margin = path[i, 2 * d + RADIUS] + tolerance
            until = min(until, start + time_in_box(path, i, margin, own[0], own[1]))
            for o in range(len(others)):
                if index_of(i, known[sent[o] : sent[o + 1]]) < 0:
                    until = min(until, start + time_to_box(path, i, margin, others[o, 0], others[o, 1], length))
        if not (now <= bound and soon <= bound and until >= time + h):  # not a number is not <= anything
            needed = max(needed, now, soon) if soon == soon else inf
            continue
        end = min(end, until)
        for k in range(d):
            midpoint[i, k] = path[i, k] + 0.5 * v[i, k] * (end - start)
        bounding_radius[i] = path[i, 2 * d + RADIUS] + tolerance + 0.5 * speed * (end - start)
    return needed, end


@inner
def find_near_walls(rows, path, horizon, owned, planes, marked, near, count):
    """Write those of `rows` that are owned, may touch a wall before the horizon and are not marked behind the first `count` of
    `near`.

    planes: `Planes` as a plain tuple. Returns how many there are then.
    """
    point, normal, _, _, lower, upper, oblique = planes
    d = normal.shape[1]
    until, tolerance, _ = horizon
    kept = 0
    for p in range(count):
        near[kept] = near[p]
        kept += not marked[near[p]]
    for i in rows:
        if i >= owned:
            continue
        window = until - path[i, 2 * d + START]
        size = path[i, 2 * d + RADIUS] + tolerance * 1.000001
        inside = not oblique
        for k in range(d):
            way = path[i, d + k] * window
            above, below = path[i, k] - lower[k], upper[k] - path[i, k]
            inside &= (above > size) & (above + way > size) & (below > size) & (below - way > size)
        if inside:  # as most are
            continue
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
