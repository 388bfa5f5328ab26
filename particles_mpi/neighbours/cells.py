"""Linked cells on at most three axes. Plain arrays.

In fewer dimensions the first axes have one cell. Places outside belong to the outermost cells, so that a grid may leave
outliers out, a few of which would else make all cells coarse.
"""

from math import inf
from typing import NamedTuple

import numpy as np

from particles_mpi.errors import StateError
from particles_mpi.kernels import limits
from particles_mpi.kernels.jit import in_place, kernel
from particles_mpi.particles import Array

GRIDDED = 3  # axes with cells; more would cost 3^d cells to visit, and the others are tested by distance anyway
CELLS_TO_A_SIDE = 6  # on the last axis of a sorted grid: runs along it can be any length, so that they may be tight
SMALLEST_SIDE = 1e-300  # of a cell, of points that are all at one place: a million of them in it, and its inverse, are numbers
SLAB = 32  # cells on the second axis; see `order_in_space`
MOST_SLABS = 60_000  # their numbers are sorted as uint16
SAMPLE = 512  # rows that tell where the bulk of the particles is


class Grid(NamedTuple):
    """Cells on three axes; all arrays are (3,)."""

    origin: Array  # corner of the first cell
    per: Array  # cells in a unit of length
    cells: Array  # number of cells


class LinkedCells(NamedTuple):
    """A list of rows for each cell."""

    head: Array  # (cells,) the first row, or -1
    after: Array  # (n,) the next row of the same cell, or -1
    before: Array  # (n,) the one before
    cell_of: Array  # (n,)
    grid: Grid


def grid(x: Array, box: tuple[Array, Array], side: float, fine: int) -> Grid:
    """Return cells of about `side`, and side/fine on the last axis, for the rows of x (n, d) in `box`: at most about n sides."""
    g = min(x.shape[1], GRIDDED)
    first = GRIDDED - g
    origin, per, cells = np.zeros(GRIDDED), np.zeros(GRIDDED), np.ones(GRIDDED, np.int64)
    if len(x) == 0:
        return Grid(origin, per, cells)
    low, high = bulk(x[:, :g], box[0][:g], box[1][:g])
    extent = np.maximum(high - low, 0.0)
    side = max(side, SMALLEST_SIDE, float(extent.max()) * 1e-6)
    while np.prod(np.floor(extent / side) + 1.0) > min(max(len(x), 64), limits.INT32_MAX // fine):
        side *= 1.25
    origin[first:] = low
    per[first:] = 1.0 / side
    per[-1] *= fine
    cells[first:] = (extent * per[first:]).astype(np.int64) + 1
    return Grid(origin, per, cells)


def bulk(x: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """The corners of a box in [low, high] that has nearly all rows of x (n, d): outliers would make all cells coarse."""
    sample = np.sort(x[:: max(len(x) // SAMPLE, 1)], axis=0)
    left, right = sample[len(sample) // 20], sample[-1 - len(sample) // 20]
    return np.maximum(low, left - (right - left)), np.minimum(high, right + (right - left))


def spacing(low: Array, high: Array, n: int) -> float:
    """Mean distance of n rows in the gridded part of the box [low, high], or on the plane or line that it is; 0 of a point."""
    extent = np.maximum(high - low, 0.0)[:GRIDDED]
    extent = extent[extent > 1e-9 * extent.max()]
    return float(np.exp(np.log(extent).mean()) / max(n, 1) ** (1.0 / len(extent))) if len(extent) else 0.0


def too_narrow(length: Array, distance: float) -> StateError:
    """Return the error about spheres that may touch at this distance of their centres, in a periodic box not twice as wide."""
    return StateError(
        f"particles.radius: a periodic box must be more than twice as wide as the largest distance of touching spheres; it is"
        f" {length[length > 0.0].min():g} wide, and that is {distance:g}"
    )


@kernel
def bounds(x):
    """(lowest, highest) coordinates of the rows of x (n, d); (inf, -inf) if n = 0."""
    low = np.full(x.shape[1], inf)
    high = np.full(x.shape[1], -inf)
    for i in range(x.shape[0]):
        for k in range(x.shape[1]):
            low[k] = low[k] if low[k] <= x[i, k] else x[i, k]
            high[k] = high[k] if high[k] >= x[i, k] else x[i, k]
    return low, high


@in_place
def cell_along(y, origin, per, cells):
    """The cell of coordinate y on one axis; monotone in y, so that an interval of y is an interval of cells."""
    return int(min(max((y - origin) * per, 0.0), cells - 1.0))


@in_place
def cell_at(x, i, grid):
    """The cell of row i of x (n, d)."""
    origin, per, cells = grid
    first = max(0, 3 - x.shape[1])
    c = 0
    for m in range(first, 3):
        c = c * cells[m] + cell_along(x[i, m - first], origin[m], per[m], cells[m])
    return c


@kernel(error_model="numpy")
def sort_rows(x, level, wanted, grid):
    """(order, start): rows of one level sorted by cell (rows in order within one), and where each cell starts among them."""
    n = len(x)
    cells = grid.cells
    cell_of = np.empty(n, np.int32)
    start = np.zeros(cells[0] * cells[1] * cells[2] + 2, np.int32)  # rows of cell c counted at c + 2, then its place at c + 1
    count = 0
    for i in range(n):
        if level[i] == wanted:
            c = cell_at(x, i, grid)
            cell_of[i] = c
            start[c + 2] += 1
            count += 1
    for c in range(len(start) - 2):
        start[c + 2] += start[c + 1]
    order = np.empty(count, np.int32)
    for i in range(n):
        if level[i] == wanted:
            c = cell_of[i]
            order[start[c + 1]] = i
            start[c + 1] += 1
    return order, start


def order_in_space(x: Array, box: tuple[Array, Array]) -> Array:
    """Return rows of x (n, d) in `box` in an order in which those near in space are near one another; n > 0.

    The order is by cells. Where there are many on the second axis it is by slabs of them, so that a row and its neighbours on the
    first axis are not further apart in memory than the caches reach.
    """
    cells = grid(x, box, spacing(*box, len(x)), 1)
    order, _ = sort_rows(x, np.zeros(len(x), np.int8), 0, cells)
    if x.shape[1] < GRIDDED or cells.cells[1] <= SLAB:
        return order
    slab = ((x[:, 1] - cells.origin[1]) * (cells.per[1] / SLAB)).clip(0.0, MOST_SLABS).astype(np.uint16)
    return order[np.argsort(slab[order], kind="stable")]


@in_place
def link(i, c, linked):
    """Put row i into the list of cell c."""
    head, after, before, cell_of, _ = linked
    j = head[c]
    after[i], before[i], cell_of[i] = j, -1, c
    if j >= 0:
        before[j] = i
    head[c] = i


@in_place
def unlink(i, linked):
    """Take row i out of the list of its cell."""
    head, after, before, cell_of, _ = linked
    if before[i] >= 0:
        after[before[i]] = after[i]
    else:
        head[cell_of[i]] = after[i]
    if after[i] >= 0:
        before[after[i]] = before[i]
