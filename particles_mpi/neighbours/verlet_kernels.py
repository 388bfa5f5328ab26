"""Neighbour lists for particles that move one at a time: Verlet lists with a skin, updated for each particle by itself.

Each particle has a reference position and stays within `skin` of it. When it has moved that far, it gets a new reference position
and a new list. Two particles that can touch are in each other's list: their reference positions, in unwrapped coordinates, are no
further apart than R_i + R_j + skin_i + skin_j. Cells find them: see `verlet_cells`.
"""

from typing import Any, NamedTuple

import numpy as np

from particles_mpi.kernels.geometry import some_nearest
from particles_mpi.kernels.jit import in_place, lean, lean_inner, prefetch, screening
from particles_mpi.kernels.lanes import LANE_COUNT, columns_of, eight
from particles_mpi.neighbours.verlet_cells import CELL, MARGIN, NEXT_ROW, cell_of, first_in_cells, link, unlink
from particles_mpi.particles import Array

BLOCK_NUMBERS = 32  # of a row in the pool, two lines of the cache: its span and places for a list; longer ones stand behind
SIZE, SKIN, INVERSE_MASS = 0, 1, 2  # columns of `reference`, after the d coordinates
BEGIN, COUNT, ROOM, PLACES = range(4)  # columns of `spans`; the last one is the first place of the list


class Lists(NamedTuple):
    """The lists of n rows, as the kernels take them. What is needed of a neighbour together stands in one row of `reference`."""

    reference: Array  # (n, width): reference position (d), then SIZE = R + skin, SKIN, INVERSE_MASS
    links: Array  # (n, 2 width) int32, the same memory: NEXT_ROW and PREVIOUS_ROW in the same cell (-1: none), and CELL
    level: Array  # (n,) int8, of each row in the grid
    spans: Array  # (n, BLOCK_NUMBERS) int32: where the list of a row begins in the pool, how many it holds and has room for
    pool: Array  # int32: `spans`, with the rows in all lists, and behind it lists that got too long for their blocks
    used: Array  # (1,) places of the pool that are in use
    head: Array  # (cells,) int32, first row in each cell, or -1
    nearby: Array  # (n + 2,) int32, scratch: rows that `find_nearby` found
    grid: tuple[Array, ...]  # a `VerletGrid`, as a plain tuple: see `jit.plain`
    box: tuple[Array, ...]  # a `Box`, as a plain tuple
    boxes_per_length: Array  # (d,) boxes in a unit of length on periodic axes, 0 on others


columns_of_reference: Any = columns_of(lambda d: d + INVERSE_MASS + 1)


@screening
def may_meet(axes, lists, i, others):
    """Bit p tells whether row i and row p of eight `others` (`columns_of_reference`) may touch while both are within their skins.

    Not if both are fixed.
    """
    reference = lists.reference
    _, _, length = lists.box
    d = len(axes)
    r2 = eight(0.0)
    for k in range(d):
        r = some_nearest(reference[i, k] - others[k], length[k], lists.boxes_per_length[k])
        r2 += r * r
    reach = (reference[i, d + SIZE] + others[d + SIZE]) * MARGIN
    near = r2 <= reach * reach
    return near if reference[i, d + INVERSE_MASS] > 0.0 else near & (others[d + INVERSE_MASS] > 0.0)


@in_place
def find_nearby(axes, lists, i):
    """Write the rows that `may_meet` row i to `lists.nearby`; returns how many."""
    reference, links, nearby = lists.reference, lists.links, lists.nearby
    d = len(axes)
    waiting = first_in_cells(axes, lists, reference, i, reference[i, d + SIZE])
    # The next one in the cell of each is put behind: without a branch the memory answers many at once.
    p = 0
    while p < waiting:
        after = links[np.uint64(nearby[np.uint64(p)]), 2 * d + NEXT_ROW]
        p += 1
        prefetch(reference, after)
        nearby[np.uint64(waiting)] = after
        waiting += after >= 0
    found = 0
    for first in range(0, waiting, LANE_COUNT):
        meet = may_meet(axes, lists, np.uint64(i), columns_of_reference(axes, reference, nearby, first, waiting - 1))
        for p in range(min(LANE_COUNT, waiting - first)):
            j = nearby[np.uint64(first + p)]
            nearby[np.uint64(found)] = j
            found += ((meet >> p) & 1) & (j != i)
    return found


@in_place
def compare(lists, i, found):
    """Return (kept, new): how many of the `found` nearby rows are in the list of i, and how many are not.

    The first `kept` places of the list then hold those that stay, the others those that go; the first `new` of `nearby` are new.
    """
    spans, pool, nearby = lists.spans, lists.pool, lists.nearby
    begin = np.int64(spans[i, BEGIN])
    end = begin + spans[i, COUNT]
    kept, new = begin, np.int64(0)
    for p in range(found):
        j = nearby[p]
        at = kept
        while at < end and pool[at] != j:
            at += 1
        if at < end:
            pool[at], pool[kept] = pool[kept], j
            kept += 1
        else:
            nearby[new] = j
            new += 1
            prefetch(spans, j)
    for p in range(kept, end):
        prefetch(spans, pool[p])
    return kept - begin, new


@in_place
def shortage(lists, i, kept, new):
    """How many places the pool may lack to list the `new` nearby rows with i, and i with each of them; then `enlarge` it."""
    spans, nearby = lists.spans, lists.nearby
    need = np.int64(0)
    longer = np.int64(spans[i, ROOM])
    while longer < kept + new:
        longer *= 2
        need += longer
    for p in range(new):
        j = nearby[p]
        if spans[j, COUNT] == spans[j, ROOM]:
            need += 2 * spans[j, ROOM]
    return lists.used[0] + need - len(lists.pool)


@lean_inner
def add_to_list(pool, spans, used, i, j):
    """Put j into the list of i, for which there is room in the pool."""
    if spans[i, COUNT] == spans[i, ROOM]:
        for p in range(spans[i, COUNT]):
            pool[used[0] + p] = pool[spans[i, BEGIN] + p]
        spans[i, BEGIN] = used[0]
        spans[i, ROOM] *= 2
        used[0] += spans[i, ROOM]
    pool[spans[i, BEGIN] + spans[i, COUNT]] = j
    spans[i, COUNT] += 1


@lean_inner
def take_from_list(pool, spans, i, j):
    """Take j out of the list of i."""
    last = spans[i, BEGIN] + spans[i, COUNT] - 1
    for p in range(spans[i, BEGIN], last + 1):
        if pool[p] == j:
            pool[p] = pool[last]
            spans[i, COUNT] -= 1
            return


@in_place
def relist(axes, lists, i, kept, new):
    """Row i keeps the first `kept` rows of its list, gets the `new` nearby ones, and stands in their lists; see `compare`."""
    spans, pool = lists.spans, lists.pool
    begin = np.int64(spans[i, BEGIN])
    for p in range(begin + kept, begin + spans[i, COUNT]):
        take_from_list(pool, spans, np.int64(pool[p]), i)
    spans[i, COUNT] = kept
    for p in range(new):
        j = np.int64(lists.nearby[p])
        add_to_list(pool, spans, lists.used, i, j)
        add_to_list(pool, spans, lists.used, j, i)
    cell = cell_of(axes, lists, i)
    d = len(axes)
    if lists.links[i, 2 * d + CELL] != cell:
        unlink(axes, lists, i)
        link(axes, lists, i, cell)


@lean_inner
def remove(axes, lists, i):
    """Take row i out of its cell and of all lists."""
    relist(axes, lists, i, np.int64(0), np.int64(0))
    unlink(axes, lists, i)


@lean
def list_rows(axes, lists, x, row):
    """Give the rows from `row` on the reference positions x (n, d) and list them with those before them.

    Returns (row, shortage): (n, 0) in the end, or the row for which the pool is too small by so many places; then enlarge it
    and call again from that row.
    """
    lists = Lists(*lists)
    for i in range(row, len(x)):
        for k in range(len(axes)):
            lists.reference[i, k] = x[i, k]
        found = find_nearby(axes, lists, i)
        kept, new = compare(lists, i, found)
        short = shortage(lists, i, kept, new)
        if short > 0:
            return i, short
        relist(axes, lists, i, kept, new)
    return len(x), 0
