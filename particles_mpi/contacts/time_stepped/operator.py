"""The operator `rewind`: go back to the instant of contact, change the velocities, move forward again; several passes.

In a pass each candidate pair, and each particle near a wall, gets the time of its first contact on the present legs. A
contact takes place if it is, for both partners, the earliest under the total order (time, pair before wall, lower id,
higher id or wall). That rule looks only at the two partners' own contacts, so the owners of the partners come to the same
decision on any number of ranks: they publish which contact is first for their particles, and each changes its copy of both
partners by the same arithmetic. What is left after the last pass is counted as missed. Where forces press particles
together, which would then sink into one another and get hot, such a drift is done again by the operator `event`.

Legs are searched over the whole drift, not only for an overlap at its end: a pair that meets and separates within one step,
or is past its closest approach at the end, collides like any other, so one contact is exact at every step length.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from particles_mpi.contacts.time_stepped.passes import (
    choose,
    deepest,
    deepest_at,
    find_contacts,
    find_wall_hits,
    finish_walls,
    take_place,
)
from particles_mpi.contacts.velocity_flow import Rates
from particles_mpi.contacts.walls import Planes, no_planes
from particles_mpi.neighbours.neighbour_list import Neighbourhood
from particles_mpi.particles import Array
from particles_mpi.timers import Timers

if TYPE_CHECKING:
    from particles_mpi.contacts.event_driven.operator import Event

NONE = np.empty(0)
LATE = 1e-6  # of a radius: an overlap that is no round-off
DEEP = 0.5e-3  # of a radius: an overlap at the end of a drift, which nobody may keep
CROWDED = 3  # passes, after which that is no matter of two who soon move apart


class TooFarError(Exception):
    """A collision threw a particle further than the candidates reach; `travel` is the distance it needs."""

    def __init__(self, travel: float):
        self.travel = travel


class TooDenseError(Exception):
    """More contacts than the passes can put in order."""


class Rewind:
    """Drifts particles that collide with one another, and with walls if there are any."""

    def __init__(
        self,
        near: Neighbourhood,
        loss: tuple[float, float],
        passes: int,
        planes: Planes | None,
        timers: Timers,
        exact: Event | None,
    ):
        self.near, self.passes, self.timers, self.exact = near, passes, timers, exact
        self.restitution, self.keep = loss
        self.dense_steps = 0
        self.walls = planes is not None
        self.planes = planes or no_planes(len(near.axes))

    def drift(self, h: float, moment: float, rates: Rates) -> Array:
        """x += v h with every contact on the way; returns the (collisions, wall hits, missed) of this rank. Collective.

        `moment`: when the drift begins, for `exact`, which takes over where that is given and contacts are left at the end;
        `rates`: how velocities change in the step.

        If a collision throws a particle further than the candidates reach, the drift is undone, candidates are sought with
        a longer reach, and it is done again: the result is that of a reach long enough from the start.
        """
        all_ = self.near
        all_.prepare(h)
        self.rates = rates.of(all_.fields)
        travel = 0.0
        while True:
            try:
                counts = self.contacts(all_, h)
                break
            except TooDenseError:
                assert self.exact
                self.undo(all_)
                all_.distrust()
                self.dense_steps += 1
                return self.exact.drift(h, moment, rates)
            except TooFarError as far:
                self.undo(all_)
                travel = max(far.travel, 1.2 * travel)
                all_.search(h, travel)
                self.rates = rates.of(all_.fields)
        with self.timers("drift"):
            all_.advance(h)
        return counts

    def remarks(self) -> list[str]:
        """What a user should be told at the end. Collective."""
        if not self.dense_steps:
            return []
        assert self.exact
        dense = f"{self.dense_steps} steps had more contacts than passes put in order: those were done in order of time"
        return [dense, *self.exact.remarks()]

    def contacts(self, all_: Neighbourhood, h: float) -> Array:
        """All passes; leaves each row at the start of its last leg. Returns (collisions, wall hits, missed) of this rank."""
        counts, needed = np.zeros(3, np.int64), 0.0
        self.virial = all_.particles.arrays.get("virial", NONE)
        self.virial_before = self.virial.copy()
        for left in range(self.passes, -1, -1):
            with self.timers("search"):
                hits = self.find(all_, h, left == self.passes)
            with self.timers("agree"):
                late = self.exact is not None and self.passes - left >= CROWDED and self.late(all_, hits)
                mine = np.array([len(hits[0]), needed, all_.concern_others(hits), late], float)
                waiting, needed, shared, late = all_.ranks.allreduce_max(mine)
            if needed:
                raise TooFarError(float(needed))
            if self.exact and (late or (waiting and not left)):
                raise TooDenseError
            if not waiting:
                if self.passes - left >= 2 and self.exact and self.overlapping(all_, h):
                    raise TooDenseError
                break
            if not left:
                a, b, _ = hits
                counts[2] = np.count_nonzero((b >= 0) & (a < all_.owned))
                if self.walls:
                    if all_.halo:
                        all_.distrust()  # walls that are blind to others turn rows which are ghosts elsewhere
                    all_.note(a[b < 0])
                    point, normal, restitution, keep, *_ = self.planes.arrays()
                    counts[1] += finish_walls(
                        all_.axes, all_.x, all_.v, all_.s, all_.met, all_.radius, all_.w, a, b, h, point, normal, restitution,
                        keep, self.rates,
                    )  # fmt: skip
                break
            needed = self.one_pass(all_, hits, h, counts, bool(shared))
        return counts

    def late(self, all_: Neighbourhood, hits: tuple[Array, Array, Array]) -> bool:
        """Do partners meet that already overlap? Passes go forward in time for each particle, but not for all together."""
        return float(deepest(all_.x, all_.v, all_.s, all_.radius, *hits, all_.length)) > LATE

    def overlapping(self, all_: Neighbourhood, h: float) -> bool:
        """Does a supported particle overlap with another in the end, because a pass was late? Collective.

        In a pile that would add up; others soon move apart.
        """
        near = all_.near
        pairs = near.first[: near.pairs], near.second[: near.pairs], all_.particles["supported"]
        most = deepest_at(all_.x, all_.v, all_.s, all_.radius, *pairs, h, all_.length)
        return float(all_.ranks.allreduce_max(most)[0]) > DEEP

    def find(self, all_: Neighbourhood, h: float, everything: bool) -> tuple[Array, Array, Array]:
        """The hits on the present legs: all of them, or those of rows that are live."""
        near = all_.near
        a, b, time = near.hits
        found = find_contacts(
            all_.axes, all_.x, all_.v, all_.s, all_.met, all_.ids, all_.radius,
            near.first[: near.pairs], near.second[: near.pairs], h, all_.length, everything, all_.live, a, b, time,
        )  # fmt: skip
        if self.walls:
            point, normal, _, _, lower, upper, oblique = self.planes.arrays()
            found = find_wall_hits(
                all_.axes, all_.x, all_.v, all_.s, all_.met, all_.radius, near.near_wall[: near.walls], h, everything, all_.live,
                point, normal, lower, upper, oblique, a, b, time, found,
            )  # fmt: skip
        return a[:found], b[:found], time[:found]

    def one_pass(self, all_: Neighbourhood, hits: tuple[Array, Array, Array], h: float, counts: Array, shared: bool) -> float:
        """Choose by the total order, tell the other ranks, let the chosen hits take place, find who is in the way now.

        `shared`: some rank has hits that concern another one, so that there is something to tell.
        Returns 0, or how far a row needs candidates to reach.
        """
        with self.timers("collide"):
            choose(all_.ids, all_.owned, *hits, all_.choice, all_.best)
        if shared:
            with self.timers("ghosts"):
                all_.tell_choices(hits)
        with self.timers("collide"):
            all_.forget_live()
            all_.touches, all_.logged = take_place(
                all_.axes, all_.x, all_.v, all_.s, all_.met, all_.w, all_.ids, all_.owned, *hits, all_.choice,
                self.restitution, self.keep, all_.length, self.planes.normal, self.planes.restitution, self.planes.keep,
                self.rates, all_.live, all_.touched, all_.log, all_.log_x, all_.log_v, all_.logged, counts, self.virial,
            )  # fmt: skip
        if shared:
            with self.timers("ghosts"):
                all_.tell_legs()
        with self.timers("pairs"):
            return all_.follow(h)

    def undo(self, all_: Neighbourhood) -> None:
        """Owned rows go back to where they were before their contacts in this drift."""
        rows = all_.log[: all_.logged]
        all_.x[rows] = all_.log_x[: all_.logged]
        all_.v[rows] = all_.log_v[: all_.logged]
        self.virial[:] = self.virial_before
        all_.forget_legs()
