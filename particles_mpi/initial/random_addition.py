"""Positions for `position = "random"`: random sequential addition, with the same result on any number of ranks.

Spheres are thrown at random points, one after the other; one that would overlap another is thrown again. All that have no place
yet are thrown at once. Of those that overlap one another the larger one stays, or that with the lower number: this gives the same
as one after the other in that order. Each rank decides on those in its part of space, and has copies of those near it.
"""

import numpy as np

from particles_mpi.initial.random_numbers import LOW_HALF, random_pair
from particles_mpi.initial.room import Room
from particles_mpi.initial.sphere_cells import CLASSES, class_of
from particles_mpi.initial.sphere_grid import FREE, SphereGrid
from particles_mpi.kernels.jit import kernel
from particles_mpi.neighbours.halo_region import build
from particles_mpi.neighbours.rank_boxes import rows_near_box
from particles_mpi.neighbours.trajectories import AT_REST
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.decomposition import bisect, to_owners
from particles_mpi.parallel.exchange import allgather_rows, by_destination, holders, send_rows
from particles_mpi.parallel.halo import Halo
from particles_mpi.particles import Array, rows_of

MOST_TRIES = 100_000  # failures in a row before spheres are given up: at packing 0.30 in 3D about 1 try in 1000 succeeds
# Packing at which random addition of equal spheres stops: A. Renyi 1958; G. Zhang and S. Torquato, Phys. Rev. E 88, 053312 (2013)
JAMMING_PACKING = {1: 0.7476, 2: 0.547, 3: 0.384}
FEW_LEFT = 10_000  # spheres without a place that each rank throws all of, several times at once, in its part of space
POINTS_AT_ONCE = 100_000  # thrown at once then
SPHERES_AT_ONCE = 2**20  # spheres of all ranks that are thrown at once, which need several times the memory of their places
OVERLAP_FACTOR = 1.0 + 1e-12  # spheres as near as this to touching overlap
CUTTING_POINTS = 1000  # points of each rank that tell where space is cut


class RandomAddition:
    """Finds places for spheres in a room, beside those that are there. Collective throughout.

    `x` (n, d), `radius` (n,): the spheres of this rank that have a place; `radii`: of those of this rank that will get one.
    """

    def __init__(self, ranks: Communicator, room: Room, x: Array, radius: Array, radii: list[Array]):
        self.ranks, self.room, self.dimension = ranks, room, x.shape[1]
        every = np.concatenate([radius, *radii])
        self.largest = ranks.largest(every.max(initial=0.0))[0]
        kind = class_of(every, self.largest)
        counts = ranks.allreduce_sum(np.bincount(kind, minlength=CLASSES))
        largest_radii = ranks.allreduce_max(np.array([every[kind == k].max(initial=-1.0) for k in range(CLASSES)]))
        extent = room.upper - room.lower
        if ranks.size > 1:  # equal parts of the room, by any points that fill it
            some = np.random.Generator(np.random.Philox(key=ranks.rank)).random((CUTTING_POINTS, self.dimension))
            self.parts = bisect(ranks, room.lower + some * extent, 1.0)
            corners = np.clip([self.parts.lower, self.parts.upper], room.lower, room.upper)
            self.boxes = corners.transpose(1, 0, 2) + self.largest * np.array([[-1.0], [1.0]])
        self.grid = SphereGrid(room.lower, extent, room.length, counts * room.solid, largest_radii, ranks.size)
        if room.solid:
            self.append(self.to_their_parts({"id": np.full(len(x), -1), "radius": radius, "position": x}))

    def to_their_parts(self, rows: dict[str, Array]) -> dict[str, Array]:
        """Send rows to the ranks in whose parts of space they are."""
        return rows if self.ranks.size == 1 else to_owners(self.ranks, rows, self.parts)

    def append(self, rows: dict[str, Array]) -> tuple[int, int, Halo | None]:
        """Put rows of this rank's part, and copies of those of others that are near it, into the grid.

        Returns (first row, how many are of this rank, and the `Halo` that refreshes the copies; None on one rank).
        """
        mine = rows_of(rows, self.grid.order(rows["position"], rows["radius"]))
        x, radius = mine["position"], mine["radius"]
        first, own = self.grid.append(x, radius, mine["id"])
        if self.ranks.size == 1:
            return first, own - first, None
        _, near, counts = build(self.boxes, self.ranks.rank, (x, np.zeros_like(x), radius), AT_REST, self.room.length)
        ghosts, arriving = send_rows(self.ranks, mine, near, counts)
        self.grid.append(ghosts["position"], ghosts["radius"], ghosts["id"])
        return first, own - first, Halo(self.ranks, near, counts, arriving, own - first, 0)

    def place(self, key: int, number: Array, radius: Array) -> tuple[Array, int]:
        """(positions (n, d) of the spheres with these numbers, in a row, and radii (n,); how many on all ranks have none).

        `key`: of their random numbers. Large ones come first, by classes of radius; lower ranks have lower numbers.
        """
        self.key = np.array([key >> (32 * k) & int(LOW_HALF) for k in range(2)], np.uint64)
        self.found: list[dict[str, Array] | slice] = []  # numbers and places, or rows of the grid that have them
        kind, missing = class_of(radius, self.largest), 0
        for k in range(CLASSES):
            rows = np.flatnonzero(kind == k)
            total = self.ranks.total(len(rows))[0]
            missing += total if missing else self.place_class(number[rows], radius[rows], total)
        return self.to_their_numbers(number), missing

    def place_class(self, number: Array, radius: Array, total: int) -> int:
        """Find places for the spheres of one class, of which there are `total` on all ranks; returns how many have none."""
        rows, shared = {"id": number, "radius": radius}, False
        left, throws, at_once, in_vain, tries = total, 0, 1, 0, 0
        while left and in_vain < MOST_TRIES and tries < 50 * MOST_TRIES + 200 * total:
            if not shared and self.room.solid and left <= FEW_LEFT:
                rows = allgather_rows(self.ranks, rows)
                rows, shared = rows_of(rows, np.lexsort((rows["id"], -rows["radius"]))), True
            rows = self.throw_few(rows, throws, at_once) if shared else self.throw_all(rows, throws, left)
            now = len(rows["id"]) if shared else self.ranks.total(len(rows["id"]))[0]
            throws += at_once
            tries += left * at_once
            in_vain = in_vain + left * at_once if now == left else 0
            if shared:
                at_once = max(1, min(2 * at_once if 2 * now > left else at_once, POINTS_AT_ONCE // max(now, 1)))
            left = now
        self.tries = max(tries, MOST_TRIES)
        return left

    def to_their_numbers(self, number: Array) -> Array:
        """Send the places that were found to the ranks of their spheres: x (n, d) of those with these numbers; 0 if none."""
        columns = {"id": np.empty(0, np.int64), "position": np.empty((0, self.dimension))}
        in_grid = {"id": self.grid.id, "position": self.grid.x}
        found = {
            name: np.concatenate([none, *(in_grid[name][of] if isinstance(of, slice) else of[name] for of in self.found)])
            for name, none in columns.items()
        }
        if self.ranks.size > 1:
            owner = holders(self.ranks, number, found["id"])
            found, _ = send_rows(self.ranks, found, *by_destination(owner, self.ranks.size))
        first, x = number[0] if len(number) else 0, np.zeros((len(number), self.dimension))
        x[found["id"] - first] = found["position"]
        return x

    def throw_all(self, rows: dict[str, Array], throw: int, left: int) -> dict[str, Array]:
        """Throw each of the `left` spheres of all ranks once, at most SPHERES_AT_ONCE together; returns those without a place."""
        parts = -(-left // SPHERES_AT_ONCE) if self.room.solid else 1
        if parts == 1:
            return self.throw_many(rows, throw)
        of = rows["id"] % parts
        again = [self.throw_many(rows_of(rows, np.flatnonzero(of == part)), throw) for part in range(parts)]
        return {name: np.concatenate([part[name] for part in again]) for name in rows}

    def throw_many(self, rows: dict[str, Array], throw: int) -> dict[str, Array]:
        """Throw each sphere once; returns those without a place, which may be of other ranks."""
        points, clear = points_of(self.key, rows["id"], np.array([throw]), rows["radius"], self.room)
        astray, rows = rows_of(rows, np.flatnonzero(~clear)), rows | {"position": points}
        if len(astray["id"]):
            rows = rows_of(rows, np.flatnonzero(clear))
        if not self.room.solid:
            self.found.append(rows)
            return astray
        first, own, halo = self.append(self.to_their_parts(rows))
        status, left = np.zeros(self.grid.n - first, np.int8), np.arange(first, first + own)
        while True:
            left = self.grid.decide(left, first, status, OVERLAP_FACTOR)
            if halo is None:
                break
            of_all = status.astype(float)
            halo.refresh(of_all)
            status[:] = of_all
            if not self.ranks.total(len(left))[0]:
                break
        free = status == FREE
        others = first + np.flatnonzero(~free[:own])
        again = {"id": self.grid.id[others], "radius": self.grid.radius[others]}
        self.grid.keep(first, free)
        self.found.append(slice(first, first + own - len(others)))
        return {name: np.concatenate([astray[name], again[name]]) for name in again}

    def throw_few(self, rows: dict[str, Array], throw: int, times: int) -> dict[str, Array]:
        """Throw each of `rows`, which all ranks hold, in order, so many times; returns those without a place, in order."""
        n = len(rows["id"])
        number, radius = np.tile(rows["id"], times), np.tile(rows["radius"], times)
        points, here = points_of(self.key, number, np.repeat(np.arange(throw, throw + times), n), radius, self.room)
        if self.ranks.size > 1:
            here &= self.parts.owner(points) == self.ranks.rank
        at = np.flatnonzero(here)
        at = at[self.grid.open_points(points[at], radius[at], OVERLAP_FACTOR)]
        tried = allgather_rows(self.ranks, {"id": at})["id"]
        tried.sort()
        first, stays = self.grid.first_come(points[tried], radius[tried], tried % n, n, OVERLAP_FACTOR)
        placed = tried[stays]
        mine = placed[here[placed]]
        self.found.append({"id": number[mine], "position": points[mine]})
        if self.ranks.size > 1:
            x, (low, high) = points[tried], self.boxes[self.ranks.rank]
            near = rows_near_box(x, np.zeros_like(x), radius[tried], AT_REST, low, high, self.room.length)
            stays &= np.isin(np.arange(len(x)), near)
        self.grid.keep(first, stays)
        return rows_of(rows, np.setdiff1d(np.arange(n), placed % n))


@kernel
def points_of(key, number, throw, radius, room):
    """Random points (n, d) of spheres with these numbers, in these throws (n,) or in one; which are clear of the walls (bool)."""
    lower, upper, length, point, normal, _, bounded = room
    n, d = len(number), len(lower)
    x, clear = np.empty((n, d)), np.ones(n, np.bool_)
    for i in range(n):
        low, high = np.uint64(number[i]) & LOW_HALF, np.uint64(number[i]) >> np.uint64(32)
        attempt = np.uint64(throw[i if len(throw) > 1 else 0])
        for k in range(0, d, 2):
            pair = random_pair(key[0], key[1], attempt, np.uint64(k), low, high)
            for m in range(k, min(k + 2, d)):
                margin = radius[i] if bounded and length[m] == 0.0 else 0.0
                x[i, m] = lower[m] + margin + pair[m - k] * (upper[m] - lower[m] - 2.0 * margin)
        for w in range(len(point)):
            gap = 0.0
            for k in range(d):
                gap += (x[i, k] - point[w, k]) * normal[w, k]
            clear[i] &= gap >= radius[i] * (1.0 - 1e-12)
    return x, clear
