"""The index by which rows are found: cells of their midpoints, on three levels of bounding radius, as `trajectories` defines
both.

Most rows need not look as far as the few fast ones get. SLOW rows are in sorted cells, FAST ones in coarser cells of linked
lists, and a few OVERSIZE ones in a list. A SLOW row whose path changes becomes RENEWED and stays in its cell, if the new path
lies within the largest bounding radius of SLOW rows from the midpoint of its first path. Otherwise, and when its path changes
again, it becomes FAST.
"""

from math import inf, nan, sqrt
from typing import Any, NamedTuple

import numpy as np

from particles_mpi.kernels.jit import kernel, lean_inner, prefetch
from particles_mpi.neighbours.cells import Grid, LinkedCells, cell_at, link, unlink
from particles_mpi.neighbours.trajectories import ROWS_AHEAD
from particles_mpi.particles import Array

SLOW, FAST, OVERSIZE, RENEWED = 0, 1, 2, 3
PLACES_AT_ONCE = 8  # places of the sorted cells that are tested together
FLOAT32_LOSS = 1e-6  # of the sum of the numbers that are compared: more than what float32 loses


class SortedCells(NamedTuple):
    """SLOW rows in the order of their cells: rows `order` (m,) by place, and places where each cell starts (cells + 1 or more).

    place (n,): where a row is in `order`. entry (m + PLACES_AT_ONCE, 4) float32: by place, midpoint on the g gridded axes, from
    the grid's origin, and in the last column bounding radius, both times `scale`, with which no coordinate was above 1 at the
    search.
    """

    order: Array
    start: Array
    place: Array
    entry: Array
    scale: float
    grid: Grid


class SearchIndex(NamedTuple):
    """What `find_partners` searches: SLOW rows in `sorted`, FAST ones in `linked`, the first number[0] of `oversize`.

    largest (2,): the largest bounding radius of SLOW and of FAST rows; with a larger one than `limit` a row is OVERSIZE. low,
    high (d,): bounds of all midpoints, and own_low, own_high of those of owned rows.
    """

    sorted: SortedCells
    linked: LinkedCells
    oversize: Array
    number: Array
    largest: Array
    limit: float
    low: Array
    high: Array
    own_low: Array
    own_high: Array


class Holding(NamedTuple):
    """All data of the candidates of one search; plain tuples, whose arrays change in place.

    paths: `Paths`; cells: `SearchIndex`; spheres: `Spheres`; planes: `Planes`; region: `HaloRegion`; length (d,) of the periodic
    axes; marked (n,) bool, around (n + WAITING,) int32: scratch; wall_rows (owned,): room for the rows near walls.
    """

    paths: tuple[Any, ...]
    cells: tuple[Any, ...]
    spheres: tuple[Any, ...]
    planes: tuple[Any, ...]
    region: tuple[Any, ...]
    length: Array
    marked: Array
    around: Array
    wall_rows: Array


@kernel
def levels(midpoint, bounding_radius, slow, fast, most):
    """(level of each row, OVERSIZE rows, their number, largest bounding radius of SLOW rows and of FAST ones, bounds (2, d) of
    the midpoints of SLOW rows).

    SLOW are rows with a bounding radius up to `slow`, FAST up to `fast`, and OVERSIZE beyond; but if more than `most` are
    beyond, they are FAST.
    """
    beyond = 0
    for r in bounding_radius:
        beyond += r > fast
    level = np.empty(len(bounding_radius), np.int8)
    oversize = np.empty(len(bounding_radius), np.int32)
    count = 0
    largest = np.zeros(2)
    box = np.empty((2, midpoint.shape[1]))
    box[0], box[1] = inf, -inf
    for i in range(len(bounding_radius)):
        if bounding_radius[i] <= slow:
            level[i] = SLOW
            for k in range(midpoint.shape[1]):
                box[0, k] = min(box[0, k], midpoint[i, k])
                box[1, k] = max(box[1, k], midpoint[i, k])
        elif bounding_radius[i] <= fast or beyond > most:
            level[i] = FAST
        else:
            level[i] = OVERSIZE
            oversize[count] = i
            count += 1
            continue
        largest[level[i]] = max(largest[level[i]], bounding_radius[i])
    return level, oversize, count, largest, box


@lean_inner
def write_entry(i, e, midpoint, bounding_radius, origin, scale, entry):
    """Row i at place e of `SortedCells.entry`."""
    for k in range(min(midpoint.shape[1], 3)):
        entry[e, k] = (midpoint[i, k] - origin[max(3 - midpoint.shape[1], 0) + k]) * scale
    entry[e, 3] = bounding_radius[i] * scale


@kernel
def fill_cells(paths, order, origin, scale, grid):
    """Cells of SLOW rows `order`, and of FAST ones: (place, entry, head, after, before, cell_of).

    origin and scale: of the `SortedCells`; grid: of the `LinkedCells`.
    """
    _, midpoint, bounding_radius, level, _ = paths
    n = len(midpoint)
    place = np.empty(n, np.int32)
    entry = np.empty((len(order) + PLACES_AT_ONCE, 4), np.float32)
    entry[len(order) :] = nan
    for e in range(len(order)):
        i = order[e]
        place[i] = e
        write_entry(i, e, midpoint, bounding_radius, origin, scale, entry)
    head = np.full(grid.cells[0] * grid.cells[1] * grid.cells[2], -1, np.int32)
    after, before, cell_of = np.empty(n, np.int32), np.empty(n, np.int32), np.empty(n, np.int32)
    linked = LinkedCells(head, after, before, cell_of, grid)
    for i in range(n):
        if level[i] == FAST:
            link(i, cell_at(midpoint, i, grid), linked)
    return place, entry, head, after, before, cell_of


@lean_inner
def move_rows(rows, paths, owned, index):
    """Move rows with new paths, unless they become RENEWED: into the lists of FAST rows, or to the OVERSIZE ones."""
    _, midpoint, bounding_radius, level, _ = paths
    sorted_, linked, oversize, number, largest, limit, low, high, own_low, own_high = index
    _, _, place, entry, scale, (origin, _, _) = sorted_
    _, after, before, cell_of, grid = linked
    g = min(midpoint.shape[1], 3)
    for r in range(len(rows)):
        i = np.int64(rows[r])
        if r + 2 * ROWS_AHEAD < len(rows):
            prefetch(place, rows[r + 2 * ROWS_AHEAD])
            prefetch(level, rows[r + 2 * ROWS_AHEAD])
        if r + ROWS_AHEAD < len(rows):
            ahead = rows[r + ROWS_AHEAD]
            if level[ahead] == FAST:
                prefetch(before, ahead)
                prefetch(after, ahead)
                prefetch(cell_of, ahead)
            else:
                prefetch(entry, place[ahead])
        for k in range(midpoint.shape[1]):
            low[k] = min(low[k], midpoint[i, k])
            high[k] = max(high[k], midpoint[i, k])
            if i < owned:
                own_low[k] = min(own_low[k], midpoint[i, k])
                own_high[k] = max(own_high[k], midpoint[i, k])
        if level[i] == OVERSIZE:
            continue
        if level[i] == FAST:
            unlink(i, linked)
        else:
            e = place[i]
            away = 0.0
            for k in range(g):
                away += ((midpoint[i, k] - origin[3 - g + k]) * scale - entry[e, k]) ** 2
            reach = bounding_radius[i] * scale + sqrt(away)
            if level[i] == SLOW and reach <= largest[SLOW] * scale - FLOAT32_LOSS:  # searches look that far from its cell
                level[i] = RENEWED
                write_entry(i, e, midpoint, bounding_radius, origin, scale, entry)
                continue
            entry[e, 3] = nan  # NaN passes no test: no row finds it there
        if bounding_radius[i] > limit:
            level[i] = OVERSIZE
            oversize[number[0]] = i
            number[0] += 1
        else:
            level[i] = FAST
            largest[FAST] = max(largest[FAST], bounding_radius[i])
            link(i, cell_at(midpoint, i, grid), linked)
