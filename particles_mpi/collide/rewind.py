"""The operator `rewind`: go back to the instant of contact, change the velocities, move forward again; several passes.

In a pass each candidate pair, and each particle near a wall, gets the time of its first contact on the present legs. A
contact takes place if it is, for both partners, the earliest under the total order (time, pair before wall, lower id,
higher id or wall). That rule looks only at the two partners' own contacts, so the owners of the partners come to the same
decision on any number of ranks: they publish which contact is first for their particles, and each changes its copy of both
partners by the same arithmetic. What is left after the last pass is counted as missed.

Legs are searched over the whole drift, not only for an overlap at its end: a pair that meets and separates within one step,
or is past its closest approach at the end, collides like any other, so one contact is exact at every step length.
"""

from __future__ import annotations

import numpy as np

from particles_mpi.collide.contact import NOBODY
from particles_mpi.collide.passes import advance, choose, find_contacts, find_wall_hits, finish_walls, reach_of, take_place
from particles_mpi.collide.planes import Planes, no_planes
from particles_mpi.neighbours.pairs import Neighbourhood
from particles_mpi.particles import Array, Particles
from particles_mpi.timers import Timers


class TooFarError(Exception):
    """A collision threw a particle further than the candidate pairs reach; `travel` is the distance it needs."""

    def __init__(self, travel: float):
        self.travel = travel


class Rewind:
    """Drifts particles that collide with one another, and with walls if there are any."""

    def __init__(self, restitution: float, keep: float, passes: int, planes: Planes | None, dimension: int, timers: Timers):
        self.restitution, self.keep, self.passes, self.timers = restitution, keep, passes, timers
        self.walls = planes is not None
        self.planes = planes or no_planes(dimension)

    def drift(self, particles: Particles, near: Neighbourhood, h: float) -> Array:
        """x += v h with every contact on the way; returns the (collisions, wall hits, missed) of this rank. Collective.

        If a collision throws a particle further than the candidate pairs reach, the drift is undone, pairs are sought with
        a longer reach, and it is done again: the result is that of a reach long enough from the start.
        """
        near.prepare(particles, h)
        while True:
            try:
                counts = self.contacts(near, h)
                break
            except TooFarError as far:
                self.undo(near)
                near.search(particles, h, far.travel)
        with self.timers("drift"):
            advance(near.axes, near.x, near.v, near.s, near.owned, h)
        return counts

    def contacts(self, near: Neighbourhood, h: float) -> Array:
        """All passes; leaves each row at the start of its last leg. Returns (collisions, wall hits, missed) of this rank."""
        counts = np.zeros(3, np.int64)
        self.logged, travel = 0, 0.0
        near.s.fill(0.0)
        near.met.fill(NOBODY)
        for left in range(self.passes, -1, -1):
            with self.timers("search"):
                hits = self.find(near, h, left == self.passes)
            with self.timers("agree"):
                waiting, travel = near.ranks.largest(np.array([float(len(hits[0])), travel]))
            if travel > near.room:
                raise TooFarError(float(travel))
            if not waiting:
                break
            if not left:
                a, b, _ = hits
                counts[2] = np.count_nonzero((b >= 0) & (a < near.owned))
                if self.walls:
                    point, normal, restitution, keep, *_ = self.planes.arrays()
                    counts[1] += finish_walls(
                        near.axes, near.x, near.v, near.s, near.met, near.radius, a, b, h, point, normal, restitution, keep
                    )
                break
            travel = self.one_pass(near, hits, h, counts)
        return counts

    def find(self, near: Neighbourhood, h: float, everything: bool) -> tuple[Array, Array, Array]:
        """The hits on the present legs: all of them, or those of rows that are live."""
        a, b, time = near.hits
        found = find_contacts(
            near.axes, near.x, near.v, near.s, near.met, near.ids, near.radius, near.first, near.second, h, near.length,
            everything, near.live, a, b, time,
        )  # fmt: skip
        if self.walls:
            point, normal, _, _, lower, upper, oblique = self.planes.arrays()
            found = find_wall_hits(
                near.axes, near.x, near.v, near.s, near.met, near.radius, near.owned, h, everything, near.live,
                point, normal, lower, upper, oblique, a, b, time, found,
            )  # fmt: skip
        return a[:found], b[:found], time[:found]

    def one_pass(self, near: Neighbourhood, hits: tuple[Array, Array, Array], h: float, counts: Array) -> float:
        """Choose by the total order, tell the other ranks, let the chosen hits take place. Returns how far rows get now."""
        with self.timers("collide"):
            choose(near.ids, near.owned, *hits, near.choice, near.best)
        with self.timers("ghosts"):
            near.refresh(near.choice)
        with self.timers("collide"):
            near.live.fill(False)
            self.logged = take_place(
                near.axes, near.x, near.v, near.s, near.met, near.w, near.ids, near.owned, *hits, near.choice,
                self.restitution, self.keep, near.length, self.planes.normal, self.planes.restitution, self.planes.keep,
                near.live, near.log, near.log_x, near.log_v, self.logged, counts,
            )  # fmt: skip
            near.choice.fill(NOBODY)
            rows = near.log[: self.logged]
            travel = reach_of(near.axes, near.x, near.v, near.s, near.reference, rows, h, near.length)
        with self.timers("ghosts"):
            near.refresh_legs()
        return float(travel)

    def undo(self, near: Neighbourhood) -> None:
        """Put back every owned row that collided in this drift."""
        rows = near.log[: self.logged]
        near.x[rows] = near.log_x[: self.logged]
        near.v[rows] = near.log_v[: self.logged]
