"""The homes and lists of a rank's particles as one object; see `verlet_kernels` for the idea."""

from __future__ import annotations

import numpy as np

from particles_mpi.neighbours.cells import spacing
from particles_mpi.neighbours.verlet_kernels import BEGIN, COUNT, PLACES, ROOM, grids, settle_all
from particles_mpi.particles import Array

WANTED = {1: 3.0, 2: 7.0, 3: 12.0}  # neighbours in a list: fewer, and homes change too often; more, and looks take longer
MANY = 20.0  # in more dimensions
LOOSE = 1.3  # times more or fewer neighbours than wanted are borne


class Homes:
    """`home`, `links`, `lists`, `pool`, `head`, `grid`: homes and lists of all rows, as arrays for the kernels.

    box: (lower, upper, length) (d,), length 0 where not periodic. `settle` gives all rows homes where they are.
    """

    def __init__(self, box: tuple[Array, Array, Array]):
        self.lower, self.upper, self.length = box
        self.shell_width = 0.0
        self.share = 1.0  # all rows of the box, in those that are here

    def settle(self, x: Array, radius: Array, w: Array) -> None:
        """New homes and lists, with shells as wide as serves the density found (`shell_width`)."""
        n, d = x.shape
        movable = radius[w > 0.0].max(initial=0.0)
        largest = self.largest_shell(float(radius.max(initial=0.0) + movable))
        if not self.shell_width:
            low, high = (x.min(axis=0), x.max(axis=0)) if n else (np.zeros(d), np.ones(d))
            self.shell_width = max(0.5 * spacing(low, high, n), 0.05 * float(radius.mean()) if n else 0.0)
        wanted = WANTED.get(d, MANY)
        for _ in range(6):
            self.shell_width = min(self.shell_width, largest)
            self.build(x, radius, w)
            mean = self.lists[:, COUNT].mean() if n else wanted
            if wanted / LOOSE < mean < wanted * LOOSE or n < 3:
                break
            diameter = 2.0 * float(radius.mean())
            longer = (max(mean, 0.2) / wanted) ** (-1.0 / d)
            width = 0.5 * ((diameter + 2.0 * self.shell_width) * longer - diameter)
            width = min(max(width, 0.4 * self.shell_width), 2.5 * self.shell_width, largest)
            if abs(width - self.shell_width) < 0.05 * self.shell_width:
                break
            self.shell_width = width

    def largest_shell(self, diameter: float) -> float:
        """Two rows in each other's list must have one nearest image only, wherever in their shells they are."""
        periodic = self.length[self.length > 0.0]
        return float(periodic.min() - 2.0 * diameter) / 8.0 if len(periodic) else np.inf

    def build(self, x: Array, radius: Array, w: Array, spare: int = 0) -> None:
        """Homes at x, shells of the present width, cells and lists; and room for `spare` rows more."""
        n, d = x.shape
        rows = n + spare
        floor_ = 64.0 * np.finfo(float).eps * float(np.abs(x).max(initial=0.0))
        self.home = aligned(rows, 8 * ((d + 5 + 7) // 8))
        self.links = self.home.view(np.int32)
        self.shell = max(self.shell_width, floor_)
        shell = self.home[:n, d + 1] = np.where(w > 0.0, self.shell, 0.0)
        size = self.home[:n, d] = radius + shell
        self.home[:n, d + 2] = w
        self.level = np.zeros(rows, np.int8)
        self.grid, self.level[:n] = grids(x, size, (self.lower, self.upper), self.length, self.share)
        self.lists = np.zeros((rows, 4), np.int32)
        self.lists[:, BEGIN], self.lists[:, ROOM] = np.arange(rows) * PLACES, PLACES
        self.top = np.array([rows * PLACES])
        self.head = np.full(self.grid[3][-1], -1, np.int32)
        pool = np.empty(rows * (PLACES + PLACES // 2) + 64, np.int32)
        self.around = np.empty(rows + 2, np.int32)
        self.pool = settle_all(
            (0,) * d, x, self.home, self.links, self.level, pool, self.lists, self.top, self.head, self.grid, self.length,
            self.around,
        )  # fmt: skip

    def enlarge(self, short: int) -> None:
        """A pool with at least `short` places more."""
        self.pool = np.concatenate((self.pool, np.empty(short + len(self.pool), np.int32)))

    def grow(self) -> None:
        """Room for twice as many rows."""
        rows, width = self.home.shape
        self.home = enlarged(self.home, aligned(2 * rows, width))
        self.links = self.home.view(np.int32)
        self.level = enlarged(self.level, np.zeros(2 * rows, np.int8))
        self.lists = enlarged(self.lists, np.zeros((2 * rows, 4), np.int32))
        self.enlarge(rows * PLACES)
        self.lists[rows:, BEGIN], self.lists[rows:, ROOM] = self.top[0] + np.arange(rows) * PLACES, PLACES
        self.top += rows * PLACES
        self.around = np.empty(2 * rows + 2, np.int32)


def aligned(rows: int, width: int) -> Array:
    """Room for rows of numbers that begin where lines of the cache (64 bytes) do: eight to a row are read at once."""
    room = np.empty(rows * width + 8)
    first = -room.ctypes.data // 8 % 8
    return room[first : first + rows * width].reshape(rows, width)


def enlarged(old: Array, new: Array) -> Array:
    """The new array, with the rows of the old one in front."""
    new[: len(old)] = old
    return new
