"""Lists the rows in cells near a path, as partners that `pair_search` tests. `search_index` describes these cells."""

import numpy as np

from particles_mpi.kernels.jit import in_place, inner, lean_inner, prefetch, spheres_within, trailing_zeros
from particles_mpi.neighbours.cells import cell_along
from particles_mpi.neighbours.search_index import FLOAT32_LOSS, PLACES_AT_ONCE, SLOW

ENTRIES_A_LINE = 4  # of `SortedCells.entry` in a line of the cache


@inner
def cover(d, middle, extent, margin, origin, per, cells, low, high):
    """The cells that the box middle +- (extent + margin) meets: ranges low..high (3,)."""
    for m in range(max(0, 3 - d), 3):
        k = m - max(0, 3 - d)
        low[m] = cell_along(middle[k] - extent[k] - margin, origin[m], per[m], cells[m])
        high[m] = cell_along(middle[k] + extent[k] + margin, origin[m], per[m], cells[m])


@inner
def list_sorted(axes, low, high, sphere, cells, sorted_, firsts, around, listed, path):
    """List the rows in the sorted cells in the ranges low..high that may be partners of a sphere, behind the first `listed` of
    `around`.

    Returns (how many are listed then, tests).

    sphere: middle (g,), radius and largest radius of a partner, float32 in the units of `SortedCells.entry`, and its own row.
    firsts: scratch, (8,). Runs are short. PLACES_AT_ONCE places are tested whatever the length of a run, and the bits of as many
    runs are read together, so that the processor need not guess where each ends.
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
    """List the rows whose bits are set, PLACES_AT_ONCE from each of the places `firsts` on, behind the first `listed`.

    Their paths are prefetched, to be in the cache when they are tested.
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
    """Prefetch what is in the sorted and the linked cells in these ranges: first where each cell is, then its rows.

    For a row that looks for partners alone: its surroundings are in no cache, and tests would wait for one cell after the other.
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
    """List the rows in the linked lists of the cells in the ranges low..high, behind the first `listed` of `around`."""
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
    """List the rows in cells near the path of row i, or of an image of it, behind the first `listed` of `around`.

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
