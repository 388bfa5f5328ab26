"""Neighbour lists for particles that move one at a time: every particle has a home, and a shell around it.

A particle stays within `shell` of its `home` until it is given a new one, so two that can touch are in each other's list:
their homes are no further apart than R_i + R_j + shell_i + shell_j. A particle that reaches its shell gets a new home and
a new list, found in cells that hold the homes. Homes are in unwrapped coordinates, near x; distances take the nearest image.

What a look at a neighbour needs stands together in a row of `home` (n, width): home (d), size = R + shell, shell, w = 1/m, and,
as integers seen through `links`, the next and the last row in the same cell, and the cell. `lists` (n, 4) int32: where
the list of a row begins in the pool, how many it holds, and how many it can.

Cells come in levels: a particle stands in the level of its reach R + shell, whose cells are about as wide, so that a few
large spheres do not make the search of all the small ones coarse. Lists are supersets: they cost time and change no result.
"""

from __future__ import annotations

from math import floor

import numpy as np

from particles_mpi.kernels.geometry import image_shift
from particles_mpi.kernels.jit import inner, kernel, lean_inner, prefetch
from particles_mpi.particles import Array

GRIDDED = 3  # axes with cells
LEVELS, FACTOR = 5, 3.0  # each level of cells is for reaches up to FACTOR times those of the one before
WIDTH = 1.4  # of a cell, in reaches of the largest row in it
PLACES = 16  # in a new list; a list that gets full moves to one twice as long
AFTER, BEFORE, CELL = 6, 7, 8  # int32 places in a row of `links`, behind 2 d
BEGIN, COUNT, ROOM = 0, 1, 2
MARGIN = 1.0 + 1e-9  # on distances between homes, far above round-off

Grid = tuple[Array, Array, Array, Array, Array]


def grids(x: Array, reach: Array, box: tuple[Array, Array], length: Array, share: float = 1.0) -> tuple[Grid, Array]:
    """(grid, level of each row) for homes x (n, d): grid = (low (3,), per (levels, 3), cells (levels, 3), first, caps (levels,)).

    `box`: the corners of the region; open axes of it may be infinite, then the rows decide. It may hold
    `share` times as many rows as these. Places outside belong to the outermost cells, or to their image if the axis is periodic.
    """
    g = min(x.shape[1], GRIDDED)
    low, high = (np.array(side[:g], float) for side in box)
    if len(x):
        low = np.where(np.isfinite(low), np.maximum(low, x[:, :g].min(axis=0)), x[:, :g].min(axis=0))
        high = np.where(np.isfinite(high), np.minimum(high, x[:, :g].max(axis=0)), x[:, :g].max(axis=0))
    periodic = length[:g] > 0.0
    low, high = np.where(periodic, box[0][:g], low), np.where(periodic, box[1][:g], high)
    moving = reach[reach > 0.0]
    typical = float(np.median(moving)) * 1.5 if len(moving) else 1.0
    steps = np.ceil(np.log(np.maximum(reach, 1e-300) / typical) / np.log(FACTOR))
    level = np.clip(steps, 0, LEVELS - 1).astype(np.int8)
    per, cells = np.zeros((LEVELS, GRIDDED)), np.ones((LEVELS, GRIDDED), np.int64)
    caps, first = np.full(LEVELS, -1.0), np.zeros(LEVELS + 1, np.int64)
    for step in range(LEVELS):
        rows = np.flatnonzero(level == step)
        if len(rows):
            caps[step] = reach[rows].max()
            extent = np.maximum(high - low, 1e-300)
            side = max(WIDTH * float(caps[step]), float(extent.max()) * 1e-5, 1e-300)
            while np.prod(np.floor(extent / side) + 1.0) > max(2 * len(rows) * share, 64):
                side *= 1.25
            count = np.maximum(np.floor(extent / side), 1.0)
            cells[step, :g] = count.astype(np.int64)
            per[step, :g] = count / extent
        first[step + 1] = first[step] + cells[step].prod()
    corner = np.zeros(GRIDDED)
    corner[:g] = low
    return (corner, per, cells, first, caps), level


@inner
def level_of(reach, caps):
    """The level for one row more, of this reach; the widest one may have to hold wider rows than it was made for."""
    widest = 0
    for step in range(len(caps)):
        if caps[step] >= reach:
            return step
        if caps[step] >= 0.0:
            widest = step
    caps[widest] = reach
    return widest


@lean_inner
def along(y, reach, low, per, cells, periodic):
    """(first cell, number of cells) of the interval y +- reach on one axis; on a periodic one they may pass the end."""
    begin = floor((y - reach - low) * per)
    end = floor((y + reach - low) * per)
    if periodic:
        if end - begin + 1.0 >= cells:
            return 0, np.int64(cells)
        return np.int64(begin - floor(begin / cells) * cells), np.int64(end - begin) + 1
    begin = min(max(begin, 0.0), cells - 1.0)
    return np.int64(begin), np.int64(min(max(end, 0.0), cells - 1.0) - begin) + 1


@inner(inline="always")
def near_homes(axes, home, i, j, length, far):
    """May rows i and j touch while both are in their shells? Never both immovable."""
    d = len(axes)
    r2 = 0.0
    for k in range(d):
        r = home[i, k] - home[j, k]
        if far:
            r -= image_shift(r, length[k])
        else:
            r -= length[k] * (np.float64(r > 0.5 * length[k]) - np.float64(r < -0.5 * length[k]))
        r2 += r * r
    reach = (home[i, d] + home[j, d]) * MARGIN
    return (r2 <= reach * reach) & (i != j) & ((home[i, d + 2] > 0.0) | (home[j, d + 2] > 0.0))


@lean_inner
def listed(pool, lists, top, i, j):
    """Put j into the list of i, for which there is room in the pool."""
    if lists[i, COUNT] == lists[i, ROOM]:
        for p in range(lists[i, COUNT]):
            pool[top[0] + p] = pool[lists[i, BEGIN] + p]
        lists[i, BEGIN] = top[0]
        lists[i, ROOM] *= 2
        top[0] += lists[i, ROOM]
    pool[lists[i, BEGIN] + lists[i, COUNT]] = j
    lists[i, COUNT] += 1


@lean_inner
def unlisted(pool, lists, i, j):
    """Take j out of the list of i."""
    last = lists[i, BEGIN] + lists[i, COUNT] - 1
    for p in range(lists[i, BEGIN], last + 1):
        if pool[p] == j:
            pool[p] = pool[last]
            lists[i, COUNT] -= 1
            return


@lean_inner
def neighbours(axes, i, home, links, head, low, per, cells, first, caps, length, far, around):
    """Rows in the cells that may be in touch with row i, into `around`; returns how many."""
    d = len(axes)
    waiting = 0
    f0 = f1 = f2 = 0
    m0 = m1 = m2 = 1
    for step in range(len(caps)):
        if caps[step] < 0.0:
            continue
        reach = (home[i, d] + caps[step]) * MARGIN
        f0, m0 = along(home[i, 0], reach, low[0], per[step, 0], cells[step, 0], length[0] > 0.0)
        if d > 1:
            f1, m1 = along(home[i, 1], reach, low[1], per[step, 1], cells[step, 1], length[1] > 0.0)
        if d > 2:
            f2, m2 = along(home[i, 2], reach, low[2], per[step, 2], cells[step, 2], length[2] > 0.0)
        for a in range(m0):
            c0 = f0 + a if f0 + a < cells[step, 0] else f0 + a - cells[step, 0]
            for b in range(m1):
                c1 = f1 + b if f1 + b < cells[step, 1] else f1 + b - cells[step, 1]
                for c in range(m2):
                    c2 = f2 + c if f2 + c < cells[step, 2] else f2 + c - cells[step, 2]
                    j = head[np.uint64(first[step] + (c0 * cells[step, 1] + c1) * cells[step, 2] + c2)]
                    prefetch(home, j)  # for -1 it asks in vain
                    around[np.uint64(waiting)] = j
                    waiting += j >= 0
    # Each is taken from the front, the next one in its cell is put behind: without a branch the memory answers many at once.
    found = 0
    p = 0
    while p < waiting:
        j = np.uint64(around[np.uint64(p)])
        p += 1
        after = links[j, 2 * d + AFTER]
        prefetch(home, after)
        around[np.uint64(waiting)] = after
        waiting += after >= 0
        around[np.uint64(found)] = j
        found += near_homes(axes, home, np.uint64(i), j, length, far)
    return found


@lean_inner
def room_for(i, around, found, lists):
    """Places that the pool needs at most to list `found` rows `around` i, and i with each of them."""
    need = np.int64(0)
    longer = np.int64(lists[i, ROOM])
    while longer < found:
        longer *= 2
        need += longer
    for p in range(found):
        j = around[p]
        if lists[j, COUNT] == lists[j, ROOM]:
            need += 2 * lists[j, ROOM]
    return need


@lean_inner
def move_in(axes, i, home, links, level, around, found, pool, lists, top, head, low, per, cells, first, length):
    """List row i with the rows `around` it, and put it into its cell."""
    d = len(axes)
    for p in range(found):
        j = np.int64(around[p])
        listed(pool, lists, top, i, j)
        listed(pool, lists, top, j, i)
    step = level[i]
    c = np.int64(0)
    for m in range(min(d, 3)):
        at = floor((home[i, m] - low[m]) * per[step, m])
        if length[m] > 0.0:
            at -= floor(at / cells[step, m]) * cells[step, m]
        c = c * cells[step, m] + np.int64(min(max(at, 0.0), cells[step, m] - 1.0))
    cell = first[step] + c
    j = np.int64(head[cell])
    links[i, 2 * d + AFTER], links[i, 2 * d + BEFORE], links[i, 2 * d + CELL] = j, -1, cell
    if j >= 0:
        links[j, 2 * d + BEFORE] = i
    head[cell] = i


@lean_inner
def move_out(axes, i, links, pool, lists, head):
    """Row i leaves its cell and all lists."""
    d = len(axes)
    for p in range(lists[i, BEGIN], lists[i, BEGIN] + lists[i, COUNT]):
        prefetch(lists, pool[p])
    for p in range(lists[i, BEGIN], lists[i, BEGIN] + lists[i, COUNT]):
        prefetch(pool, lists[pool[p], BEGIN])
    for p in range(lists[i, BEGIN], lists[i, BEGIN] + lists[i, COUNT]):
        unlisted(pool, lists, pool[p], i)
    lists[i, COUNT] = 0
    after, before = links[i, 2 * d + AFTER], links[i, 2 * d + BEFORE]
    if before >= 0:
        links[before, 2 * d + AFTER] = after
    else:
        head[links[i, 2 * d + CELL]] = after
    if after >= 0:
        links[after, 2 * d + BEFORE] = before


@inner
def larger(pool, used, need):
    """The pool, or a copy with room for `need` more places than are used."""
    if used + need <= len(pool):
        return pool
    copy = np.empty(2 * len(pool) + need, np.int32)
    for p in range(used):
        copy[p] = pool[p]
    return copy


@kernel
def settle_all(axes, x, home, links, level, pool, lists, top, head, grid, length, around):
    """Homes of all rows where they are. Returns the pool."""
    low, per, cells, first, caps = grid
    for i in range(len(x)):
        for k in range(len(axes)):
            home[i, k] = x[i, k]
        found = neighbours(axes, i, home, links, head, low, per, cells, first, caps, length, np.bool_(True), around)
        pool = larger(pool, top[0], room_for(i, around, found, lists))
        move_in(axes, i, home, links, level, around, found, pool, lists, top, head, low, per, cells, first, length)
    return pool
