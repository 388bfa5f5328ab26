"""By what rows are found: cells of their midpoints, on three levels of bounding radius. See `trajectories` for both.

Most rows need not look as far as the few fast ones get: SLOW ones are held in sorted cells, FAST ones and all that got a new path
in coarser cells of linked lists, and a few OVERSIZE ones one by one.
"""

from __future__ import annotations

from math import inf
from typing import NamedTuple

import numpy as np

from particles_mpi.kernels.jit import kernel, lean
from particles_mpi.neighbours.cells import (
    FINE,
    GRIDDED,
    Grid,
    LinkedCells,
    bounds,
    cell_at,
    grid,
    link,
    sort_rows,
    spacing,
    unlink,
)
from particles_mpi.particles import Array

SLOW, FAST, OVERSIZE = 0, 1, 2
SLOWEST = 2.2  # times the mean bounding radius: rows beyond it are FAST, one in a hundred of a gas
LARGEST = 8.0  # times the mean bounding radius: rows beyond it are OVERSIZE, if no more than FEW are
FEW = 64


class SortedCells(NamedTuple):
    """SLOW rows in the order of their cells."""

    order: Array  # (m,) the rows by place
    start: Array  # (cells + 1 or more,) the place where each cell starts
    place: Array  # (n,) of each row in `order`
    entry: Array  # (m, g + 1) by place: midpoint on the g gridded axes, and bounding radius
    grid: Grid


class SearchIndex(NamedTuple):
    """By what `find_partners` finds rows."""

    sorted: SortedCells  # SLOW rows
    linked: LinkedCells  # FAST rows
    oversize: Array  # of which the first number[0] are OVERSIZE rows
    number: Array
    largest: Array  # (2,) largest bounding radius of SLOW rows, and of FAST ones
    limit: float  # with a larger bounding radius a row is OVERSIZE
    low: Array  # (d,) bounds of all midpoints
    high: Array
    own_low: Array  # (d,) those of owned rows
    own_high: Array


def build_index(midpoint: Array, bounding_radius: Array, owned: int, all_in_cells: bool) -> tuple[Array, SearchIndex]:
    """(level (n,), the index) of rows with these midpoints (n, d); if `all_in_cells`, none is OVERSIZE now or later."""
    n, g = len(midpoint), min(midpoint.shape[1], GRIDDED)
    mean = float(bounding_radius.mean()) if n else 0.0
    limit = inf if all_in_cells else LARGEST * mean
    level = np.where(bounding_radius <= SLOWEST * mean, SLOW, FAST).astype(np.int8)
    oversize, beyond = np.empty(n, np.int32), np.flatnonzero(bounding_radius > limit)
    count = len(beyond) if len(beyond) <= FEW else 0
    level[beyond[:count]] = OVERSIZE
    oversize[:count] = beyond[:count]
    largest = np.array([bounding_radius[level == which].max(initial=0.0) for which in (SLOW, FAST)])
    low, high = box = bounds(midpoint)
    apart = spacing(low, high, n)
    fine, coarse = grid(midpoint, box, max(0.9 * apart, 0.6 * mean), FINE), grid(midpoint, box, 2.0 * max(apart, mean), 1)
    order, start = sort_rows(midpoint, level, SLOW, fine)
    place = np.empty(n, np.int32)
    place[order] = np.arange(len(order))
    entry = np.empty((len(order), g + 1))
    entry[:, :g], entry[:, g] = midpoint[order, :g], bounding_radius[order]
    after, before, cell_of = np.empty((3, n), np.int32)
    linked = LinkedCells(np.full(coarse.cells.prod(), -1, np.int32), after, before, cell_of, coarse)
    link_rows(np.flatnonzero(level == FAST), midpoint, linked)
    in_order = SortedCells(order, start, place, entry, fine)
    return level, SearchIndex(in_order, linked, oversize, np.array([count]), largest, limit, low, high, *bounds(midpoint[:owned]))


@kernel
def link_rows(rows, midpoint, linked):
    """Put rows into the linked cells of their midpoints."""
    for i in rows:
        link(i, cell_at(midpoint, i, linked.grid), linked)


@lean
def move_rows(rows, paths, owned, index):
    """Rows with new paths change places: into the lists of the FAST rows, or to the OVERSIZE ones."""
    _, midpoint, bounding_radius, level, _ = paths
    sorted_, linked, oversize, number, largest, limit, low, high, own_low, own_high = index
    _, _, place, entry, _ = sorted_
    _, _, _, _, linked_grid = linked
    for r in range(len(rows)):
        i = np.int64(rows[r])
        for k in range(midpoint.shape[1]):
            low[k] = min(low[k], midpoint[i, k])
            high[k] = max(high[k], midpoint[i, k])
            if i < owned:
                own_low[k] = min(own_low[k], midpoint[i, k])
                own_high[k] = max(own_high[k], midpoint[i, k])
        if level[i] == OVERSIZE:
            continue
        if level[i] == SLOW:
            entry[place[i], 0] = inf  # no one meets it there
        else:
            unlink(i, linked)
        if bounding_radius[i] > limit:
            level[i] = OVERSIZE
            oversize[number[0]] = i
            number[0] += 1
        else:
            level[i] = FAST
            largest[FAST] = max(largest[FAST], bounding_radius[i])
            link(i, cell_at(midpoint, i, linked_grid), linked)
