"""The neighbour lists of a rank's particles as one object; see `verlet_kernels` for the idea."""

import numpy as np

from particles_mpi.kernels import limits
from particles_mpi.kernels.geometry import Box, boxes_per_length
from particles_mpi.kernels.limits import require_countable
from particles_mpi.kernels.memory import aligned, doubled, enlarged, whole_lines
from particles_mpi.neighbours.cells import spacing, too_narrow
from particles_mpi.neighbours.verlet_cells import CELL, NO_CELL, make_grid
from particles_mpi.neighbours.verlet_kernels import (
    BEGIN,
    BLOCK_NUMBERS,
    COUNT,
    INVERSE_MASS,
    PLACES,
    ROOM,
    SIZE,
    SKIN,
    Lists,
    list_rows,
)
from particles_mpi.particles import Array

WANTED = {1: 3.0, 2: 7.0, 3: 12.0}  # neighbours in a list: fewer, and lists expire too often; more, and looks take longer
WANTED_BEYOND = 20.0  # in more dimensions
PLACES_IN_LISTS = "places in lists of neighbours"
LEAST_SKIN = 4096.0  # round-offs of the largest coordinate: what is left of a skin when a list expires is eight of them
FEW_ROWS, MOST_FLIGHTS = 1000, 1e4  # of so few rows, lists are made for flights of so many skins at most, however dense they are
SHORTER = 0.99  # times as long must lists get by a narrower skin
ACCEPTED = 1.3  # times more or fewer neighbours than wanted are accepted


class VerletLists:
    """The lists of all rows, in `arrays` for the kernels; `tune` or `build` makes them.

    `width`: of the skins, 0 before the first `tune`.
    """

    arrays: Lists

    def __init__(self, box: Box):
        self.box = box
        self.width = 0.0
        self.share = 1.0  # all rows of the box, divided by those that are here

    def tune(self, x: Array, radius: Array, w: Array, distance: float, way: float) -> None:
        """Make new lists for positions x (n, d), radii and inverse masses (n,), with skins whose width suits the density.

        `distance`: the longest contact distance over all ranks. `way`: the longest distance of a particle in a step, which is the
        only length that a single point has. Raises StateError if the box is too narrow for `distance`.
        """
        n, d = x.shape
        low, high = (x.min(axis=0), x.max(axis=0)) if n else (np.zeros(d), np.ones(d))
        everything = float((high - low).max()) + distance + way  # a skin so wide has all rows: it need not be wider
        widest = min(self.widest_skin(distance), everything or 1.0)
        wanted = WANTED.get(d, WANTED_BEYOND)
        if n <= wanted:  # all are in the list
            self.width = widest
            self.build(x, radius, w)
            return
        least = min(way / MOST_FLIGHTS, widest) if n <= FEW_ROWS else 0.0
        if not self.width:
            self.width = max(0.5 * spacing(low, high, n), 0.05 * float(radius.mean())) or way or 1.0  # any, at rest
        wider, longest = 0.0, np.inf  # the width before, if it was wider, and the mean length of lists with it
        for _ in range(6):
            self.width = max(min(self.width, widest), least)
            self.build(x, radius, w)
            mean = self.arrays.spans[:, COUNT].mean()
            if wanted / ACCEPTED < mean < wanted * ACCEPTED:
                break
            if self.width < wider and mean > SHORTER * longest:  # as near as these are, a narrow skin only expires more often
                self.width = wider
                self.build(x, radius, w)
                break
            diameter = 2.0 * float(radius.mean())
            longer = (max(mean, 0.2) / wanted) ** (-1.0 / d)
            width = 0.5 * ((diameter + 2.0 * self.width) * longer - diameter)
            width = min(max(width, 0.4 * self.width), 2.5 * self.width, widest)
            if abs(width - self.width) < 0.05 * self.width:
                break
            wider, longest, self.width = self.width, mean, width

    def widest_skin(self, distance: float) -> float:
        """The widest skin at which two rows in each other's list have one nearest image only; inf if no axis is periodic.

        `distance`: see `tune`. StateError if the box is too narrow for any skin.
        """
        periodic = self.box.length[self.box.length > 0.0]
        widest = float(periodic.min() - 2.0 * distance) / 8.0 if len(periodic) else np.inf
        if not widest > 0.0:
            raise too_narrow(self.box.length, distance)
        return widest

    def build(self, x: Array, radius: Array, w: Array, spare: int = 0) -> None:
        """Make new lists with skins of the present width, and room for `spare` rows more. Arguments as in `tune`."""
        n, d = x.shape
        rows = n + spare
        places = rows * (BLOCK_NUMBERS + BLOCK_NUMBERS // 8) + 64
        require_countable(places, PLACES_IN_LISTS)
        least = LEAST_SKIN * np.finfo(float).eps * float(np.abs(x).max(initial=0.0))
        self.skin = max(self.width, least)
        reference = aligned(rows, whole_lines(d + 5))
        skin = reference[:n, d + SKIN] = np.where(w > 0.0, self.skin, 0.0)
        size = reference[:n, d + SIZE] = radius + skin
        reference[:n, d + INVERSE_MASS] = w
        links = reference.view(np.int32)
        links[:, 2 * d + CELL] = NO_CELL
        level = np.zeros(rows, np.int8)
        grid, level[:n] = make_grid(x, size, self.box, self.share)
        pool = new_pool(places)
        spans = spans_in(pool, rows)
        set_empty(spans, 0)
        self.arrays = Lists(
            reference, links, level, spans, pool, np.array([rows * BLOCK_NUMBERS]), np.full(grid.first[-1], -1, np.int32),
            np.empty(rows + 2, np.int32), tuple(grid), tuple(self.box),
            boxes_per_length(self.box.length),
        )  # fmt: skip
        row = 0
        while row < n:
            row, short = list_rows((0,) * d, tuple(self.arrays), x, row)
            self.enlarge(short)

    def enlarge(self, short: int) -> None:
        """Replace the pool, which is too small by so many places, by one about twice as large."""
        if short > 0:
            pool = self.arrays.pool
            require_countable(len(pool) + short, PLACES_IN_LISTS)
            size = max(min(2 * len(pool), limits.INT32_MAX), len(pool) + short)
            pool = enlarged(pool, new_pool(size))
            self.arrays = self.arrays._replace(pool=pool, spans=spans_in(pool, len(self.arrays.spans)))

    def grow(self) -> None:
        """Make room for twice as many rows."""
        old = self.arrays
        rows, blocks = len(old.level), old.spans.size
        require_countable(len(old.pool) + blocks, PLACES_IN_LISTS)
        pool = new_pool(len(old.pool) + blocks)
        np.concatenate((old.pool[:blocks], np.empty(blocks, np.int32), old.pool[blocks:]), out=pool)
        spans = spans_in(pool, 2 * rows)
        spans[:rows, BEGIN] += blocks * (spans[:rows, BEGIN] >= blocks)  # longer lists stand behind all blocks
        set_empty(spans, rows)
        old.used[0] += blocks
        more = doubled(old, "reference", "level", "nearby")
        self.arrays = more._replace(links=more.reference.view(np.int32), spans=spans, pool=pool)
        self.arrays.links[rows:, 2 * len(self.box.length) + CELL] = NO_CELL


def new_pool(size: int) -> Array:
    """Room for so many int32, from the beginning of a line of the cache on."""
    return aligned((size + 1) // 2, 1).view(np.int32).ravel()[:size]


def spans_in(pool: Array, rows: int) -> Array:
    """The blocks of so many rows, at the beginning of the pool."""
    return pool[: rows * BLOCK_NUMBERS].reshape(rows, BLOCK_NUMBERS)


def set_empty(spans: Array, first: int) -> None:
    """Rows from `first` on have an empty list in their block."""
    spans[first:, BEGIN] = np.arange(first, len(spans)) * BLOCK_NUMBERS + PLACES
    spans[first:, COUNT], spans[first:, ROOM] = 0, BLOCK_NUMBERS - PLACES


def contact_distance(radius: Array, w: Array) -> tuple[float, float]:
    """The largest radius of all, and of those that move: together the longest contact distance. w (n,): inverse masses."""
    return float(radius.max(initial=0.0)), float(radius[w > 0.0].max(initial=0.0))
