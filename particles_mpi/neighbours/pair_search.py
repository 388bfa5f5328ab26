"""Which pairs can meet: those whose paths come near each other before the horizon. See `trajectories` and `search_index`."""

from math import inf, sqrt

import numpy as np

from particles_mpi.kernels.geometry import nearest
from particles_mpi.kernels.jit import inner
from particles_mpi.neighbours.cells import GRIDDED, cell_along
from particles_mpi.neighbours.search_index import FAST, OVERSIZE, SLOW

AT_ONCE = 8


@inner
def drop_pairs(rows, marked, first, second, count):
    """Forget the pairs of `rows` among the first `count`; marks the rows, returns how many pairs stay."""
    for i in rows:
        marked[i] = True
    kept = 0
    for p in range(count):
        i = first[p]
        j = second[p]
        first[kept] = i
        second[kept] = j
        kept += not (marked[np.uint64(i)] | marked[np.uint64(j)])
    return kept


@inner
def shifts(low, high, lowest, highest, length, by):
    """Periodic images of [low, high] on one axis that meet [lowest, highest]: their shifts into `by`, returns how many."""
    count = 0
    for image in range(3 if length > 0.0 else 1):
        shift = 0.0 if image == 0 else (length if image == 1 else -length)
        if high + shift >= lowest and low + shift <= highest:
            by[count] = shift
            count += 1
    return count


@inner
def cover(d, middle, extent, margin, origin, per, cells, low, high):
    """The cells that the box middle +- (extent + margin) meets: ranges low..high (3,)."""
    for m in range(max(0, 3 - d), 3):
        k = m - max(0, 3 - d)
        low[m] = cell_along(middle[k] - extent[k] - margin, origin[m], per[m], cells[m])
        high[m] = cell_along(middle[k] + extent[k] + margin, origin[m], per[m], cells[m])


@inner
def list_sorted(low, high, cells, start, around):
    """Places in the sorted cells in the ranges low..high; into `around`, returns how many.

    Runs are short: AT_ONCE places are written whatever their length, without a loop whose end the processor must guess.
    """
    listed = 0
    for c0 in range(low[0], high[0] + 1):
        for c1 in range(low[1], high[1] + 1):
            c = (c0 * cells[1] + c1) * cells[2]
            begin = start[np.uint64(c + low[2])]
            end = start[np.uint64(c + high[2] + 1)]
            for p in range(AT_ONCE):
                around[np.uint64(listed + p)] = begin + p
            for p in range(AT_ONCE, end - begin):
                around[np.uint64(listed + p)] = begin + p
            listed += end - begin
    return listed


@inner
def list_linked(low, high, cells, head, after, around, listed):
    """Rows in the linked lists of the cells in the ranges low..high; behind the first `listed` of `around`."""
    for c0 in range(low[0], high[0] + 1):
        for c1 in range(low[1], high[1] + 1):
            for c2 in range(low[2], high[2] + 1):
                j = head[(c0 * cells[1] + c1) * cells[2] + c2]
                while j >= 0:
                    around[listed] = j
                    listed += 1
                    j = after[j]
    return listed


@inner(error_model="numpy", inline="always")
def may_meet(axes, y, path, i, j, window, tolerance, length):
    """Do the paths of i, at y at its start, and of j come nearer than R_i + R_j + 2 tolerance within `window` from then?

    With a margin for round-off. On the gridded axes y is the image that is meant.
    """
    d = len(axes)
    passed = path[i, 2 * d] - path[j, 2 * d]
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
    size = path[i, 2 * d + 1] + path[j, 2 * d + 1]
    cut = size + 2.0 * tolerance
    return (size > 0.0) & (r2 + t * (2.0 * ru + t * u2) <= cut * cut + 1e-12 * r2)


@inner(error_model="numpy")
def find_partners(axes, rows, begin, everything, horizon, holding, first, second, found):
    """Candidate pairs of `rows` (all of them marked), from rows[begin] on, with all rows, each once, behind the first `found`.

    Returns (number of pairs then; number of tests; how many of `rows` are done: if there is no room for the pairs of the next
    one, enlarge and call again from there). Kept are pairs with an owned partner and a movable one, the lower id first. Of two
    marked rows the one with the larger bounding radius finds the other: with `everything` marked no search need look further
    than the row's own radius, and SLOW rows need not look for FAST ones. `holding`: `Holding` as a plain tuple.
    Nearly every test is a coin toss: nothing branches on it; each place is written, and the next over it if it does not count.
    """
    paths, index, spheres, _, _, length, marked, around, _ = holding
    path, midpoint, bounding_radius, level, _ = paths
    end, tolerance, _, _ = horizon
    sorted_, linked, oversize, number, largest, _, lowest, highest, own_low, own_high = index
    order, start, place, entry, (origin, per, cells) = sorted_
    head, after, _, _, (linked_origin, linked_per, linked_cells) = linked
    _, w, ids, owned = spheres
    d = len(axes)
    g = min(d, 3)
    low, high = np.zeros(3, np.int64), np.zeros(3, np.int64)
    by, images = np.zeros((3, 3)), np.ones(3, np.int64)
    y, middle, extent = np.empty(d), np.empty(d), np.empty(g)
    tests = 0
    for m in range(begin, len(rows)):
        i = np.int64(rows[m])
        pairs_before, tests_before = found, tests
        window = end - path[i, 2 * d]
        base = path[i, 2 * d + 1] + tolerance
        limit = bounding_radius[i] if everything else inf
        to_slow = base + min(limit, largest[SLOW])
        to_fast = base + min(limit, largest[FAST])
        also_fast = not everything or level[i] != SLOW
        own = 0.0
        outside = i >= owned
        for k in range(d):
            own += path[i, d + k] ** 2
            y[k] = path[i, k]
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
                for k in range(g):
                    r = path[i, k] - (path[other, k] + path[other, d + k] * (path[i, 2 * d] - path[other, 2 * d]))
                    y[k] = path[i, k] + nearest(r, length[k]) - r
                if wanted(i, other, marked, bounding_radius, owned, ids, w) and may_meet(
                    axes, y, path, i, other, window, tolerance, length
                ):
                    if found < len(first):
                        first[found], second[found] = (i, other) if ids[i] < ids[other] else (other, i)
                    found += 1
        for p0 in range(images[0]):
            for p1 in range(images[1]):
                for p2 in range(images[2]):
                    apart = 0.0
                    for k in range(g):
                        y[k] = path[i, k] + by[k, p0 if k == 0 else (p1 if k == 1 else p2)]
                        middle[k] = y[k] + 0.5 * path[i, d + k] * window
                        apart = max(apart, own_low[k] - middle[k] - extent[k], middle[k] - extent[k] - own_high[k])
                    if outside and apart > far:  # a ghost, nowhere near an owned row
                        continue
                    cover(d, middle, extent, to_slow, origin, per, cells, low, high)
                    listed = list_sorted(low, high, cells, start, around)
                    tests += listed
                    near = np.int64(0)
                    self = np.uint64(place[i]) if level[i] == SLOW else np.uint64(len(path))
                    for p in range(listed):
                        e = np.uint64(around[np.uint64(p)])
                        r2 = 0.0
                        for k in range(g):
                            r2 += (middle[k] - entry[e, k]) ** 2
                        others = entry[e, g]
                        around[np.uint64(near)] = order[e]
                        near += (r2 <= (own + others) ** 2) & (others <= limit) & (e != self)
                    if also_fast:
                        cover(d, middle, extent, to_fast, linked_origin, linked_per, linked_cells, low, high)
                        listed = list_linked(low, high, linked_cells, head, after, around, near)
                        tests += listed - near
                        for p in range(near, listed):
                            j = np.uint64(around[p])
                            r2 = 0.0
                            for k in range(g):
                                r2 += (middle[k] - midpoint[j, k]) ** 2
                            around[near] = j
                            near += (r2 <= (own + bounding_radius[j]) ** 2) & (i != j)
                    for p in range(near):
                        other = np.int64(around[p])
                        if may_meet(axes, y, path, i, np.uint64(other), window, tolerance, length) and wanted(
                            i, other, marked, bounding_radius, owned, ids, w
                        ):
                            if found < len(first):
                                first[found], second[found] = (i, other) if ids[i] < ids[other] else (other, i)
                            found += 1
        if found > len(first):
            return pairs_before, tests_before, m
    return found, tests, len(rows)


@inner
def wanted(i, j, marked, bounding_radius, owned, ids, w):
    """Is this a pair to keep, found from i?"""
    if i == j or not (i < owned or j < owned) or (w[i] == 0.0 and w[j] == 0.0):
        return False
    return not (
        marked[j] and (bounding_radius[j] > bounding_radius[i] or (bounding_radius[j] == bounding_radius[i] and ids[j] > ids[i]))
    )
