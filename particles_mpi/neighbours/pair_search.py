"""Which pairs can meet: rows whose paths may come near are listed as partners by cells, and `near_paths` tests their paths."""

from math import inf, sqrt

import numpy as np

from particles_mpi.kernels.geometry import nearest
from particles_mpi.kernels.jit import in_place, inner, lean_inner, prefetch, spheres_within, trailing_zeros
from particles_mpi.kernels.markers import RADIUS, START
from particles_mpi.neighbours.cells import cell_along
from particles_mpi.neighbours.near_paths import WAITING, Waiting, keep_pairs
from particles_mpi.neighbours.search_index import FAST, FLOAT32_LOSS, OVERSIZE, PLACES_AT_ONCE, SLOW

ENTRIES_A_LINE = 4  # of `SortedCells.entry` in a line of the cache


@inner
def drop_pairs(rows, marked, pairs, count):
    """Forget those of `rows` among the first `count` of `pairs`; marks the rows, returns how many pairs stay."""
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
def list_sorted(axes, low, high, sphere, cells, sorted_, firsts, around, listed, path):
    """Rows in the sorted cells in the ranges low..high that may be partners of a sphere, behind the first `listed` of `around`.

    Returns (how many are listed then, tests).

    sphere: middle (g,), radius and largest radius of a partner, float32 in the units of `SortedCells.entry`, and its own row.
    firsts: scratch, (8,).
    Runs are short: PLACES_AT_ONCE places are tested whatever their length, and the bits of as many runs are read together, so
    that the processor need not guess where each ends.
    """
    middle, own, limit, i = sphere
    order, start, _, entry, _, _ = sorted_
    tests = 0
    bits = np.int64(0)
    slot = np.int64(0)
    for c0 in range(low[0], high[0] + 1):
        for c1 in range(low[1], high[1] + 1):
            c = (c0 * cells[1] + c1) * cells[2]
            first = np.int64(start[np.uint64(c + low[2])])
            end = np.int64(start[np.uint64(c + high[2] + 1)])
            tests += int(end - first)
            while True:
                left = end - first
                taken = (np.int64(1) << (left if left < PLACES_AT_ONCE else np.int64(PLACES_AT_ONCE))) - np.int64(1)
                bits |= (spheres_within(axes, middle, own, limit, entry, first) & taken) << (PLACES_AT_ONCE * slot)
                firsts[slot] = first
                slot += 1
                first += PLACES_AT_ONCE
                if slot == len(firsts):
                    listed = list_bits(bits, firsts, order, i, around, listed, path)
                    bits = np.int64(0)
                    slot = np.int64(0)
                if first >= end:
                    break
    return list_bits(bits, firsts, order, i, around, listed, path), tests


@inner
def list_bits(bits, firsts, order, i, around, listed, path):
    """The rows whose bits are set, PLACES_AT_ONCE from each of the places `firsts` on; behind the first `listed` of `around`.

    Their paths are asked for, to be in the cache when they are tested.
    """
    while bits != 0:
        bit = trailing_zeros(bits)
        bits &= bits - 1
        j = order[np.uint64(firsts[bit // PLACES_AT_ONCE] + bit % PLACES_AT_ONCE)]
        prefetch(path, j)
        around[listed] = j
        listed += j != i
    return listed


@lean_inner
def fetch_cells(sorted_, linked, ranges):
    """Ask for what is in the sorted and the linked cells in these ranges, all at once: where each cell is, then what is there.

    For a row that asks alone: its surroundings are in no cache, and the tests would wait for one cell after the other.
    """
    order, start, _, entry, _, (_, _, cells) = sorted_
    head, _, _, _, (_, _, linked_cells) = linked
    low, high, linked_low, linked_high = ranges
    for c0 in range(low[0], high[0] + 1):
        for c1 in range(low[1], high[1] + 1):
            prefetch(start, (c0 * cells[1] + c1) * cells[2] + low[2])
    for c0 in range(linked_low[0], linked_high[0] + 1):
        for c1 in range(linked_low[1], linked_high[1] + 1):
            prefetch(head, (c0 * linked_cells[1] + c1) * linked_cells[2] + linked_low[2])
    for c0 in range(low[0], high[0] + 1):
        for c1 in range(low[1], high[1] + 1):
            first = start[np.uint64((c0 * cells[1] + c1) * cells[2] + low[2])]
            prefetch(order, first)
            prefetch(entry, first)
            prefetch(entry, first + ENTRIES_A_LINE)


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


@in_place
def list_near(axes, at, reaches, i, ranges, index, paths, firsts, around, listed):
    """The rows in cells near the path of row i, or of an image of it, behind the first `listed` of `around`.

    Returns (how many are listed then, tests). `at`: the middle (d,) of the path and its extent (g,), and scratch; `reaches`: see
    `find_partners`; `ranges`: scratch, (3,) each, for the sorted and the linked cells.
    """
    middle, extent, middle32 = at
    own, limit, to_slow, to_fast, also_fast = reaches
    low, high, linked_low, linked_high = ranges
    path, midpoint, bounding_radius, _, _ = paths
    sorted_, linked, _, _, largest, _, _, _, _, _ = index
    _, _, _, _, scale, (origin, per, cells) = sorted_
    d, g = len(axes), len(extent)
    cover(d, middle, extent, to_slow, origin, per, cells, low, high)
    at_most = 1.0 + (own + largest[SLOW]) * scale
    for k in range(g):
        r = (middle[k] - origin[k + 3 - g]) * scale
        middle32[k] = r
        at_most += abs(r)
    slip = FLOAT32_LOSS * at_most
    sphere = middle32, np.float32(own * scale + slip), np.float32(limit * scale + slip), i
    if also_fast:
        head, after, _, _, (linked_origin, linked_per, linked_cells) = linked
        cover(d, middle, extent, to_fast, linked_origin, linked_per, linked_cells, linked_low, linked_high)
        fetch_cells(sorted_, linked, ranges)
    near, tests = list_sorted(axes, low, high, sphere, cells, sorted_, firsts, around, listed, path)
    if also_fast:
        fast = list_linked(linked_low, linked_high, linked_cells, head, after, around, near)
        tests += fast - near
        for p in range(near, fast):
            j = np.uint64(around[p])
            r2 = 0.0
            for k in range(g):
                r2 += (middle[k] - midpoint[j, k]) ** 2
            prefetch(path, j)
            around[near] = j
            near += (r2 <= (own + bounding_radius[j]) ** 2) & (i != j)
    return near, tests


@in_place
def bring_near(d, path, i, other, length, place, part):
    """To place[part]: where row i is, in the image that is nearest to the row `other`."""
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
    asking, until, place = np.empty(WAITING, np.int32), np.empty(WAITING, np.int32), np.empty((WAITING, d))
    waiting = Waiting(around, asking, until, place)
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
                asking[parts], until[parts] = i, listed
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
                        asking[parts], until[parts] = i, listed
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
