"""The candidates of one search: pairs, and particles near walls, that can touch until a horizon. See `trajectories`."""

from typing import Any, NamedTuple

import numpy as np

from particles_mpi.kernels.jit import plain
from particles_mpi.kernels.limits import require_countable
from particles_mpi.kernels.memory import aligned, whole_lines
from particles_mpi.kernels.motion import Segments
from particles_mpi.kernels.planes import no_planes
from particles_mpi.neighbours.cells import CELLS_TO_A_SIDE, GRIDDED, LinkedCells, grid, sort_rows, spacing
from particles_mpi.neighbours.halo_region import HaloRegion, everywhere
from particles_mpi.neighbours.near_paths import WAITING
from particles_mpi.neighbours.pair_search import ALL, replace_candidates
from particles_mpi.neighbours.search_index import SLOW, Holding, SearchIndex, SortedCells, fill_cells, levels
from particles_mpi.neighbours.trajectories import AT_REST, Horizon, Paths, Spheres, rows_leaving, start_paths
from particles_mpi.particles import Array

SLOWEST = 2.2  # times the mean bounding radius: rows beyond it are FAST, one in a hundred of a gas
OVERSIZE_FACTOR = 8.0  # times the mean bounding radius: rows beyond it are OVERSIZE, if they are few
FEW_OVERSIZE = 64
SPARE_PAIRS = 256  # added to the room for pairs, where there are few
EXPECTED = 6  # contacts of a sphere in a heap, twice what are needed to rest
ALONE = 4  # times as long takes a test for a row that searches alone: its surroundings are not in the cache


class Hits(NamedTuple):
    """Contacts on the present segments: rows `first` and `second` (m,) int32 at `time` (m,); a wall is second = -1 - wall."""

    first: Array
    second: Array
    time: Array


class Pairs(NamedTuple):
    """Candidate pairs, or room for them: rows, and the times from when until when they are near enough to touch."""

    first: Array  # (m,) int32
    second: Array  # (m,) int32
    begin: Array  # (m,) float32, since the search
    end: Array  # (m,) float32


def room_for(capacity: int) -> Pairs:
    """Return arrays with room for so many pairs."""
    return Pairs(*np.empty((2, capacity), np.int32), *np.empty((2, capacity), np.float32))


class Candidates:
    """`pairs` are the candidate pairs, `near_wall` the rows near walls, `hits` room for contacts of both.

    x, v (n, d) may change in place. `leaving` finds rows that forces bend away from their paths; `follow` gives new paths to
    these and to rows that contacts turned. There is room for `expected` pairs from the start.
    """

    def __init__(
        self, x: Array, v: Array, spheres: Spheres, length: Array, planes: tuple[Any, ...], horizon: Horizon, region: HaloRegion,
        expected: int,
    ):  # fmt: skip
        self.x, self.v, self.spheres = x, v, spheres
        self.length, self.planes, self.horizon, self.region = length, planes, horizon, tuple(region)
        self.axes = (0,) * x.shape[1]
        self.time = 0.0  # since the search
        n = len(x)
        self.marked, self.chosen = np.zeros(n, np.bool_), np.empty(n, np.int32)  # scratch
        self.pair_count = self.wall_count = self.tests = self.seekers = 0
        self.room = room_for(0)
        self.reserve(expected + expected // 4 + SPARE_PAIRS)
        self.wall_rows = np.empty(spheres.owned, np.int32)
        self.search()

    @property
    def pairs(self) -> Pairs:
        return Pairs(*(column[: self.pair_count] for column in self.room))

    @property
    def near_wall(self) -> Array:
        return self.wall_rows[: self.wall_count]

    def reserve(self, capacity: int) -> None:
        """Make room for so many pairs."""
        room = room_for(capacity)
        for column, old in zip(room, self.pairs, strict=True):
            column[: self.pair_count] = old
        self.room = room
        size = capacity + self.spheres.owned
        self.hits = Hits(np.empty(size, np.int32), np.empty(size, np.int32), np.empty(size))

    def search(self) -> None:
        """Find all candidates, with new cells."""
        n, radius = len(self.x), self.spheres.radius
        path = aligned(n, whole_lines(2 * len(self.axes) + 2))
        midpoint, bounding_radius, mean, box, own_box = start_paths(
            self.axes, self.x, self.v, radius, self.horizon, self.spheres.owned, path
        )
        limit = OVERSIZE_FACTOR * mean
        largest, periodic = float(radius.max(initial=0.0)), self.length[self.length > 0.0]
        if len(periodic) and 2.0 * largest + 4.0 * self.horizon.bound > 0.5 * periodic.min():
            limit = np.inf  # no row is OVERSIZE: those only know the nearest image of a partner
        level, oversize, count, reaches, slow_box = levels(midpoint, bounding_radius, SLOWEST * mean, limit, FEW_OVERSIZE)
        self.paths = Paths(path, midpoint, bounding_radius, level, midpoint[: n if len(periodic) else 0].copy())
        low, high = box
        apart = spacing(low, high, n)
        fine = grid(midpoint, (low, high), max(1.8 * apart, 1.2 * mean), CELLS_TO_A_SIDE)
        order, start = sort_rows(midpoint, level, SLOW, fine)
        coarse = grid(midpoint, (low, high), max(2.0 * apart, 2.0 * mean), 1)
        farthest = np.abs(slow_box[:, :GRIDDED] - fine.origin[-min(len(low), GRIDDED) :]).max()
        scale = 1.0 / max(float(farthest), 1e-300) if len(order) else 1.0
        place, entry, head, after, before, cell_of = fill_cells(self.paths, order, fine.origin, scale, coarse)
        cells = SortedCells(order, start, place, entry, scale, fine), LinkedCells(head, after, before, cell_of, coarse)
        index = SearchIndex(*cells, oversize, np.array([count]), reaches, limit, low, high, *own_box)
        self.holding = tuple(
            Holding(
                tuple(self.paths), plain(index), tuple(self.spheres), self.planes, self.region, self.length,
                self.marked, np.empty(n + WAITING, np.int32), self.wall_rows,
            )
        )  # fmt: skip
        self.follow(np.arange(n, dtype=np.int32), ALL, Segments(self.x, self.v, np.empty(0), np.empty(0, np.int64)), 0.0)

    def leaving(self, h: float) -> Array:
        """Return the rows that a drift over h from now takes away from their paths."""
        found = rows_leaving(
            self.axes, self.x, self.v, self.paths.path, self.time, h, self.horizon.tolerance, self.length, self.chosen
        )
        return self.chosen[:found]

    def follow(self, rows: Array, why: int, segments: Segments, h: float) -> float:
        """Make new paths and candidates for `rows` that are LEAVING their paths or were TURNED, on their segments in the drift
        over h.

        Of rows that were turned only those that leave their paths get new ones. Returns 0, or, if bound or region forbid it, how
        far a row gets in this drift: then nothing was replaced, and everything must be searched again. See `replace_candidates`.
        """
        done, needed, count = -1, 0.0, 0
        while len(rows):
            needed, until, self.pair_count, self.wall_count, tests, count, done = replace_candidates(
                self.axes, rows, done, why, tuple(segments), (self.time, h), tuple(self.horizon), self.holding,
                tuple(self.room), self.pair_count, self.wall_count,
            )  # fmt: skip
            self.tests += tests if why == ALL else ALONE * tests
            if until != self.horizon.valid_until:
                self.horizon = self.horizon._replace(valid_until=until)
            if needed or done == count:
                break
            rows = rows[:count]
            self.reserve(len(self.room.first) + len(self.room.first) // 2 + SPARE_PAIRS)
        require_countable(self.pair_count, "candidate pairs")
        if why != ALL and not needed:
            self.seekers += count
        return float(needed)


def touching(x: Array, radius: Array, w: Array, ids: Array, length: Array) -> tuple[Array, Array]:
    """(first, second): rows of all pairs of resting spheres that touch, each once, the lower id first, not both with w = 0."""
    n, d = x.shape
    spheres = Spheres(radius, w, ids, n)
    found = Candidates(x, np.zeros_like(x), spheres, length, tuple(no_planes(d)), AT_REST, everywhere(d), EXPECTED * n)
    first, second = found.pairs[:2]
    if ((length > 0.0) & (length < 4.0 * radius.max(initial=0.0))).any():  # a pair may have been found through two images
        one, other = np.divmod(np.unique(first.astype(np.int64) * n + second), n)
        return one.astype(np.int32), other.astype(np.int32)
    return first, second
