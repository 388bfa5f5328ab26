"""Linked cells on at most three axes: rows sorted by cell. Plain arrays.

Cells along the last gridded axis are contiguous in the sorted order: all rows that are near a place are a few runs of entries.
"""

from __future__ import annotations

from math import inf

import numpy as np
from numba import njit

from particles_mpi.particles import Array

GRIDDED = 3  # axes with cells; more would cost 3^d cells to visit, and the others are tested by distance anyway
FINE = 4  # cells to a side on the last gridded axis: runs along it can be any length, so that they may as well be tight
SAMPLE = 512  # rows that tell where the bulk of the particles is


def grid(x: Array, side: float) -> tuple[Array, Array, Array]:
    """(origin, cells a unit length, cells), of shape (3,), of cells of about `side` over the rows of x (n, d); d < 3: the
    first axes have one cell. At most about FINE cells a row.

    Rows outside belong to the outermost cells. So the grid may leave outliers out, a few of which would else make the cells
    of all others coarse.
    """
    g = min(x.shape[1], GRIDDED)
    first = GRIDDED - g
    origin, per, cells = np.zeros(GRIDDED), np.zeros(GRIDDED), np.ones(GRIDDED, np.int64)
    if len(x) == 0:
        return origin, per, cells
    sample = np.sort(x[:: max(len(x) // SAMPLE, 1), :g], axis=0)
    left, right = sample[len(sample) // 20], sample[-1 - len(sample) // 20]
    low, high = bounds(x)
    low = np.maximum(low[:g], left - (right - left))
    high = np.minimum(high[:g], right + (right - left))
    extent = np.maximum(high - low, 0.0)
    side = max(side, np.finfo(float).tiny, float(extent.max()) * 1e-6)
    while np.prod(np.floor(extent / side) + 1.0) > max(len(x), 64):
        side *= 1.25
    origin[first:] = low
    per[first:] = 1.0 / side
    per[-1] *= FINE
    cells[first:] = (extent * per[first:]).astype(np.int64) + 1
    return origin, per, cells


@njit(cache=True)
def bounds(x):
    """(lowest, highest) coordinates of the rows of x (n, d); (inf, -inf) if n = 0."""
    low = np.full(x.shape[1], inf)
    high = np.full(x.shape[1], -inf)
    for i in range(x.shape[0]):
        for k in range(x.shape[1]):
            low[k] = min(low[k], x[i, k])
            high[k] = max(high[k], x[i, k])
    return low, high


@njit(cache=True)
def cell_along(y, origin, per, cells):
    """The cell of coordinate y on one axis; monotone in y, so that an interval of y is an interval of cells."""
    return int(min(max((y - origin) * per, 0.0), cells - 1.0))


@njit(cache=True, error_model="numpy")
def cell_order(x, origin, per, cells):
    """(order, start): rows sorted by cell (rows in order within one), and where each cell starts among them; a counting sort.

    The other arguments are those that `grid` gives.
    """
    n = len(x)
    first = max(0, 3 - x.shape[1])
    cell_of = np.empty(n, np.int32)
    start = np.zeros(cells[0] * cells[1] * cells[2] + 2, np.int32)  # rows of cell c counted at c + 2, then its place at c + 1
    for i in range(n):
        c = 0
        for m in range(first, 3):
            c = c * cells[m] + cell_along(x[i, m - first], origin[m], per[m], cells[m])
        cell_of[i] = c
        start[c + 2] += 1
    for c in range(len(start) - 2):
        start[c + 2] += start[c + 1]
    order = np.empty(n, np.int32)
    for i in range(n):
        c = cell_of[i]
        order[start[c + 1]] = i
        start[c + 1] += 1
    return order, start
