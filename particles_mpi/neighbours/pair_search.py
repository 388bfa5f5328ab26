"""The search for pairs that can meet: cells list partners whose paths may come near, and `near_paths` tests these paths.

Python calls `replace_candidates`, for all rows, or for the few that left their paths.
"""

from math import inf, sqrt

import numpy as np

from particles_mpi.kernels.geometry import nearest
from particles_mpi.kernels.jit import in_place, inner, kernel
from particles_mpi.kernels.markers import RADIUS, START
from particles_mpi.neighbours.near_paths import WAITING, Waiting, keep_pairs
from particles_mpi.neighbours.partner_lists import list_near
from particles_mpi.neighbours.search_index import FAST, OVERSIZE, SLOW, move_rows
from particles_mpi.neighbours.trajectories import find_near_walls, renew_paths, rows_turned

ALL, LEAVING, TURNED = 0, 1, 2  # why candidates are replaced


@inner
def drop_pairs(rows, marked, pairs, count):
    """Remove the pairs of `rows` from the first `count` of `pairs`. Marks these rows; returns how many pairs stay."""
    first, second, begin, end = pairs
    for i in rows:
        marked[i] = True
    kept = 0
    for p in range(count):
        i = first[p]
        j = second[p]
        first[kept] = i
        second[kept] = j
        begin[kept] = begin[p]
        end[kept] = end[p]
        kept += not (marked[np.uint64(i)] | marked[np.uint64(j)])
    return kept


@inner
def shifts(low, high, lowest, highest, length, by):
    """Write to `by` the shifts of periodic images of [low, high], on one axis, that meet [lowest, highest]; returns how many."""
    count = 0
    for image in range(3 if length > 0.0 else 1):
        shift = 0.0 if image == 0 else (length if image == 1 else -length)
        if high + shift >= lowest and low + shift <= highest:
            by[count] = shift
            count += 1
    return count


@in_place
def bring_near(d, path, i, other, length, place, part):
    """Write to place[part] the position of row i in the image that is nearest to the row `other`."""
    for k in range(d):
        place[part, k] = path[i, k]
    for k in range(min(d, 3)):
        r = path[i, k] - (path[other, k] + path[other, d + k] * (path[i, 2 * d + START] - path[other, 2 * d + START]))
        place[part, k] = path[i, k] + nearest(r, length[k]) - r


@inner(error_model="numpy")
def find_partners(axes, rows, begin, everything, horizon, holding, pairs, found):
    """Candidate pairs of `rows` (all of them marked), from rows[begin] on, with all rows, each once, behind the first `found`.

    Returns (number of pairs then; number of tests; how many of `rows` are done: if there is no room for the pairs of the next
    ones, enlarge and call again from there). Kept are pairs with an owned partner and a movable one, the lower id first. Of two
    marked rows the one with the larger bounding radius finds the other: with `everything` marked no search need look further
    than the row's own radius, and SLOW rows need not look for FAST ones. `holding`: `Holding` as a plain tuple.
    Whether a test passes cannot be predicted: eight spheres are tested at once, in float32, with a margin for its rounding. The
    paths of those that pass are tested a few rows later. Where a part of the list ends is written out twice: as a function it
    would count references to all the arrays, and the whole search take twice as long.
    """
    paths, index, spheres, _, _, length, _, around, _ = holding
    path, _, bounding_radius, level, _ = paths
    end, tolerance, _ = horizon
    _, _, oversize, number, largest, _, lowest, highest, own_low, own_high = index
    owned = spheres[3]
    d = len(axes)
    g = min(d, 3)
    slow, fast = np.zeros((2, 3), np.int64), np.zeros((2, 3), np.int64)
    ranges = slow[0], slow[1], fast[0], fast[1]
    by, images = np.zeros((3, 3)), np.ones(3, np.int64)
    middle, extent = np.empty(d), np.empty(g)
    middle32, firsts = np.empty(g, np.float32), np.empty(8, np.int64)
    seeker, until, place = np.empty(WAITING, np.int32), np.empty(WAITING, np.int32), np.empty((WAITING, d))
    waiting = Waiting(around, seeker, until, place)
    listed = parts = tests = 0
    done, pairs_done, tests_done = begin, found, 0
    for m in range(begin, len(rows)):
        if parts == 0:
            done, pairs_done, tests_done = m, found, tests
        i = np.int64(rows[m])
        window = end - path[i, 2 * d + START]
        base = path[i, 2 * d + RADIUS] + tolerance
        limit = bounding_radius[i] if everything else inf
        to_slow = base + min(limit, largest[SLOW])
        to_fast = base + min(limit, largest[FAST])
        also_fast = not everything or level[i] != SLOW
        own = 0.0
        outside = i >= owned
        for k in range(d):
            own += path[i, d + k] ** 2
        own = base + 0.5 * sqrt(own) * window
        far = max(to_slow, to_fast) if also_fast else to_slow
        for k in range(g):
            mid = path[i, k] + 0.5 * path[i, d + k] * window
            extent[k] = abs(0.5 * path[i, d + k] * window)
            images[k] = shifts(mid - extent[k] - far, mid + extent[k] + far, lowest[k], highest[k], length[k], by[k])
        if also_fast and (not everything or level[i] == OVERSIZE):
            tests += number[0]
            for a in range(number[0]):
                other = np.int64(oversize[a])
                bring_near(d, path, i, other, length, place, parts)
                around[listed] = other
                listed += 1
                seeker[parts], until[parts] = i, listed
                parts += 1
                if parts == WAITING or listed >= WAITING:
                    found = keep_pairs(axes, waiting, parts, holding, horizon, pairs, found)
                    listed = parts = 0
        for p0 in range(images[0]):
            for p1 in range(images[1]):
                for p2 in range(images[2]):
                    apart = 0.0
                    for k in range(d):
                        place[parts, k] = path[i, k]
                    for k in range(g):
                        place[parts, k] += by[k, p0 if k == 0 else (p1 if k == 1 else p2)]
                        middle[k] = place[parts, k] + 0.5 * path[i, d + k] * window
                        apart = max(apart, own_low[k] - middle[k] - extent[k], middle[k] - extent[k] - own_high[k])
                    if outside and apart > far:  # a ghost, nowhere near an owned row
                        continue
                    at, reaches = (middle, extent, middle32), (own, limit, to_slow, to_fast, also_fast)
                    near, tested = list_near(axes, at, reaches, i, ranges, index, paths, firsts, around, listed)
                    tests += tested
                    if near > listed:
                        listed = near
                        seeker[parts], until[parts] = i, listed
                        parts += 1
                        if parts == WAITING or listed >= WAITING:
                            found = keep_pairs(axes, waiting, parts, holding, horizon, pairs, found)
                            listed = parts = 0
        if found > len(pairs[0]):
            return pairs_done, tests_done, done
    found = keep_pairs(axes, waiting, parts, holding, horizon, pairs, found)
    if found > len(pairs[0]):
        return pairs_done, tests_done, done
    return found, tests, len(rows)


@kernel(error_model="numpy")
def replace_candidates(axes, rows, begin, why, segments, drift, horizon, holding, pairs, found, walls):
    """Replace the candidates of `rows`: drop theirs among the first `found` of `pairs` and `walls` rows near walls, find others.

    why: ALL rows have got paths; the segments of these rows, in the drift over h from `time` (drift = (time, h)), were TURNED
    by contacts, or are LEAVING their paths by forces. Of rows that were turned those that leave their paths come first in
    `rows` then. holding, pairs: `Holding` and `Pairs` as plain tuples. begin: -1, or how many rows were done when there was no
    more room for pairs.

    Returns, in this order,
    needed: 0, or how far a row gets if that is further than candidates may reach: nothing was replaced then;
    until: the time until which candidates are valid;
    found, walls: how many pairs and rows near walls there are now;
    tests: how many rows were looked at as partners;
    count: how many of `rows` left their paths;
    done: how many of these have found their partners, before there was no more room.
    """
    paths, cells, spheres, planes, region, length, marked, _, wall_rows = holding
    until, (time, h), owned = horizon[0], drift, spheres[3]
    count = np.int64(len(rows))
    if why == TURNED and begin < 0:
        count = rows_turned(segments[0], segments[1], segments[2], paths[0], rows, time, horizon, length)
    seekers = rows[:count]
    if begin < 0:
        begin = 0
        if why != ALL and count > 0:
            needed, until = renew_paths(seekers, segments, owned, paths, region, horizon, length, time, h)
            if needed != 0.0:
                return needed, until, found, walls, 0, count, 0
            move_rows(seekers, paths, owned, cells)
        found = drop_pairs(seekers, marked, pairs, found)
    valid = (until, horizon[1], horizon[2])
    found, tests, done = find_partners(axes, seekers, begin, why == ALL, valid, holding, pairs, found)
    if done == count:
        if len(planes[0]) > 0:
            walls = find_near_walls(seekers, paths[0], valid, owned, planes, marked, wall_rows, walls)
        for i in seekers:
            marked[i] = False
    return 0.0, until, found, walls, tests, count, done
