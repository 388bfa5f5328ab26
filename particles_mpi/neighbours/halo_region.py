"""How far ranks must look into one another's space, and where their particles may go until the next search.

Each rank has a box around all that its own rows may cover. It gets as ghosts all rows whose paths come within 2 `slack` of that
box. Until the horizon its rows stay within `slack` of it, whatever turns them, and rows that it does not hold stay out of
there: so no row can meet one that its rank does not know. A row that would break this brings the horizon nearer. A box is
(2, d), its lower and upper corner.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from particles_mpi.kernels.geometry import nearest
from particles_mpi.kernels.jit import inner, kernel
from particles_mpi.neighbours.trajectories import Horizon
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import send_rows
from particles_mpi.particles import Array


class HaloRegion(NamedTuple):
    """Where rows may go without meeting anyone that their rank does not know."""

    own: Array  # (2, d) the rank's box with its slack, which owned rows stay in
    others: Array  # (m, 2, d) those of the ranks whose boxes it overlaps
    known: Array  # (m, owned) does that rank hold our row as a ghost? No other row enters its box


def everywhere(dimension: int) -> HaloRegion:
    """The region of a single rank."""
    own = np.array([[-np.inf] * dimension, [np.inf] * dimension])
    return HaloRegion(own, np.empty((0, 2, dimension)), np.empty((0, 0), bool))


def swept(x: Array, v: Array, radius: Array, horizon: Horizon) -> Array:
    """The box (n, 2, d) around all that each row, starting now, may cover, sphere and all."""
    then, margin = x + v * horizon.valid_until, (radius + horizon.tolerance)[:, None]
    return np.stack((np.minimum(x, then) - margin, np.maximum(x, then) + margin), axis=1)


def enclosing(boxes: Array) -> Array:
    """The box around all boxes (n, 2, d); (inf, -inf), which overlaps nothing, if there are none."""
    return np.stack((boxes[:, 0].min(axis=0, initial=inf), boxes[:, 1].max(axis=0, initial=-inf)))


def overlapping(one: Array, boxes: Array, length: Array) -> Array:
    """Which of the boxes (m, 2, d) overlap the box `one` (2, d), or an image of it; (m,)."""
    overlap = np.zeros(boxes.shape[::2], bool)
    for shift in (0.0, length, -length) if length.any() else (0.0,):
        overlap |= (one[0] + shift <= boxes[:, 1]) & (one[1] + shift >= boxes[:, 0])
    return np.asarray(overlap.all(axis=1))


def fetch_near_rows(
    ranks: Communicator, arrays: dict[str, Array], state: tuple[Array, Array, Array], horizon: Horizon, length: Array
) -> tuple[HaloRegion, Array, Array, dict[str, Array], Array]:
    """(region, our rows that others need, how many each, theirs that we need, how many of each rank). Collective.

    `arrays`: what is sent of a row; `state` = (x, v, radius) of the owned rows, which start now.
    """
    mine = swept(*state, horizon)
    region, rows, counts = build(ranks.allgather_array(enclosing(mine)), ranks.rank, mine, horizon.slack, length)
    return region, rows, counts, *send_rows(ranks, arrays, rows, counts)


def build(boxes: Array, rank: int, mine: Array, slack: float, length: Array) -> tuple[HaloRegion, Array, Array]:
    """(region, rows to send sorted by rank, how many to each rank) from what all ranks' rows may cover.

    boxes (ranks, 2, d): `enclosing` of those of each rank; mine (owned, 2, d): those of this one's rows.
    """
    wider = slack * np.array([[-1.0], [1.0]])
    wide = boxes + wider
    others = overlapping(wide[rank], wide, length)
    others[rank] = False
    known = np.zeros((np.count_nonzero(others), len(mine)), bool)
    for p, box in enumerate(wide[others] + wider):
        known[p] = overlapping(box, mine, length)
    counts = np.zeros(len(boxes), np.int32)
    counts[others] = known.sum(axis=1)
    return HaloRegion(wide[rank], wide[others], known), np.nonzero(known)[1], counts


@inner
def time_in_box(path, i, margin, low, high):
    """How long the path of row i stays `margin` inside the box [low, high]; below 0 if it does not start there."""
    d = len(low)
    stay = inf
    for k in range(d):
        at = path[i, k]
        speed = path[i, d + k]
        gap = min(high[k] - margin - at, at - margin - low[k])
        if gap < 0.0:
            return -1.0
        if speed > 0.0:
            stay = min(stay, (high[k] - margin - at) / speed)
        elif speed < 0.0:
            stay = min(stay, (low[k] + margin - at) / speed)
    return stay


@inner
def time_to_box(path, i, margin, low, high, length):
    """When the path of row i comes within `margin` of the box [low, high] or an image of it, at the earliest; inf if never."""
    d = len(low)
    begin = 0.0
    finish = inf
    for k in range(d):
        speed = path[i, d + k]
        first = inf
        last = -inf
        for image in range(3 if length[k] > 0.0 else 1):
            at = path[i, k] + (0.0 if image == 0 else (length[k] if image == 1 else -length[k]))
            left = low[k] - margin - at
            right = high[k] + margin - at
            if speed == 0.0:
                if left <= 0.0 <= right:
                    first = 0.0
                    last = inf
                continue
            out = max(left / speed, right / speed)
            if out >= 0.0:  # it is not behind
                first = min(first, left / speed, right / speed)
                last = max(last, out)
        begin = max(begin, first)
        finish = min(finish, last)
    return begin if begin <= finish else inf


@kernel(error_model="numpy")
def renew_paths(rows, segments, owned, paths, region, horizon, length, time, h):
    """New paths for `rows` along their present segments, in the drift over h from `time`; in place on `paths`.

    Returns (0, or how far from its first midpoint a row gets in this drift if it may not get there; until when candidates are
    valid now). Rows that could get further than the bound, or out of their region, before the horizon bring it nearer.
    """
    x, v, starts, _ = segments
    path, midpoint, bounding_radius, _, first_midpoint = paths
    end, tolerance, bound, _ = horizon
    own, others, known = region
    d = x.shape[1]
    needed = 0.0
    for i in rows:
        start = time + starts[i]
        now = 0.0
        soon = 0.0
        late = 0.0
        speed = 0.0
        for k in range(d):
            r = nearest(x[i, k] - first_midpoint[i, k], length[k])
            path[i, k] = first_midpoint[i, k] + r
            path[i, d + k] = v[i, k]
            now += r * r
            soon += (r + v[i, k] * (time + h - start)) ** 2
            late += (r + v[i, k] * (end - start)) ** 2
            speed += v[i, k] * v[i, k]
        path[i, 2 * d] = start
        now, soon, late = sqrt(now) + tolerance, sqrt(soon) + tolerance, sqrt(late) + tolerance
        speed = sqrt(speed)
        until = max(time + h, start + (bound - now) / speed) if late > bound else inf
        if i < owned:
            margin = path[i, 2 * d + 1] + tolerance
            until = min(until, start + time_in_box(path, i, margin, own[0], own[1]))
            for p in range(len(others)):
                if not known[p, i]:
                    until = min(until, start + time_to_box(path, i, margin, others[p, 0], others[p, 1], length))
        if not (max(now, soon) <= bound and until >= time + h):
            needed = max(needed, now, soon) if soon == soon else inf
            continue
        end = min(end, until)
        for k in range(d):
            midpoint[i, k] = path[i, k] + 0.5 * v[i, k] * (end - start)
        bounding_radius[i] = path[i, 2 * d + 1] + tolerance + 0.5 * speed * (end - start)
    return needed, end
