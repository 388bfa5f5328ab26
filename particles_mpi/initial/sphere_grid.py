"""A grid of spheres of any sizes, which finds those that overlap, and decides which one has its place first.

A rank holds the spheres of its part of space, in the cells of `sphere_cells`.
"""

import numpy as np

from particles_mpi.initial.sphere_cells import Grids, cells_of, cells_within, class_of, enter_spheres, keep, list_of_each
from particles_mpi.kernels.geometry import nearest
from particles_mpi.kernels.jit import kernel, lean_inner
from particles_mpi.kernels.limits import require_countable
from particles_mpi.particles import Array

UNDECIDED, FREE, TAKEN = 0, 1, 2  # may a sphere stay where it is?


class SphereGrid:
    """Rows of spheres x (n, d), radius (n,), id (n,) in linked cells; room for more is made as they come.

    `counts` and `largest_radii` (CLASSES,): how many spheres of each class there will be on all ranks, and the largest radius
    of each; `ranks`: among how many they are divided.
    """

    def __init__(self, lower: Array, extent: Array, length: Array, counts: Array, largest_radii: Array, ranks: int = 1):
        cells = np.array([cells_of(extent, int(count), 2.0 * far) for count, far in zip(counts, largest_radii)])
        lists = np.array([1 << int(-(-int(c) // ranks) - 1).bit_length() for c in cells.prod(axis=1)])
        first = np.cumsum(lists) - lists
        self.n, d, space = 0, len(lower), int(1.05 * counts.sum() / ranks) + 1
        require_countable(max(space, int(lists.sum())), "spheres, or cells for them,")
        self.x, self.radius, self.id = np.empty((space, d)), np.empty(space), np.empty(space, np.int64)
        head, after, kind = np.full(int(lists.sum()), -1, np.int32), np.empty(space, np.int32), np.empty(space, np.int8)
        self.grids = Grids(head, after, kind, largest_radii, cells, first, lists - 1, lower, extent, length)
        self.largest = float(largest_radii.max())

    def append(self, x: Array, radius: Array, ids: Array, enter: bool = True) -> tuple[int, int]:
        """Put spheres behind the others, and `enter` them into the lists; returns (first, last + 1) of their rows."""
        first, last = self.n, self.n + len(x)
        if last > len(self.radius):
            require_countable(last, "spheres")
            capacity = last + last // 4
            new = np.empty((capacity, x.shape[1])), np.empty(capacity), np.empty(capacity, np.int64)
            grids = self.grids._replace(after=np.empty(capacity, np.int32), kind=np.empty(capacity, np.int8))
            old = self.x, self.radius, self.id, self.grids.after, self.grids.kind
            for wide, narrow in zip((*new, grids.after, grids.kind), old, strict=True):
                wide[:first] = narrow[:first]
            self.x, self.radius, self.id, self.grids = *new, grids
        self.x[first:last], self.radius[first:last], self.id[first:last] = x, radius, ids
        self.grids.kind[first:last] = class_of(radius, self.largest)
        if enter:
            enter_spheres(self.x, first, last, self.grids)
        self.n = last
        return first, last

    def keep(self, first: int, stays: Array) -> None:
        """Remove those of the rows from `first` on, which came last, that do not stay (bool)."""
        if not stays.all():
            self.n = keep(first, self.n, stays, self.x, self.radius, self.id, self.grids)

    def order(self, x: Array, radius: Array) -> Array:
        """The spheres (n,) sorted by their cells: neighbours in space are then near one another in memory."""
        return np.argsort(list_of_each(x, class_of(radius, self.largest), self.grids))

    def decide(self, rows: Array, first: int, status: Array, margin: float) -> Array:
        """Decide which of `rows` may stay, as far as that can be told; returns those that are undecided. See `decide`."""
        rows = rows.copy()
        while True:
            left = decide(rows, self.x, self.radius, self.id, first, status, margin, self.grids)
            if left == 0 or left == len(rows):
                return rows[:left]
            rows = rows[:left]

    def open_points(self, x: Array, radius: Array, margin: float, rows: Array | None = None) -> Array:
        """Return at which of the points x (n, d) a sphere with this radius (n,) would overlap no other; (n,) bool.

        `rows` (n,): those of these spheres, if they are in the grid themselves.
        """
        me = np.full(len(x), -1) if rows is None else rows
        return np.asarray(open_points(x, radius, me, self.x, self.radius, self.id, self.n, margin, self.grids))

    def first_come(self, x: Array, radius: Array, particle: Array, count: int, margin: float) -> tuple[int, Array]:
        """Put spheres at x (n, d), one after the other; those that overlap, or whose `particle` (n,) has a place, are left out.

        Returns (first row, which stay): they are rows from there on until `keep` is called.
        """
        first, last = self.append(x, radius, np.full(len(x), -1), enter=False)
        placed = np.zeros(count, np.bool_)
        return first, first_come(first, last, particle, placed, self.x, self.radius, self.id, margin, self.grids)


@lean_inner
def verdict(y, r, me, x, radius, ids, first, status, margin, grid):
    """May a sphere of radius r be at the point y (d,)? FREE, TAKEN or UNDECIDED; `me`: its row, or -1. See `decide`."""
    result = FREE
    for kind in range(len(grid.largest)):
        far = (r + grid.largest[kind]) * (1.0 + 1e-9)
        if grid.largest[kind] < 0.0 or far == 0.0:
            continue
        m0, m1, m2 = grid.cells[kind, 0], grid.cells[kind, 1], grid.cells[kind, 2]
        a0, a1 = cells_within(np.int64(0), y, far, grid, m0)
        b0, b1 = cells_within(np.int64(1), y, far, grid, m1)
        c0, c1 = cells_within(np.int64(2), y, far, grid, m2)
        for a in range(a0, a1 + 1):
            row_a = (a + m0 if a < 0 else a - m0 if a >= m0 else a) * m1
            for b in range(b0, b1 + 1):
                row = (row_a + (b + m1 if b < 0 else b - m1 if b >= m1 else b)) * m2
                for c in range(c0, c1 + 1):
                    cell = row + (c + m2 if c < 0 else c - m2 if c >= m2 else c)
                    j = grid.head[grid.first[kind] + (cell & grid.mask[kind])]
                    while j >= 0:
                        r2 = 0.0
                        for k in range(len(y)):
                            gap = nearest(y[k] - x[j, k], grid.length[k])
                            r2 += gap * gap
                        if r2 < ((r + radius[j]) * margin) ** 2 and j != me:
                            if j < first:
                                return TAKEN
                            before = radius[j] > r or (radius[j] == r and ids[j] < ids[me])
                            if before and status[j - first] == FREE:
                                return TAKEN
                            if before and status[j - first] == UNDECIDED:
                                result = UNDECIDED
                        j = grid.after[j]
    return result


@kernel
def decide(rows, x, radius, ids, first, status, margin, grid):
    """Decide which of `rows` (m,) overlap no sphere with an older place. Returns how many are undecided; `rows` begins with
    these.

    Rows below `first` were there before. Of those from `first` on the larger sphere has its place first, and of equal ones that
    with the lower id; their `status` is FREE, TAKEN, or UNDECIDED while it depends on another one that is. Two spheres overlap
    whose distance is below `margin` times the sum of their radii.
    """
    left = 0
    for i in rows:
        status[i - first] = verdict(x[i], radius[i], i, x, radius, ids, first, status, margin, grid)
        if status[i - first] == UNDECIDED:
            rows[left] = i
            left += 1
    return left


@kernel
def open_points(y, r, me, x, radius, ids, n, margin, grid):
    """At which of the points y (m, d) would a sphere with radius r (m,) overlap none of the n rows but its own, `me` (m,)?"""
    free, undecided = np.empty(len(y), np.bool_), np.empty(0, np.int8)
    for i in range(len(y)):
        free[i] = verdict(y[i], r[i], me[i], x, radius, ids, n, undecided, margin, grid) == FREE
    return free


@kernel
def first_come(first, last, particle, placed, x, radius, ids, margin, grid):
    """Enter the rows first ... last - 1 that overlap none, if their `particle` is not `placed` yet; returns which (bool)."""
    stays, undecided = np.zeros(last - first, np.bool_), np.empty(0, np.int8)
    for i in range(first, last):
        sphere = particle[i - first]
        if not placed[sphere] and verdict(x[i], radius[i], i, x, radius, ids, last, undecided, margin, grid) == FREE:
            enter_spheres(x, i, i + 1, grid)
            stays[i - first] = placed[sphere] = True
    return stays
