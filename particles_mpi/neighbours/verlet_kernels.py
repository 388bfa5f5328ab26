"""Neighbour lists for particles that move one at a time: Verlet lists with a skin, updated for each particle by itself.

Each particle has a reference position and stays within `skin` of it; when it gets that far, it is given a new reference
position and a new list. Two particles that can touch are in each other's list: their reference positions, which are unwrapped
coordinates, are no further apart than R_i + R_j + skin_i + skin_j. They are found in cells, which come in levels: those of a
level are about as wide as the sizes R + skin in it, so that a few large spheres do not make the search of all small ones coarse.
"""

from math import floor
from typing import Any, NamedTuple

import numpy as np

from particles_mpi.kernels import limits
from particles_mpi.kernels.geometry import Box, some_nearest
from particles_mpi.kernels.jit import in_place, inner, lean, lean_inner, prefetch, screening
from particles_mpi.kernels.lanes import WIDTH as WIDE
from particles_mpi.kernels.lanes import columns_of, eight
from particles_mpi.particles import Array

GRIDDED = 3  # axes with cells
LEVELS, FACTOR = 5, 3.0  # each level of cells is for sizes up to FACTOR times those of the one before
WIDTH = 1.4  # of a cell, in sizes of the largest row in it
BLOCK = 32  # numbers of a row in the pool, two lines of the cache: its span and places for a list; longer ones stand behind
SIZE, SKIN, INVERSE_MASS = 0, 1, 2  # columns of `reference`, after the d coordinates
NEXT_ROW, PREVIOUS_ROW, CELL = 6, 7, 8  # columns of `links`, after 2 d: behind those float64 numbers
BEGIN, COUNT, ROOM, PLACES = range(4)  # columns of `spans`; the last one is the first place of the list
NOWHERE = -1  # in place of a cell
MARGIN = 1.0 + 1e-9  # on distances between reference positions, far above round-off


class Grid(NamedTuple):
    """Cells of all levels; their numbers follow one another, level after level."""

    low: Array  # (3,) corner of the cells
    per_length: Array  # (levels, 3) cells in a unit of length
    cells: Array  # (levels, 3) cells along each axis
    first: Array  # (levels + 1,) number of the first cell
    largest: Array  # (levels,) size R + skin of the largest row in the level, -1 if the level is not used


class Lists(NamedTuple):
    """The lists of n rows, as the kernels take them. What is needed of a neighbour together stands in one row of `reference`."""

    reference: Array  # (n, width): reference position (d), then SIZE = R + skin, SKIN, INVERSE_MASS
    links: Array  # (n, 2 width) int32, the same memory: NEXT_ROW and PREVIOUS_ROW in the same cell (-1: none), and CELL
    level: Array  # (n,) int8, of each row in the grid
    spans: Array  # (n, BLOCK) int32: where the list of a row begins in the pool, how many it holds, how many it has room for
    pool: Array  # int32: `spans`, with the rows in all lists, and behind it lists that got too long for their blocks
    used: Array  # (1,) places of the pool that are in use
    head: Array  # (cells,) int32, first row in each cell, or -1
    nearby: Array  # (n + 2,) int32, scratch: rows that `find_nearby` found
    grid: tuple[Array, ...]  # a `Grid`, as a plain tuple: see `jit.plain`
    box: tuple[Array, ...]  # a `Box`, as a plain tuple
    boxes_per_length: Array  # (d,) boxes in a unit of length on periodic axes, 0 on others


def make_grid(x: Array, size: Array, box: Box, share: float) -> tuple[Grid, Array]:
    """A grid for `share` times as many rows as these, of positions x (n, d) and sizes (n,), and the level of each row in it.

    Positions outside belong to the outermost cells, or to their image if the axis is periodic.
    """
    g = min(x.shape[1], GRIDDED)
    low, high, periodic = box.lower[:g], box.upper[:g], box.length[:g] > 0.0
    if len(x):
        low = np.where(periodic, low, np.maximum(low, x[:, :g].min(axis=0)))
        high = np.where(periodic, high, np.minimum(high, x[:, :g].max(axis=0)))
    moving = size[size > 0.0]
    typical = float(np.median(moving)) * 1.5 if len(moving) else 1.0
    steps = np.ceil(np.log(np.maximum(size / typical, 1e-300)) / np.log(FACTOR))
    level = np.clip(steps, 0, LEVELS - 1).astype(np.int8)
    per_length, cells = np.zeros((LEVELS, GRIDDED)), np.ones((LEVELS, GRIDDED), np.int64)
    largest, first = np.full(LEVELS, -1.0), np.zeros(LEVELS + 1, np.int64)
    for step in range(LEVELS):
        sizes = size[level == step]
        if len(sizes):
            largest[step] = sizes.max()
            extent = np.maximum(high - low, 1e-300)
            side = max(WIDTH * float(largest[step]), float(extent.max()) * 1e-5, 1e-300)
            while np.prod(np.floor(extent / side) + 1.0) > min(max(2 * len(sizes) * share, 64), limits.MOST // LEVELS):
                side *= 1.25
            count = np.maximum(np.floor(extent / side), 1.0)
            cells[step, :g] = count.astype(np.int64)
            per_length[step, :g] = count / extent
        first[step + 1] = first[step] + cells[step].prod()
    corner = np.zeros(GRIDDED)
    corner[:g] = low
    return Grid(corner, per_length, cells, first, largest), level


@inner
def level_of(size, lists):
    """The level for one row more, of this size; the widest one may have to hold wider rows than it was made for."""
    _, _, _, _, largest = lists.grid
    widest = 0
    for step in range(len(largest)):
        if largest[step] >= size:
            return step
        if largest[step] >= 0.0:
            widest = step
    largest[widest] = size
    return widest


@lean_inner
def cells_along(y, reach, low, per_length, cells, periodic):
    """(first cell, number of cells) of the interval y +- reach on one axis; on a periodic one they may pass the end."""
    begin = floor((y - reach - low) * per_length)
    end = floor((y + reach - low) * per_length)
    if periodic:
        if end - begin + 1.0 >= cells:
            return 0, np.int64(cells)
        return np.int64(begin - floor(begin / cells) * cells), np.int64(end - begin) + 1
    begin = min(max(begin, 0.0), cells - 1.0)
    return np.int64(begin), np.int64(min(max(end, 0.0), cells - 1.0) - begin) + 1


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
def first_in_cells(axes, lists, place, i, size):
    """Write the first row of each cell in which rows no further than `size` + R + skin from place[i] can be to `lists.nearby`;
    returns how many."""
    reference, head, nearby = lists.reference, lists.head, lists.nearby
    _, _, length = lists.box
    low, per_length, cells, first, largest = lists.grid
    d = len(axes)
    waiting = 0
    f0 = f1 = f2 = 0
    m0 = m1 = m2 = 1
    for step in range(len(largest)):
        if largest[step] < 0.0:
            continue
        reach = (size + largest[step]) * MARGIN
        f0, m0 = cells_along(place[i, 0], reach, low[0], per_length[step, 0], cells[step, 0], length[0] > 0.0)
        if d > 1:
            f1, m1 = cells_along(place[i, 1], reach, low[1], per_length[step, 1], cells[step, 1], length[1] > 0.0)
        if d > 2:
            f2, m2 = cells_along(place[i, 2], reach, low[2], per_length[step, 2], cells[step, 2], length[2] > 0.0)
        n0, n1, n2 = cells[step, 0], cells[step, 1], cells[step, 2]
        for a in range(m0):
            c0 = f0 + a if f0 + a < n0 else f0 + a - n0
            for b in range(m1):
                c1 = f1 + b if f1 + b < n1 else f1 + b - n1
                begin = first[step] + (c0 * n1 + c1) * n2
                for c in range(f2, f2 + m2):
                    j = head[np.uint64(begin + (c if c < n2 else c - n2))]
                    prefetch(reference, j)  # for -1 it asks in vain
                    nearby[np.uint64(waiting)] = j
                    waiting += j >= 0
    return waiting


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
    for first in range(0, waiting, WIDE):
        meet = may_meet(axes, lists, np.uint64(i), columns_of_reference(axes, reference, nearby, first, waiting - 1))
        for p in range(min(WIDE, waiting - first)):
            j = nearby[np.uint64(first + p)]
            nearby[np.uint64(found)] = j
            found += ((meet >> p) & 1) & (j != i)
    return found


@in_place
def compare(lists, i, found):
    """(kept, new): which of the `found` nearby rows are in the list of i, and which are not.

    The first `kept` places of the list hold those that stay, the others those that go; the first `new` of `nearby` are to come.
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


@in_place
def cell_of(axes, lists, i):
    """The cell of row i."""
    reference = lists.reference
    low, per_length, cells, first, _ = lists.grid
    _, _, length = lists.box
    step = lists.level[i]
    c = np.int64(0)
    for m in range(min(len(axes), GRIDDED)):
        at = floor((reference[i, m] - low[m]) * per_length[step, m])
        if length[m] > 0.0:
            at -= floor(at / cells[step, m]) * cells[step, m]
        c = c * cells[step, m] + np.int64(min(max(at, 0.0), cells[step, m] - 1.0))
    return first[step] + c


@lean_inner
def link(axes, lists, i, cell):
    """Put row i into a cell."""
    links, head = lists.links, lists.head
    d = len(axes)
    j = np.int64(head[cell])
    links[i, 2 * d + NEXT_ROW], links[i, 2 * d + PREVIOUS_ROW], links[i, 2 * d + CELL] = j, -1, cell
    if j >= 0:
        links[j, 2 * d + PREVIOUS_ROW] = i
    head[cell] = i


@lean_inner
def unlink(axes, lists, i):
    """Take row i out of its cell, if it is in one."""
    links = lists.links
    d = len(axes)
    after, before, cell = np.int64(links[i, 2 * d + NEXT_ROW]), np.int64(links[i, 2 * d + PREVIOUS_ROW]), links[i, 2 * d + CELL]
    if cell == NOWHERE:
        return
    if before >= 0:
        links[before, 2 * d + NEXT_ROW] = after
    else:
        lists.head[cell] = after
    if after >= 0:
        links[after, 2 * d + PREVIOUS_ROW] = before
    links[i, 2 * d + CELL] = NOWHERE


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
