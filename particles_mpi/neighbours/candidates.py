"""The candidates of one search: pairs, and particles near walls, that can touch until a horizon.

See `trajectories` for the idea.
"""

from __future__ import annotations

import numpy as np

from particles_mpi.neighbours.cells import FINE, grid, sort_rows, spacing
from particles_mpi.neighbours.halo_region import Fence, nowhere
from particles_mpi.neighbours.pair_search import AT_ONCE, SLOW, drop_pairs, fill_cells, find_partners, levels, move_rows, unmark
from particles_mpi.neighbours.trajectories import find_near_walls, set_out, set_out_anew, strayed, turned
from particles_mpi.particles import Array

SLOWEST = 2.2  # times the mean reach: rows beyond it are fast, one in a hundred of a gas
GIANTS = 8.0  # times the mean reach: beyond it are giants, if they are few
FEW = 64
EXPECTED = 6  # contacts of a sphere in a heap, twice what are needed to rest
ALONE = 4  # times as long takes a test for a row that asks alone: its surroundings are not in the cache


class Candidates:
    """`first[:pairs]`, `second[:pairs]` are the candidate pairs as rows, `near_wall[:walls]` the rows near walls.

    x, v (n, d), radius, w = 1/m, ids (n,): the first `owned` rows are this rank's, ghosts follow. They may change in place;
    `strays` finds those that forces bent out of their tubes, `turned` those that contacts turned, `follow` renews both.
    `bound`: no row may get further than that from the middle of its first path; nor an owned row out of its `fence`.
    """

    def __init__(
        self,
        state: tuple[Array, Array, Array, Array, Array],
        owned: int,
        length: Array,
        planes: tuple[Array, Array],
        end: float,
        half: float,
        bound: float,
        fence: Fence,
        expected: int,
    ):
        self.x, self.v, self.radius, self.w, self.ids = state
        self.owned, self.length, self.planes = owned, length, planes
        self.end, self.half, self.bound, self.fence = end, half, bound, fence
        self.axes = (0,) * self.x.shape[1]
        self.time = 0.0  # since the search
        n = len(self.x)
        self.marked, self.few = np.zeros(n, np.bool_), np.empty(n, np.int32)
        self.pairs = self.walls = self.tests = self.asked = 0
        self.first, self.second = np.empty(0, np.int32), np.empty(0, np.int32)
        self.reserve(expected + expected // 4 + 256)
        self.near_wall, self.around = np.empty(owned, np.int32), np.empty(n + AT_ONCE, np.int32)
        self.search()

    def reserve(self, capacity: int) -> None:
        """Room for pairs."""
        first, second = np.empty(capacity, np.int32), np.empty(capacity, np.int32)
        first[: self.pairs], second[: self.pairs] = self.first[: self.pairs], self.second[: self.pairs]
        self.first, self.second = first, second
        size = capacity + self.owned
        self.hits = np.empty(size, np.int32), np.empty(size, np.int32), np.empty(size)

    def search(self) -> None:
        """All candidates, from cells made anew."""
        n = len(self.x)
        self.path, self.home, self.reach, mean, (self.lowest, self.highest), (self.own_low, self.own_high) = set_out(
            self.axes, self.x, self.v, self.radius, self.end, self.half, self.owned
        )
        self.seen = self.home.copy()
        self.limit = GIANTS * mean
        largest, periodic = float(self.radius.max(initial=0.0)), self.length[self.length > 0.0]
        if len(periodic) and 2.0 * largest + 4.0 * self.bound > 0.5 * periodic.min():
            self.limit = np.inf  # no giants: they only know the nearest image of a partner
        self.level, self.giants, self.known, self.caps = levels(self.reach, SLOWEST * mean, self.limit, FEW)
        apart = spacing(self.lowest, self.highest, n)
        box = self.lowest, self.highest
        cells = grid(self.seen, box, max(0.9 * apart, 0.6 * mean), FINE)
        order, start = sort_rows(self.seen, self.level, SLOW, *cells)
        self.coarse = grid(self.seen, box, max(2.0 * apart, 2.0 * mean), 1)
        place, entry, *self.lists = fill_cells(self.seen, self.reach, self.level, order, *self.coarse)
        self.slow = order, place, start, entry, *cells
        self.fast = *self.lists[:2], *self.coarse
        self.ask(np.arange(n, dtype=np.int32), everything=True)

    def ask(self, rows: Array, everything: bool) -> None:
        """Replace the candidates of `rows`."""
        self.pairs = drop_pairs(rows, self.marked, self.first, self.second, self.pairs)
        while True:
            found, tests = find_partners(
                self.axes, rows, everything, self.marked, self.path, self.seen, self.reach, self.level, self.end, self.half,
                self.slow, self.fast, self.giants[: self.known], self.caps, self.lowest, self.highest, self.length,
                self.owned, self.own_low, self.own_high, self.ids, self.w, self.around, self.first, self.second, self.pairs,
            )  # fmt: skip
            if found <= len(self.first):
                break
            self.reserve(found + found // 4)
        self.pairs = found
        self.tests += tests if everything else ALONE * tests
        point, normal = self.planes
        if len(point):
            self.walls = find_near_walls(
                rows,
                self.path,
                self.end,
                self.half,
                self.owned,
                point,
                normal,
                self.marked,
                self.near_wall,
                self.walls,
            )
        unmark(rows, self.marked)

    def strays(self, h: float) -> Array:
        """Rows that a drift over h from now takes out of their tubes."""
        found = strayed(self.axes, self.x, self.v, self.path, self.time, h, self.half, self.length, self.few)
        return self.few[:found]

    def turned(self, rows: Array, s: Array) -> Array:
        """Those of `rows` whose legs, begun at s, leave their tubes before the horizon; reorders `rows`."""
        return rows[: turned(self.x, self.v, s, self.path, rows, self.time, self.end, self.half, self.length)]

    def follow(self, rows: Array, s: Array, h: float) -> float:
        """New paths and candidates for `rows`, on legs that began at s in the drift over h.

        Returns 0, or how far a row gets in this drift if bound or fence forbid it: then all must be searched anew.
        """
        if not len(rows):
            return 0.0
        needed, self.end = set_out_anew(
            rows, self.x, self.v, s, self.home, self.path, self.seen, self.reach, self.length,
            self.time, h, self.end, self.half, self.bound, self.owned, self.fence,
        )  # fmt: skip
        if needed:
            return float(needed)
        place, entry = self.slow[1], self.slow[3]
        head, after, before, cell_of = self.lists
        origin, per, cells = self.coarse
        self.known = move_rows(
            rows, self.seen, self.reach, self.level, place, entry, head, after, before, cell_of, origin, per, cells,
            self.caps, self.limit,
            self.giants, self.known, self.lowest, self.highest, self.owned, self.own_low, self.own_high,
        )  # fmt: skip
        self.asked += len(rows)
        self.ask(rows, everything=False)
        return 0.0


def touching(x: Array, radius: Array, w: Array, ids: Array, length: Array) -> tuple[Array, Array]:
    """(first, second): rows of all pairs of resting spheres that touch, each once, the lower id first, not both with w = 0."""
    n, none = len(x), np.empty((0, x.shape[1]))
    state, walls = (x, np.zeros_like(x), radius, w, ids), (none, none)
    c = Candidates(state, n, length, walls, 0.0, 0.0, 0.0, nowhere(x.shape[1]), EXPECTED * n)
    return c.first[: c.pairs], c.second[: c.pairs]
