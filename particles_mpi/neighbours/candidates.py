"""The candidates of one search: pairs, and particles near walls, that can touch until a horizon. See `paths` for the idea."""

from __future__ import annotations

import numpy as np

from particles_mpi.neighbours.cells import GRIDDED, bounds, cell_order, grid
from particles_mpi.neighbours.paths import (
    drop_pairs,
    find_near_walls,
    find_partners,
    set_out,
    set_out_anew,
    strayed,
    turned,
    unmark,
)
from particles_mpi.particles import Array

GIANT = 4.0  # times the mean reach: beyond it a row, if it is one of few, does not set how far all others must look
FEW_GIANTS = 64
TURN = 1.6  # a row that turns back gets further from the middle of its first path: the reach beyond which it is a giant then
HEADROOM = 1.1  # how far a row may get from there, in paths of the fastest one, before the horizon comes nearer


class Candidates:
    """`first[:pairs]`, `second[:pairs]` are the candidate pairs as rows, `near_wall[:walls]` the rows near walls.

    x, v (n, d), radius, w = 1/m, ids (n,): the first `owned` rows are this rank's, ghosts follow. They may change in place; what
    happened to them is told by `follow_strays` and `follow`. `bound`: no row may get further than that from where the search saw it.
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
        expected: int,
    ):
        self.x, self.v, self.radius, self.w, self.ids = state
        self.owned, self.length, self.planes = owned, length, planes
        self.end, self.half, self.bound = end, half, bound
        self.axes = (0,) * self.x.shape[1]
        self.time = 0.0  # since the search
        n = len(self.x)
        self.marked, self.few = np.zeros(n, np.bool_), np.empty(n, np.int32)
        self.pairs = self.walls = self.tests = self.asked = 0
        self.reserve(expected + expected // 4 + 256)
        self.near_wall = np.empty(owned, np.int32)
        if owned:
            self.search()

    def reserve(self, capacity: int) -> None:
        """Room for pairs."""
        first, second = np.empty(capacity, np.int32), np.empty(capacity, np.int32)
        if self.pairs:
            first[: self.pairs], second[: self.pairs] = self.first[: self.pairs], self.second[: self.pairs]
        self.first, self.second = first, second
        size = capacity + self.owned
        self.hits = np.empty(size, np.int32), np.empty(size, np.int32), np.empty(size)

    def search(self) -> None:
        """All candidates, from the cells."""
        n, g = len(self.x), min(self.x.shape[1], GRIDDED)
        self.path, self.seen, self.reach = set_out(self.axes, self.x, self.v, self.radius, self.end, self.half)
        self.lowest, self.highest = bounds(self.seen)
        extent = np.maximum(self.highest - self.lowest, 1e-300)[:g]
        spacing = float(np.exp(np.log(extent).mean()) / n ** (1.0 / g))
        mean = float(self.reach.mean())
        self.cells = grid(self.seen, max(0.9 * spacing, 0.6 * mean))
        self.order, self.start = cell_order(self.seen, *self.cells)
        self.place = np.empty(n, np.int32)
        self.place[self.order] = np.arange(n, dtype=np.int32)
        self.entry = np.column_stack((self.seen[self.order, :g], self.reach[self.order]))
        self.cap, self.giants, self.known = np.inf, np.empty(n, np.int32), 0
        self.ask(np.arange(n, dtype=np.int32), -1.0)
        largest, periodic = float(self.radius.max()), self.length[self.length > 0.0]
        if len(periodic) and 2.0 * largest + 4.0 * self.bound > 0.5 * periodic.min():
            self.cap = largest + self.bound  # nobody reaches further: giants only know the nearest image of a partner
            return
        ordinary = self.reach[self.reach <= GIANT * mean]
        if n - len(ordinary) > FEW_GIANTS:
            ordinary = self.reach
        self.cap = TURN * float(ordinary.max())
        giants = np.flatnonzero(self.reach > self.cap)
        self.known = len(giants)
        self.giants[: self.known] = giants

    def ask(self, rows: Array, widest: float) -> None:
        """Replace the candidates of `rows`: each looks for partners that reach up to `widest` (< 0: only up to its own)."""
        self.pairs = drop_pairs(rows, self.marked, self.first, self.second, self.pairs)
        while True:
            found, tests = find_partners(
                self.axes, rows, self.marked, self.path, self.reach, self.end, self.half, widest, self.cap,
                self.giants[: self.known], self.order, self.place, self.entry, self.start, *self.cells, self.lowest, self.highest, self.length,
                self.owned, self.ids, self.w, self.first, self.second, self.pairs,
            )  # fmt: skip
            if found <= len(self.first):
                break
            self.reserve(found + found // 4)
        self.pairs = found
        self.tests += tests
        point, normal = self.planes
        if len(point):
            self.walls = find_near_walls(
                self.axes, rows, self.path, self.end, self.half, self.owned, point, normal, self.marked, self.near_wall, self.walls
            )
        unmark(rows, self.marked)

    def strays(self, h: float) -> Array:
        """Rows that a drift over h from now takes out of their tubes."""
        found = strayed(self.axes, self.x, self.v, self.path, self.time, h, self.half, self.length, self.few)
        return self.few[:found]

    def turned(self, rows: Array, s: Array) -> Array:
        """Those of `rows` whose legs, begun at s, leave their tubes before the horizon; reorders `rows`."""
        return rows[: turned(self.axes, self.x, self.v, s, self.path, rows, self.time, self.end, self.half, self.length)]

    def follow(self, rows: Array, s: Array, h: float) -> float:
        """New paths and candidates for `rows`, on legs that began at s in the drift over h.

        Returns 0, or how far a row gets in this drift if the bound forbids it: then all must be searched anew.
        """
        needed, self.end, self.known = set_out_anew(
            self.axes, rows, self.x, self.v, s, self.seen, self.path, self.reach, self.length, self.time, h, self.end,
            self.half, self.bound, self.cap, self.giants, self.known,
        )  # fmt: skip
        self.asked += len(rows)
        if not needed and len(rows):
            self.ask(rows, self.cap)
        return float(needed)


def touching(x: Array, radius: Array, w: Array, ids: Array, length: Array) -> tuple[Array, Array]:
    """(first, second): rows of all pairs of resting spheres that touch, each once, the lower id first, not both with w = 0."""
    none = np.empty((0, x.shape[1]))
    c = Candidates((x, np.zeros_like(x), radius, w, ids), len(x), length, (none, none), 0.0, 0.0, 0.0, 0)
    return c.first[: c.pairs], c.second[: c.pairs]
