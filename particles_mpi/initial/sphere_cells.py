"""Linked cells for spheres of any sizes.

Each class of radius has a grid of its own, so that a few large spheres among many small ones cost no time. The cells are those of
the whole box, folded into as many lists as a rank has room for.
"""

from math import prod
from sys import float_info
from typing import NamedTuple

import numpy as np

from particles_mpi.kernels.jit import kernel, lean_inner
from particles_mpi.particles import Array

CLASSES = 10  # classes of radius, each with radii at most half as large as in the one before


class Grids(NamedTuple):
    """Linked cells: a grid over the box for each class of radius, and for each cell a list of the spheres in it, newest first."""

    head: Array  # (lists,) first row of each list; -1: none
    after: Array  # (n,) the next row of the same list; -1: none
    kind: Array  # (n,) class of each sphere
    largest: Array  # (CLASSES,) largest radius of each class; -1: no sphere has this class
    cells: Array  # (CLASSES, 3) cells of a grid along each axis
    first: Array  # (CLASSES,) where the lists of a class begin in `head`
    mask: Array  # (CLASSES,) its number of lists less one: a power of two less one
    lower: Array  # (d,) corner of the box
    extent: Array  # (d,) its lengths
    length: Array  # (d,) those of periodic axes; 0 for others


@kernel
def class_of(radius, largest):
    """The class of each radius (n,): 0 for those above half of the largest, and so on."""
    kind = np.empty(len(radius), np.int8)
    for i in range(len(radius)):
        least = 0.5 * largest
        kind[i] = 0
        while radius[i] <= least and kind[i] < CLASSES - 1:
            least *= 0.5
            kind[i] += 1
    return kind


def cells_of(extent: Array, count: int, side: float) -> list[int]:
    """Cells along three axes: each at least `side` wide, and not many more than two for each of `count` spheres."""
    edges = extent[:3].tolist()
    side = max(side, 1e-6 * max(edges), float_info.min)
    while prod(cells := [max(1, int(edge / side)) for edge in edges]) > 2 * count + 64:
        side *= 1.2
    return [*cells, 1, 1][:3]


@lean_inner
def cells_within(k, y, far, grid, cells):
    """First and last cell on axis k within `far` of the point y (d,); below 0 and from `cells` on are those beyond a period."""
    if k >= len(y) or cells == 1:
        return 0, 0
    low = int(np.floor((y[k] - far - grid.lower[k]) / grid.extent[k] * cells))
    high = int(np.floor((y[k] + far - grid.lower[k]) / grid.extent[k] * cells))
    if grid.length[k] == 0.0:
        return min(max(low, 0), cells - 1), max(min(high, cells - 1), 0)
    return (0, cells - 1) if high - low >= cells else (low, high)


@lean_inner
def list_of(y, kind, grid):
    """The list of a sphere of this class at the point y (d,)."""
    c = 0
    for k in range(3):
        cells = grid.cells[kind, k]
        c = c * cells + cells_within(k, y, 0.0, grid, cells)[0] % cells
    return grid.first[kind] + (c & grid.mask[kind])


@kernel
def list_of_each(x, kind, grid):
    """The lists of the spheres at x (n, d) with these classes (n,)."""
    lists = np.empty(len(x), np.int32)
    for i in range(len(x)):
        lists[i] = list_of(x[i], kind[i], grid)
    return lists


@kernel
def enter_spheres(x, first, last, grid):
    """Enter the rows first ... last - 1."""
    for i in range(first, last):
        c = list_of(x[i], grid.kind[i], grid)
        grid.after[i] = grid.head[c]
        grid.head[c] = i


@kernel
def keep(first, last, stays, x, radius, ids, grid):
    """Take away those of the rows first ... last - 1, the last that were entered, that do not stay; the new `last`.

    The newest rows are at the heads of their lists: all are taken out, and those that stay enter again in their new rows.
    """
    for i in range(first, last):
        c = list_of(x[i], grid.kind[i], grid)
        while grid.head[c] >= first:
            grid.head[c] = grid.after[grid.head[c]]
    n = first
    for i in range(first, last):
        if stays[i - first]:
            for k in range(x.shape[1]):
                x[n, k] = x[i, k]
            radius[n], ids[n], grid.kind[n] = radius[i], ids[i], grid.kind[i]
            n += 1
    enter_spheres(x, first, n, grid)
    return n
