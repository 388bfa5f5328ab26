"""Positions for `position = "random"` and `"lattice"`: random sequential addition and lattices. The same on every rank."""

from __future__ import annotations

from itertools import product
from math import exp, floor, inf, lgamma, log, pi, prod
from typing import NamedTuple

import numpy as np

from particles_mpi.kernels.geometry import nearest
from particles_mpi.kernels.jit import kernel, lean, lean_inner
from particles_mpi.particles import Array

LEVELS = 10  # classes of radius, each with radii half as large as in the one before, and with a grid of cells of its own
MOST_TRIES = 100_000  # failures in a row before a sphere is given up: at packing 0.30 in 3D about 1 try in 1000 succeeds
JAMMED = {1: 0.7476, 2: 0.547, 3: 0.384}  # packing at which random addition of equal spheres stops (literature)


class Container(NamedTuple):
    """The space in which particles are placed, and what they must keep clear of."""

    lower: Array  # (d,) corners of the box
    upper: Array
    length: Array  # (d,) of periodic axes; 0 for others
    point: Array  # (w, d) a point on each wall
    normal: Array  # (w, d) of each wall, into the space
    solid: bool  # spheres may not overlap one another
    bounded: bool  # spheres stay a radius away from faces of the box that are not periodic


class Grids(NamedTuple):
    """Linked cells: for each class of radius a grid over the box, and in each cell a linked list of the spheres in it."""

    level: Array  # (n,) class of each sphere
    head: Array  # (cells of all grids,) first sphere of each cell; -1: none
    next: Array  # (n,) the next sphere of the same cell; -1: none
    reach: Array  # (LEVELS,) largest radius of a class; -1: no sphere has this class
    cells: Array  # (LEVELS, 3) cells of a grid along each axis
    first: Array  # (LEVELS + 1,) where the cells of a grid begin in `head`
    lower: Array  # (d,) corner of the box
    extent: Array  # (d,) its lengths


def packing(radius: Array, room: Container) -> float:
    """The total volume of spheres with these radii (n,), divided by that of the box."""
    d = len(room.lower)
    volume = exp(0.5 * d * log(pi) - lgamma(0.5 * d + 1.0))
    return float((radius / np.exp(np.log(room.upper - room.lower).mean())) ** d @ np.ones(len(radius))) * volume


class RandomAddition:
    """Random sequential addition: spheres are put at random points, one after the other; where one overlaps, it is drawn again.

    Overlaps are found with linked cells, a grid for each class of radius, so that a few large spheres among many small ones
    cost no time. `x` (n, d), `radius` (n,): of all particles; `known`: the rows that have their positions already.
    """

    def __init__(self, room: Container, x: Array, radius: Array, known: Array):
        self.room, self.x, self.radius = room, x, radius
        largest = radius.max(initial=0.0)
        ratio = np.divide(largest, radius, out=np.full(len(radius), np.inf), where=radius > 0.0)
        level = np.clip(np.log2(ratio), 0, LEVELS - 1).astype(np.int64)
        members = [radius[level == k] for k in range(LEVELS)]
        reach = np.array([own.max(initial=-1.0) for own in members])
        cells = np.array([self.cells_of(len(own), 2.0 * far) for own, far in zip(members, reach)])
        first = np.concatenate([[0], np.cumsum(cells.prod(axis=1))])
        head, after = np.full(first[-1], -1, np.int64), np.full(len(x), -1, np.int64)
        self.grids = Grids(level, head, after, reach, cells, first, room.lower, room.upper - room.lower)
        if room.solid:
            insert(x, known, room.length, self.grids)

    def cells_of(self, count: int, side: float) -> Array:
        """Cells along three axes (3,): each at least `side` wide, and not many more than two for each of `count` spheres."""
        extent = (self.room.upper - self.room.lower)[:3]
        side = max(side, 1e-6 * float(extent.max()))
        while np.maximum(1.0, cells := np.floor(extent / side)).prod() > 2 * count + 64:
            side *= 1.2
        return np.append(np.maximum(1.0, cells), [1.0, 1.0])[:3].astype(np.int64)

    def place(self, rows: Array, random: np.random.Generator) -> tuple[int, int]:
        """Give `rows` (indices) their positions, large spheres first; returns (how many were placed, tries)."""
        tries, placed, failures = 0, 0, 0
        order = rows[np.argsort(-self.radius[rows], kind="stable")]
        budget = 5_000_000 + 200 * len(rows)
        while placed < len(rows) and failures < MOST_TRIES and tries < budget:
            u = random.random((min(max(len(rows) - placed, 1000), 100_000), self.x.shape[1]))
            placed, failures = add_spheres(self.x, self.radius, order, placed, failures, u, self.room, self.grids)
            tries += len(u)
        return placed, tries


@lean_inner
def cells_within(k, y, far, grid, cells, length):
    """First and last cell on axis k within `far` of the point y (d,); below 0 and from `cells` on are those beyond a period."""
    if k >= len(y) or cells == 1:
        return 0, 0
    low = int(np.floor((y[k] - far - grid.lower[k]) / grid.extent[k] * cells))
    high = int(np.floor((y[k] + far - grid.lower[k]) / grid.extent[k] * cells))
    if length[k] == 0.0:
        return min(max(low, 0), cells - 1), min(max(high, 0), cells - 1)
    return (0, cells - 1) if high - low >= cells else (low, high)


@lean
def insert(x, rows, length, grid):
    """Enter the spheres `rows` (indices), which have their positions in x (n, d), into the grids of their classes."""
    for i in rows:
        c, level = 0, grid.level[i]
        for k in range(3):
            cells = grid.cells[level, k]
            c = c * cells + cells_within(k, x[i], 0.0, grid, cells, length)[0] % cells
        c += grid.first[level]
        grid.next[i] = grid.head[c]
        grid.head[c] = i


@lean_inner
def overlaps(y, r, x, radius, length, grid):
    """Would a sphere of radius r at the point y (d,) overlap one that is in the grids?"""
    for level in range(len(grid.reach)):
        far = (r + grid.reach[level]) * (1.0 + 1e-9)
        if grid.reach[level] < 0.0 or far == 0.0:
            continue
        m0, m1, m2 = grid.cells[level, 0], grid.cells[level, 1], grid.cells[level, 2]
        a0, a1 = cells_within(np.int64(0), y, far, grid, m0, length)
        b0, b1 = cells_within(np.int64(1), y, far, grid, m1, length)
        c0, c1 = cells_within(np.int64(2), y, far, grid, m2, length)
        for a in range(a0, a1 + 1):
            row_a = (a + m0 if a < 0 else a - m0 if a >= m0 else a) * m1
            for b in range(b0, b1 + 1):
                row = (row_a + (b + m1 if b < 0 else b - m1 if b >= m1 else b)) * m2 + grid.first[level]
                for c in range(c0, c1 + 1):
                    j = grid.head[row + (c + m2 if c < 0 else c - m2 if c >= m2 else c)]
                    while j >= 0:
                        r2 = 0.0
                        for k in range(len(y)):
                            gap = nearest(y[k] - x[j, k], length[k])
                            r2 += gap * gap
                        if r2 < ((r + radius[j]) * (1.0 + 1e-12)) ** 2:
                            return True
                        j = grid.next[j]
    return False


@kernel
def add_spheres(x, radius, order, placed, failures, u, container, grid):
    """Try the points u (t, d) of the unit cube, one after the other, for the spheres `order` (indices) from order[placed] on.

    `failures`: tries in a row that failed before. Returns (spheres placed, failures in a row at the end).
    """
    _, _, length, point, normal, solid, bounded = container
    lower, extent = grid.lower, grid.extent
    d = x.shape[1]
    y = np.zeros(d)
    for t in range(len(u)):
        if placed == len(order) or failures >= MOST_TRIES:
            break
        i = order[placed]
        r = radius[i]
        free = True
        for k in range(d):
            margin = r if bounded and length[k] == 0.0 else 0.0
            y[k] = lower[k] + margin + u[t, k] * (extent[k] - 2.0 * margin)
        for w in range(len(point)):
            gap = 0.0
            for k in range(d):
                gap += (y[k] - point[w, k]) * normal[w, k]
            free = free and gap >= r * (1.0 - 1e-12)
        if free and solid:
            free = not overlaps(y, r, x, radius, length, grid)
        if not free:
            failures += 1
            continue
        for k in range(d):
            x[i, k] = y[k]
        if solid:
            insert(x, order[placed : placed + 1], length, grid)
        placed += 1
        failures = 0
    return placed, failures


def thinned(sites: int, count: int) -> Array:
    """`count` of the numbers 0 ... sites - 1, evenly spread."""
    return np.arange(count, dtype=np.int64) * sites // max(count, 1)


def lattice(count: int, radius: float, room: Container) -> Array | None:
    """The centres (count, d) of a lattice in the box: simple cubic if the spheres fit, else face-centred (hexagonal in 2D).

    None if they fit in neither.
    """
    if count == 0:
        return np.empty((0, len(room.lower)))
    cubic = simple_cubic(count, 2.0 * radius if room.solid else 0.0, room, radius if room.bounded else 0.0)
    return cubic if cubic is not None or len(room.lower) not in (2, 3) else face_centred(count, radius, room)


def simple_cubic(count: int, diameter: float, room: Container, margin: float) -> Array | None:
    """The centres of `count` of the equal cells of the box (count, d); None if a cell would be narrower than `diameter`."""
    extent = (room.upper - room.lower).tolist()
    closed = [length == 0.0 for length in room.length.tolist()]
    least = [max(diameter, 2.0 * margin if c else 0.0) for c in closed]
    most = [floor(e / s * (1.0 + 1e-12)) if s > 0.0 else inf for e, s in zip(extent, least)]
    if min(most) < 1:
        return None
    scale = exp((log(count) - sum(map(log, extent))) / len(extent))
    cells = [int(min(max(1, floor(e * scale)), m)) for e, m in zip(extent, most)]
    while prod(cells) < count:
        widths = [e / c if c < m else 0.0 for e, c, m in zip(extent, cells, most)]
        k = int(np.argmax(widths))
        if widths[k] == 0.0:
            return None
        cells[k] += 1
    x = np.empty((count, len(extent)))
    site = thinned(prod(cells), count)
    for k in reversed(range(len(extent))):
        x[:, k] = room.lower[k] + (site % cells[k] + 0.5) * (extent[k] / cells[k])
        site //= cells[k]
    return x


def face_centred(count: int, radius: float, room: Container) -> Array | None:
    """Every second point of a grid with q_k layers at spacing h_k on axis k: neighbours are sqrt(h_k^2 + h_m^2) or 2 h_k apart.

    Equal spacings give the fcc lattice in 3D; h_1 = sqrt(3) h_0 gives the hexagonal lattice in 2D. Of all numbers of layers near
    those of the ideal lattice, the ones with the largest distance between neighbours are taken. None if spheres do not fit.
    """
    extent, closed = room.upper - room.lower, room.length == 0.0
    free = np.where(closed, extent - 2.0 * radius, extent)
    if (free < -1e-12 * extent).any():
        return None
    free, d = np.maximum(free, 0.0), len(extent)
    ideal = extent / (prod(extent.tolist()) / (2.0 * count)) ** (1.0 / d)
    choices = []
    for q, shut in zip(ideal, closed, strict=True):
        near = np.unique(np.concatenate([np.arange(-20, 21) + round(q), np.linspace(0.5, 2.0, 30) * q]).astype(np.int64))
        choices.append([int(m) for m in near if m >= 1 and (shut or m % 2 == 0)])
    best: tuple[float, tuple[int, ...], Array] | None = None
    for head in product(*choices[:-1]):
        rest = max(1, -(-2 * count // prod(head)) - 1)
        while (prod(head) * rest + 1) // 2 < count or (not closed[-1] and rest % 2):
            rest += 1
        layers = (*head, rest)
        gaps = np.array([q - 1 if shut else q for q, shut in zip(layers, closed, strict=True)])
        h = np.divide(free, gaps, out=np.full(d, 1e100), where=gaps > 0)
        near = np.partition(h, 1)
        apart = min(float(np.hypot(near[0], near[1])), 2.0 * float(h[gaps > 1].min(initial=inf)))
        if best is None or apart > best[0] * (1.0 + 1e-12):
            best = apart, layers, h
    if best is None or best[0] < 2.0 * radius * (1.0 - 1e-12):
        return None
    _, layers, h = best
    site = np.indices(layers).reshape(d, -1).T
    site = site[site.sum(axis=1) % 2 == 0]
    site = site[thinned(len(site), count)]
    single = (np.array(layers) == 1) & closed
    start = room.lower + np.where(closed, radius, 0.25 * h)
    return np.where(single, 0.5 * (room.lower + room.upper), start + site * h)
