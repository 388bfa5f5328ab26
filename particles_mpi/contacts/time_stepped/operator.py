"""The operator `rewind`: go back to the instant of contact, change the velocities, move forward again; several passes.

In a pass each candidate pair, and each particle near a wall, gets the time of its first contact on the present segments, which
are searched over the whole drift. A contact takes place if it is, for both partners, the earliest under the total order (time,
pair before wall, lower id, higher id or wall). That looks only at the two partners' own contacts, so the owners of both come to
the same decision on any number of ranks, and each changes its copy of both by the same arithmetic. What is left after the last
pass is counted as missed; where forces press particles together, such a drift is done again by the operator `event`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from particles_mpi.contacts.closing_kick import LastContacts
from particles_mpi.contacts.notes import ContactNotes
from particles_mpi.contacts.rough import Rough
from particles_mpi.contacts.time_stepped.contact_search import brushed_pairs, find_contacts, find_wall_hits
from particles_mpi.contacts.time_stepped.passes import (
    COLLISIONS,
    LATE,
    MISSED,
    WALL_HITS,
    Selection,
    UndoLog,
    apply_contacts,
    finish_walls,
    select_contacts,
)
from particles_mpi.contacts.time_stepped.signs import Signs
from particles_mpi.contacts.velocity_flow import Rates
from particles_mpi.kernels.markers import NO_PARTNER
from particles_mpi.neighbours.candidates import Hits
from particles_mpi.neighbours.neighbour_list import Neighbourhood
from particles_mpi.neighbours.pass_messages import ACROSS, OWN_ONLY, exchange_segments, exchange_selections
from particles_mpi.particles import Array
from particles_mpi.scene.active import ActiveEffects
from particles_mpi.scene.effect import PairContacts

if TYPE_CHECKING:
    from particles_mpi.contacts.event_driven.operator import EventDriven

NONE = np.empty(0)
TOO_DENSE = -1.0  # what `all_passes` returns for more contacts than they can put in order
LOOK_AFTER = 3  # passes, after which partners that overlap are a sign of a crowd, and not of two that soon move apart


class Rewind:
    """Drifts particles that collide with one another, and with walls if there are any.

    `exact`: returns the operator `event`, for drifts up to a collision, and, if it `redoes` them, for those with more contacts
    than `passes` put in order; else these are only counted. `noting`: are the last contacts of each drift kept in `last`?
    """

    def __init__(self, near: Neighbourhood, effects: ActiveEffects, pairs: PairContacts, exact: Callable[[], EventDriven]):
        self.near, self.timers, self.exact = near, near.timers, exact
        self.passes, self.redoes = pairs.options.passes, effects.lossy
        self.loss, self.law, self.planes = tuple(pairs.loss), effects.surfaces, near.planes  # law: see `contacts.rough.Rough`
        self.walls = len(self.planes[0]) > 0
        self.signs = Signs(near)
        self.noting = effects.finishes_bounces
        self.last: LastContacts | None = None
        self.searches = -1  # the search of `near` that the arrays by row belong to

    def drift(self, h: float, moment: float, rates: Rates, stop: bool = False) -> Array:
        """Do x += v h with every contact on the way; returns the (collisions, wall hits, missed) of this rank. Collective.

        `moment`: when the drift begins; `rates`: how velocities change in the step. If a collision throws a particle further than
        the candidates reach, the drift is undone and repeated with candidates that reach further. With `stop` the operator
        `event` does it, up to the first collision of two particles.
        """
        if stop:
            return self.exactly(h, moment, rates, stop=True)
        near = self.near
        near.prepare(h)
        self.signs.look_at_speeds(h)
        travel = 0.0
        while True:
            self.renew(rates)
            counts, needed = self.all_passes(h)
            if not needed:
                break
            self.undo()
            if needed == TOO_DENSE:
                self.signs.dense_steps += 1
                return self.exactly(h, moment, rates)
            travel = max(needed, 1.2 * travel)
            near.search(h, travel)
        if self.noting:
            self.last = self.last_contacts()
        with self.timers("drift"):
            near.advance(h)
            self.forget_contacts()
        self.signs.count(counts[COLLISIONS], counts[LATE])
        return counts[:LATE]

    def pass_by(self, h: float, drifts: int) -> None:
        """Take note of drifts over h that were done elsewhere, because no particle met another one or a wall."""
        self.signs.look_at_speeds(h, drifts)
        self.near.pass_by(h, drifts)

    def exactly(self, h: float, moment: float, rates: Rates, stop: bool = False) -> Array:
        """Let the operator `event` do a drift; returns what it returns. Collective."""
        self.near.end_candidates()
        exact = self.exact()
        counts = exact.drift(h, moment, rates, stop)
        self.last = exact.last
        self.signs.count(counts[COLLISIONS])
        return counts

    def renew(self, rates: Rates) -> None:
        """Renew the arrays that depend on the rows of the last search, and on the step."""
        near = self.near
        n, d, owned = len(near.x), len(near.axes), near.spheres.owned
        if self.searches != near.searches:
            self.searches = near.searches
            self.selection = Selection(np.full(n, NO_PARTNER), np.empty((owned, 3)))
            spin = np.empty((owned * (len(near.spin) > 0), near.spin.shape[1]))
            vectors = np.empty((owned, d)), np.empty((owned, d)), spin
            self.log = UndoLog(np.empty(owned, np.int32), *vectors, np.zeros(1, np.int64))
            self.rough = tuple(Rough(near.spin, near.inverse_inertia, self.law, np.empty(d), np.empty(d)))
        self.rates = rates.of(near.fields)
        self.rules = self.loss, self.planes, self.rates, self.rough, near.length
        self.virial = near.particles.arrays.get("virial", NONE)
        self.virial_before = self.virial.copy()

    def notes(self) -> ContactNotes:
        """Return what may be wrong with the contacts so far. Collective."""
        return self.signs.notes(self.exact)

    def all_passes(self, h: float) -> tuple[Array, float]:
        """Make all passes; each row is left at the start of its last segment. Collective.

        Returns counts (4,) of this rank: collisions, wall hits, missed contacts, late collisions; and 0, or, where the drift must
        be undone, TOO_DENSE, or how far candidates must reach, because a collision threw a particle further than they do.
        """
        near, counts, needed = self.near, np.zeros(4, np.int64), 0.0
        for left in range(self.passes, -1, -1):
            with self.timers("search"):
                hits = self.find(h, left == self.passes)
            with self.timers("agree"):
                late = self.redoes and self.passes - left >= LOOK_AFTER and self.signs.late(hits)
                mine = np.array([len(hits.first), needed, near.concerned(hits), late], float)
                waiting, needed, concerned, late = near.ranks.allreduce_max(mine)
            if needed:
                break
            if self.redoes and (late or (waiting and not left)):
                return counts, TOO_DENSE
            if not waiting:
                if left < self.passes:
                    if self.redoes and self.signs.overlapping(h):
                        return counts, TOO_DENSE
                    first, second, _, _ = near.candidates.pairs
                    counts[LATE] += brushed_pairs(*near.rows, first, second, h, near.length)
                break
            if not left:
                needed = near.ranks.largest(self.finish(hits, h, counts, int(concerned)))[0]
                break
            needed = self.one_pass(hits, h, counts, int(concerned))
        return counts, float(needed)

    def find(self, h: float, everything: bool) -> Hits:
        """Return the hits on the present segments: of all rows, or of active rows only."""
        near, active = self.near, self.near.active.flag
        first, second, time = hits = tuple(near.candidates.hits)
        pairs, drift = tuple(near.candidates.pairs), (near.candidates.time, h)
        found = find_contacts(near.axes, *near.rows, pairs, drift, near.length, everything, active, hits)
        if self.walls:
            radius, rows = near.spheres.radius, near.candidates.near_wall
            found = find_wall_hits(near.axes, near.rows[0], radius, rows, h, everything, active, self.planes, hits, found)
        return Hits(first[:found], second[:found], time[:found])

    def one_pass(self, hits: Hits, h: float, counts: Array, concerned: int) -> float:
        """Select contacts by the total order, tell other ranks, apply the selected ones, and find new candidates.

        `concerned`: which rows the hits of any rank are about (`rows_concerned`), and so what ranks must exchange. Returns 0,
        or how far a row needs candidates to reach.
        """
        near, selected = self.near, self.selection.partner
        with self.timers("collide"):
            select_contacts(near.rows[1], tuple(hits), tuple(self.selection))
        if concerned == ACROSS:
            with self.timers("ghosts"):
                exchange_selections(near.halo, selected, hits.first, hits.second, near.candidates.marked)
        with self.timers("collide"):
            apply_contacts(
                near.axes, *near.rows, tuple(hits), selected, self.rules, tuple(near.active), tuple(self.log), counts,
                self.virial,
            )  # fmt: skip
        if concerned != OWN_ONLY:
            with self.timers("ghosts"):
                selected[near.spheres.owned :] = NO_PARTNER
                exchange_segments(near.halo, near.active, near.segments, near.spin)
        with self.timers("pairs"):
            return near.follow(h)

    def finish(self, hits: Hits, h: float, counts: Array, concerned: int) -> float:
        """Carry out wall contacts after the last pass, without contacts of pairs: particles may never leave through walls.

        The pairs that are left, and the particles that have no room between walls, are counted as missed. Returns 0, or how far a
        row needs candidates to reach.
        """
        near = self.near
        with self.timers("collide"):
            bounces, stuck = finish_walls(near.axes, *near.rows, tuple(hits), h, self.rules, tuple(near.active), tuple(self.log))
            counts[WALL_HITS] += bounces
        if concerned != OWN_ONLY:
            with self.timers("ghosts"):
                exchange_segments(near.halo, near.active, near.segments, near.spin)
        with self.timers("pairs"):
            needed = near.follow(h)
        with self.timers("search"):
            left = self.find(h, False)
        counts[MISSED] = stuck + np.count_nonzero((left.second >= 0) & (left.first < near.spheres.owned))
        return needed

    def last_contacts(self) -> LastContacts:
        """Return the last contacts of owned rows in this drift."""
        near, rows = self.near, self.log.rows[: self.log.number[0]].astype(np.int64)
        radius, w, ids, _ = near.spheres
        fixed = np.flatnonzero(w == 0.0)
        known = {"id": ids[fixed], "place": near.x[fixed], "radius": radius[fixed]}
        return LastContacts(rows, near.segments.last_partner[rows], near.segments.start[rows], known)

    def undo(self) -> None:
        """Set owned rows back to where they were before their contacts in this drift."""
        near, log = self.near, self.log
        count = log.number[0]
        rows = log.rows[:count]
        near.x[rows], near.v[rows] = log.x[:count], log.v[:count]
        if len(log.spin):
            near.spin[rows] = log.spin[:count]
        self.virial[:] = self.virial_before
        self.forget_contacts()

    def forget_contacts(self) -> None:
        """Set all segments to begin at time 0, without a last partner."""
        self.near.forget_segments(self.log.rows[: self.log.number[0]])
        self.log.number[0] = 0
