"""Cells of the rows that neighbour lists are made for, at their reference positions: see `verlet_kernels`.

Cells come in levels: those of a level are about as wide as the sizes R + skin in it, so that a few large spheres do not make the
search of all small ones coarse. The rows of a cell are linked, so that one row can move without the others. `lists`, in the
kernels here, is a `verlet_kernels.Lists`.
"""

from math import floor
from typing import NamedTuple

import numpy as np

from particles_mpi.kernels import limits
from particles_mpi.kernels.geometry import Box
from particles_mpi.kernels.jit import in_place, inner, lean_inner, prefetch
from particles_mpi.neighbours.cells import GRIDDED
from particles_mpi.particles import Array

LEVELS, FACTOR = 5, 3.0  # each level of cells is for sizes up to FACTOR times those of the one before
WIDTH = 1.4  # of a cell, in sizes of the largest row in it
NEXT_ROW, PREVIOUS_ROW, CELL = 6, 7, 8  # columns of `Lists.links`, after 2 d: behind the float64 numbers there
NO_CELL = -1  # in place of a cell
MARGIN = 1.0 + 1e-9  # on distances between reference positions, far above round-off


class VerletGrid(NamedTuple):
    """Cells of all levels; their numbers follow one another, level after level."""

    low: Array  # (3,) corner of the cells
    per_length: Array  # (levels, 3) cells in a unit of length
    cells: Array  # (levels, 3) cells along each axis
    first: Array  # (levels + 1,) number of the first cell
    largest: Array  # (levels,) size R + skin of the largest row in the level, -1 if the level is not used


def make_grid(x: Array, size: Array, box: Box, share: float) -> tuple[VerletGrid, Array]:
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
            while np.prod(np.floor(extent / side) + 1.0) > min(max(2 * len(sizes) * share, 64), limits.INT32_MAX // LEVELS):
                side *= 1.25
            count = np.maximum(np.floor(extent / side), 1.0)
            cells[step, :g] = count.astype(np.int64)
            per_length[step, :g] = count / extent
        first[step + 1] = first[step] + cells[step].prod()
    corner = np.zeros(GRIDDED)
    corner[:g] = low
    return VerletGrid(corner, per_length, cells, first, largest), level


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
                    prefetch(reference, j)  # for -1 this does nothing useful
                    nearby[np.uint64(waiting)] = j
                    waiting += j >= 0
    return waiting


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
    if cell == NO_CELL:
        return
    if before >= 0:
        links[before, 2 * d + NEXT_ROW] = after
    else:
        lists.head[cell] = after
    if after >= 0:
        links[after, 2 * d + PREVIOUS_ROW] = before
    links[i, 2 * d + CELL] = NO_CELL
