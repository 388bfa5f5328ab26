"""The candidates of one search: pairs, and particles near walls, that can touch until a horizon. See `trajectories`."""

from typing import Any, NamedTuple

import numpy as np

from particles_mpi.kernels.jit import plain
from particles_mpi.kernels.motion import Segments
from particles_mpi.neighbours.cells import FINE, LinkedCells, grid, sort_rows, spacing
from particles_mpi.neighbours.halo_region import HaloRegion, everywhere
from particles_mpi.neighbours.pair_search import AT_ONCE, drop_pairs, find_partners
from particles_mpi.neighbours.search_index import SLOW, SearchIndex, SortedCells, fill_cells, levels, move_rows
from particles_mpi.neighbours.trajectories import (
    AT_REST,
    Horizon,
    Paths,
    Spheres,
    find_near_walls,
    renew_paths,
    rows_leaving,
    rows_turned,
    start_paths,
)
from particles_mpi.particles import Array

SLOWEST = 2.2  # times the mean bounding radius: rows beyond it are FAST, one in a hundred of a gas
LARGEST = 8.0  # times the mean bounding radius: rows beyond it are OVERSIZE, if they are few
FEW = 64
EXPECTED = 6  # contacts of a sphere in a heap, twice what are needed to rest
ALONE = 4  # times as long takes a test for a row that asks alone: its surroundings are not in the cache


class Hits(NamedTuple):
    """Contacts on the present segments: rows `first` and `second` (m,) int32 at `time` (m,); a wall is second = -1 - wall."""

    first: Array
    second: Array
    time: Array


class Candidates:
    """`pairs` are the candidate pairs as rows (first, second), `near_wall` the rows near walls, `hits` room for contacts of both.

    x, v (n, d) may change in place: `leaving` finds rows that forces bend away from their paths, `turned` those that contacts
    turned, and `follow` gives them new ones. The first `expected` pairs have room from the start.
    """

    def __init__(
        self,
        x: Array,
        v: Array,
        spheres: Spheres,
        length: Array,
        planes: tuple[Any, ...] | None,
        horizon: Horizon,
        region: HaloRegion,
        expected: int,
    ):
        self.x, self.v, self.spheres = x, v, spheres
        self.length, self.planes, self.horizon, self.region = length, planes, horizon, tuple(region)
        self.axes = (0,) * x.shape[1]
        self.time = 0.0  # since the search
        n = len(x)
        self.marked, self.around = np.zeros(n, np.bool_), np.empty(n + AT_ONCE, np.int32)  # scratch of kernels
        self.chosen = np.empty(n, np.int32)
        self.pair_count = self.wall_count = self.tests = self.asked = 0
        self.first, self.second = np.empty(0, np.int32), np.empty(0, np.int32)
        self.reserve(expected + expected // 4 + 256)
        self.wall_rows = np.empty(spheres.owned, np.int32)
        self.search()

    @property
    def pairs(self) -> tuple[Array, Array]:
        return self.first[: self.pair_count], self.second[: self.pair_count]

    @property
    def near_wall(self) -> Array:
        return self.wall_rows[: self.wall_count]

    def reserve(self, capacity: int) -> None:
        """Room for pairs."""
        first, second = np.empty(capacity, np.int32), np.empty(capacity, np.int32)
        first[: self.pair_count], second[: self.pair_count] = self.pairs
        self.first, self.second = first, second
        size = capacity + self.spheres.owned
        self.hits = Hits(np.empty(size, np.int32), np.empty(size, np.int32), np.empty(size))

    def search(self) -> None:
        """All candidates, from cells made anew."""
        n, radius = len(self.x), self.spheres.radius
        path, midpoint, bounding_radius, mean, box, own_box = start_paths(
            self.axes, self.x, self.v, radius, self.horizon, self.spheres.owned
        )
        limit = LARGEST * mean
        largest, periodic = float(radius.max(initial=0.0)), self.length[self.length > 0.0]
        if len(periodic) and 2.0 * largest + 4.0 * self.horizon.bound > 0.5 * periodic.min():
            limit = np.inf  # no row is OVERSIZE: those only know the nearest image of a partner
        level, oversize, count, reaches = levels(bounding_radius, SLOWEST * mean, limit, FEW)
        self.paths = Paths(path, midpoint, bounding_radius, level, midpoint[: n if len(periodic) else 0].copy())
        low, high = box
        apart = spacing(low, high, n)
        fine = grid(midpoint, (low, high), max(0.9 * apart, 0.6 * mean), FINE)
        order, start = sort_rows(midpoint, level, SLOW, fine)
        coarse = grid(midpoint, (low, high), max(2.0 * apart, 2.0 * mean), 1)
        place, entry, head, after, before, cell_of = fill_cells(self.paths, order, coarse)
        cells = SortedCells(order, start, place, entry, fine), LinkedCells(head, after, before, cell_of, coarse)
        self.index = plain(SearchIndex(*cells, oversize, np.array([count]), reaches, limit, low, high, *own_box))
        self.path_arrays = tuple(self.paths)
        self.ask(np.arange(n, dtype=np.int32), everything=True)

    def ask(self, rows: Array, everything: bool) -> None:
        """Replace the candidates of `rows`."""
        marked = self.marked
        self.pair_count = drop_pairs(rows, marked, self.first, self.second, self.pair_count)
        while True:
            found, tests = find_partners(
                self.axes, rows, everything, self.path_arrays, tuple(self.horizon), self.length, self.index,
                tuple(self.spheres), (marked, self.around), self.first, self.second, self.pair_count,
            )  # fmt: skip
            if found <= len(self.first):
                break
            self.reserve(found + found // 4)
        self.pair_count = found
        self.tests += tests if everything else ALONE * tests
        if self.planes:
            self.wall_count = find_near_walls(
                rows, self.paths.path, tuple(self.horizon), self.spheres.owned, self.planes, marked,
                self.wall_rows, self.wall_count,
            )  # fmt: skip
        marked[rows] = False

    def leaving(self, h: float) -> Array:
        """Rows that a drift over h from now takes away from their paths."""
        found = rows_leaving(
            self.axes, self.x, self.v, self.paths.path, self.time, h, self.horizon.tolerance, self.length, self.chosen
        )
        return self.chosen[:found]

    def turned(self, rows: Array, start: Array) -> Array:
        """Those of `rows` whose segments, begun at `start` (n,), leave their paths before the horizon; reorders `rows`."""
        found = rows_turned(self.x, self.v, start, self.paths.path, rows, self.time, tuple(self.horizon), self.length)
        return rows[:found]

    def follow(self, rows: Array, segments: Segments, h: float) -> float:
        """New paths and candidates for `rows`, on their segments in the drift over h.

        Returns 0, or how far a row gets in this drift if bound or region forbid it: then all must be searched anew.
        """
        if not len(rows):
            return 0.0
        owned = self.spheres.owned
        needed, until = renew_paths(
            rows, tuple(segments), owned, self.path_arrays, self.region, tuple(self.horizon), self.length, self.time, h
        )
        if until != self.horizon.valid_until:
            self.horizon = self.horizon._replace(valid_until=until)
        if needed:
            return float(needed)
        move_rows(rows, self.path_arrays, owned, self.index)
        self.asked += len(rows)
        self.ask(rows, everything=False)
        return 0.0


def touching(x: Array, radius: Array, w: Array, ids: Array, length: Array) -> tuple[Array, Array]:
    """(first, second): rows of all pairs of resting spheres that touch, each once, the lower id first, not both with w = 0."""
    n, d = x.shape
    spheres = Spheres(radius, w, ids, n)
    return Candidates(x, np.zeros_like(x), spheres, length, None, AT_REST, everywhere(d), EXPECTED * n).pairs
