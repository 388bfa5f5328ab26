"""Tests whether the paths of two rows come near each other before the horizon, and when. Rows listed as partners wait for it.

`trajectories` explains paths, `pair_search` how partners are listed.
"""

from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from particles_mpi.kernels.geometry import nearest
from particles_mpi.kernels.jit import inner
from particles_mpi.kernels.markers import RADIUS, START
from particles_mpi.neighbours.cells import GRIDDED
from particles_mpi.neighbours.search_index import FLOAT32_LOSS
from particles_mpi.particles import Array

LOST = 1e-10  # of what is subtracted in `time_near`: more than double precision loses
WAITING = 64  # rows are listed, or parts of a list, before the paths of all are tested
MUCH = 1e4  # times `window`: where paths are near one another for longer, it is not computed from when to when


@inner(error_model="numpy", inline="always")
def paths_may_meet(axes, y, path, i, j, window, tolerance, length):
    """Do the paths of i, at y at its start, and of j come nearer than R_i + R_j + 2 tolerance within `window` from then?

    With a margin for round-off. On the gridded axes y is the image that is meant. Returns (whether they do, r.u, u.u, r.r, the
    square of that distance); `time_near` goes on with these.
    """
    d = len(axes)
    passed = path[i, 2 * d + START] - path[j, 2 * d + START]
    r2 = 0.0
    ru = 0.0
    u2 = 0.0
    for k in range(d):
        r = y[k] - (path[j, k] + path[j, d + k] * passed)
        if k >= GRIDDED:
            r = nearest(r, length[k])
        u = path[i, d + k] - path[j, d + k]
        r2 += r * r
        ru += r * u
        u2 += u * u
    t = -ru / (u2 + 1e-300)
    t = t if t > 0.0 else 0.0  # not max and min: those branch
    t = t if t < window else window
    size = path[i, 2 * d + RADIUS] + path[j, 2 * d + RADIUS]
    cut = size + 2.0 * tolerance
    return (size > 0.0) & (r2 + t * (2.0 * ru + t * u2) <= cut * cut + 1e-12 * r2), ru, u2, r2, cut * cut


@inner(error_model="numpy")
def time_near(ru, u2, r2, cut2, start, window):
    """(begin, end) of the time in which two paths are so near that their rows can touch; float32, with margins for what is lost.

    ru, u2, r2, cut2: as `paths_may_meet` returns them, at the time `start`.
    """
    half = sqrt(max(ru * ru - u2 * (r2 - cut2), 0.0) + LOST * u2 * r2)
    begin, end = (-ru - half) / u2, (half - ru) / u2
    if not abs(begin) + abs(end) < MUCH * window:  # they hardly move, or not at all
        return np.float32(-inf), np.float32(inf)
    margin = FLOAT32_LOSS * (abs(begin) + abs(end) + start + window)
    return np.float32(start + begin - margin), np.float32(start + end + margin)


class Waiting(NamedTuple):
    """Rows that wait for the test of their paths, which are prefetched, for each row that looks for partners."""

    around: Array  # (n + WAITING,) int32: the rows
    seeker: Array  # (WAITING,) int32: the row that looks for partners, for one part of `around` after the other
    until: Array  # (WAITING,) int32: where that part ends
    place: Array  # (WAITING, d): position of that row at the start of its path; on gridded axes that of the image in question


@inner(error_model="numpy")
def keep_pairs(axes, waiting, parts, holding, horizon, pairs, found):
    """Test the first `parts` parts of those `waiting`; add pairs to keep behind the first `found`, and return how many there are.

    Pairs for which there is no room are only counted. waiting: a `Waiting`.
    """
    around, seeker, until, place = waiting.around, waiting.seeker, waiting.until, waiting.place
    paths, _, spheres, _, _, length, marked, _, _ = holding
    path, _, bounding_radius, _, _ = paths
    end, tolerance, _ = horizon
    _, w, ids, owned = spheres
    first, second, near_from, near_until = pairs
    y = np.empty(len(axes))
    p = 0
    for part in range(parts):
        i = np.int64(seeker[part])
        window = end - path[i, 2 * len(axes)]
        for k in range(len(axes)):
            y[k] = place[part, k]
        while p < until[part]:
            j = np.int64(around[p])
            p += 1
            meet, ru, u2, r2, cut2 = paths_may_meet(axes, y, path, i, np.uint64(j), window, tolerance, length)
            if meet and wanted(i, j, marked, bounding_radius, owned, ids, w):
                if found < len(first):
                    first[found], second[found] = (i, j) if ids[i] < ids[j] else (j, i)
                    near_from[found], near_until[found] = time_near(ru, u2, r2, cut2, path[i, 2 * len(axes)], window)
                found += 1
    return found


@inner
def wanted(i, j, marked, bounding_radius, owned, ids, w):
    """Is the pair of rows i and j to be kept, if row i looks for partners?

    One must be owned, and one movable. If j looks for partners too (it is `marked`), the pair is kept from the row with the
    larger bounding radius, or, if they are equal, from that with the larger id.
    """
    if i == j or not (i < owned or j < owned) or (w[i] == 0.0 and w[j] == 0.0):
        return False
    return not (
        marked[j] and (bounding_radius[j] > bounding_radius[i] or (bounding_radius[j] == bounding_radius[i] and ids[j] > ids[i]))
    )
