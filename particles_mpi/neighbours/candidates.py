"""The candidates of one search: pairs, and particles near walls, that can touch until a horizon. See `trajectories`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from particles_mpi.kernels.jit import plain
from particles_mpi.kernels.motion import Segments
from particles_mpi.neighbours.halo_region import HaloRegion, everywhere, renew_paths
from particles_mpi.neighbours.pair_search import AT_ONCE, drop_pairs, find_partners
from particles_mpi.neighbours.search_index import build_index, move_rows
from particles_mpi.neighbours.trajectories import (
    AT_REST,
    Horizon,
    Paths,
    Spheres,
    find_near_walls,
    rows_leaving,
    rows_turned,
    start_paths,
)
from particles_mpi.particles import Array

EXPECTED = 6  # contacts of a sphere in a heap, twice what are needed to rest
ALONE = 4  # times as long takes a test for a row that asks alone: its surroundings are not in the cache


class Hits(NamedTuple):
    """Contacts on the present segments: rows `first` and `second` (m,) int32 at `time` (m,); a wall is second = -1 - wall."""

    first: Array
    second: Array
    time: Array


class Candidates:
    """Pairs of rows that can touch, the rows near walls, and room for the `hits` of both.

    x, v (n, d) may change in place: `leaving` finds rows that forces bend away from their paths, `turned` those that contacts
    turned, and `follow` gives them new ones. `expected` pairs have room from the start.
    """

    def __init__(
        self,
        x: Array,
        v: Array,
        spheres: Spheres,
        length: Array,
        planes: tuple[Array, Array],
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
        radius, horizon = self.spheres.radius, self.horizon
        path, first_midpoint, bounding_radius = start_paths(self.x, self.v, radius, horizon)
        midpoint, periodic = first_midpoint.copy(), self.length[self.length > 0.0]
        widest = 2.0 * float(radius.max(initial=0.0)) + 4.0 * horizon.bound
        all_in_cells = bool((0.5 * periodic < widest).any())  # OVERSIZE rows only know the nearest image of a partner
        level, index = build_index(midpoint, bounding_radius, self.spheres.owned, all_in_cells)
        self.paths, self.index = Paths(path, midpoint, bounding_radius, level, first_midpoint), plain(index)
        self.path_arrays = tuple(self.paths)
        self.ask(np.arange(len(self.x), dtype=np.int32), everything=True)

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
        if len(self.planes[0]):
            self.wall_count = find_near_walls(
                rows, self.paths.path, tuple(self.horizon), self.spheres.owned, *self.planes, marked,
                self.wall_rows, self.wall_count,
            )  # fmt: skip
        marked[rows] = False

    def leaving(self, h: float) -> Array:
        """Rows that a drift over h from now takes away from their paths."""
        tolerance = self.horizon.tolerance
        return np.asarray(rows_leaving(self.axes, self.x, self.v, self.paths.path, self.time, h, tolerance, self.length))

    def turned(self, rows: Array, start: Array) -> Array:
        """Those of `rows` whose segments, begun at `start` (n,), leave their paths before the horizon; reorders `rows`."""
        horizon = tuple(self.horizon)
        return np.asarray(rows_turned(self.x, self.v, start, self.paths.path, rows, self.time, horizon, self.length))

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
    none = np.empty((0, d))
    spheres = Spheres(radius, w, ids, n)
    return Candidates(x, np.zeros_like(x), spheres, length, (none, none), AT_REST, everywhere(d), EXPECTED * n).pairs
