"""The operator `event`: hard spheres and walls in exact order of time, the reference for `rewind`.

The next event of every particle is known. The first event of all takes place, and only the particles that it concerns look for
new ones: O(1) work for a contact, whatever N is. On several ranks space is divided, and ranks compute their parts in verified
windows of time (`windows`); if particles are too few for that, every rank computes everything (`Whole`). The bits are the same.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import numpy as np

from particles_mpi.contacts.closing_kick import LastContacts
from particles_mpi.contacts.event_driven.engine import NEVER_CROWDED, Engine
from particles_mpi.contacts.event_driven.event_loop import HIGHER, LOWER, TC_ELASTIC
from particles_mpi.contacts.event_driven.jams import Collapse
from particles_mpi.contacts.event_driven.whole import CHANGING, Whole
from particles_mpi.contacts.event_driven.windows import Windows
from particles_mpi.contacts.notes import NAMED, ContactNotes
from particles_mpi.contacts.velocity_flow import Rates
from particles_mpi.kernels.markers import CROWD
from particles_mpi.parallel.exchange import allgather_rows
from particles_mpi.particles import Array, Particles, rows_of, rows_with
from particles_mpi.scene.active import ActiveEffects
from particles_mpi.scene.effect import Context, PairContacts

LEAST_DIVIDED = 2000  # particles a rank; with fewer, space is not divided
LONGEST_PAUSE = 64  # drifts
# Quick contacts in a drift, after which a particle is one of a crowd that collapses: in the first attempt TAKING/(1 - e), for so
# many take a given part of the energy, and a rack of balls with e = 0.95 is none, within LEAST_QUICK and MOST_FIRST_QUICK, or
# FEW_EFFORT over the number of particles if that is more, up to FEW_FIRST_QUICK: so a row of nine that is hit, or five
# balls that fall onto a floor one on another, come apart as they do hit by hit. Then in each further attempt. What an attempt
# leaves is little as a rule, and dies away; else those that hit the crowd from outside have to be among it.
TAKING, LEAST_QUICK, MOST_FIRST_QUICK, FEW_FIRST_QUICK = 4.0, 8.0, 160.0, 60.0
QUICK_CONTACTS = (1000, 8, 4, 2, 1, NEVER_CROWDED)
DURATION = 1e-4  # of a step: the `contact_duration` of a scene that gives none,
FOLLOWING_EFFORT = 10_000  # particles times contacts that have to follow one another so soon until further ones take no energy,
FOLLOWERS, AT_ONE_MOMENT = (3, 4000), (50, 900)  # at least and at most; and those at one moment
PRESSED_FOLLOWERS, FEW_EFFORT = 8, 1000  # the same under forces: the least, and particles times contacts
MOST_QUICK = 3000  # quick contacts of a particle in the last attempt: then it has no room
MOST_RATTLING = 30_000  # the same where something presses spheres together that keeps no contacts: drag, friction, a flow


class ElasticContacts(NamedTuple):
    """Contacts of this rank that took no energy."""

    number: int
    moment: float  # when the first step with some began
    first: Array  # (m, 3) those of that step: time, id, id or -1 - wall


class EventDriven:
    """Drifts particles that collide with one another, and with walls if there are any."""

    migrated = ghost_rows = 0
    pair_tests = 0  # candidate pairs are tested in mode rewind only
    window_counts = 0, 0  # windows of time so far, and how many were undone

    def __init__(
        self, particles: Particles, context: Context, effects: ActiveEffects, pairs: PairContacts,
        hold: Callable[[float, int], None] | None,
    ):  # fmt: skip
        """`hold(h, tried)`: keeps the contacts of a crowd (`PersistentContacts.keep_crowds`) after so many attempts at the drift
        of a step of h; None if contacts cannot last. `noting`: does `last` keep the last contacts of each drift?
        """
        self.ranks, self.particles, self.box, self.timers = context.ranks, particles, context.box, context.timers
        self.given_duration = duration = pairs.options.contact_duration
        ranks, loss, planes, forces = context.ranks, pairs.loss, effects.planes, bool(effects.forces)
        self.rules = self.box, loss, effects.surfaces, planes
        total = ranks.total(len(particles))[0]
        self.divided = ranks.size > 1 and total >= LEAST_DIVIDED * ranks.size
        # What forces press together has such contacts in each step, without end
        before, at_once = (min(max(FOLLOWING_EFFORT // max(total, 1), least), most) for least, most in (FOLLOWERS, AT_ONE_MOMENT))
        left = loss.restitution * loss.velocity_factor  # of the speed along the normal, after a contact
        stops = forces and len(planes.point) > 0 and left < 1.0
        if forces:
            before = max(FEW_EFFORT // max(total, 1), PRESSED_FOLLOWERS)
        first = TAKING / max(1.0 - left, TAKING / MOST_FIRST_QUICK)
        first = max(first, LEAST_QUICK, min(FEW_EFFORT / max(total, 1), FEW_FIRST_QUICK))
        self.attempts = int(first), *QUICK_CONTACTS
        without_hold = MOST_RATTLING if effects.lossy and (forces or effects.on_velocities) else NEVER_CROWDED
        most = MOST_QUICK if hold else without_hold
        given = duration is not None  # then it holds for all contacts that take energy, else for what they take of the approach
        of_walls = effects.walls.taking if given and effects.walls else planes.lossy
        self.collapse = Collapse(
            0.0, 0 if given else before, at_once, stops, most, pairs.lossy if given else left < 1.0, of_walls
        )
        self.tc_elastic = ElasticContacts(0, np.inf, np.empty((0, 3)))
        self.crowded_steps = 0
        self.pause, self.next_pause = 0, 1  # drifts that every rank computes as a whole, after windows that did not pay
        self.stop, self.stopped = np.array([0, -1, -1]), np.zeros(1)
        self.hold = hold
        self.noting = effects.finishes_bounces
        self.last: LastContacts | None = None
        self.parts: list[Whole | Windows] = []  # what has been needed so far

    @cached_property
    def whole(self) -> Whole:
        self.parts.append(whole := Whole(self.particles, self.ranks, Engine(*self.rules), self.timers))
        return whole

    @cached_property
    def windows(self) -> Windows:
        self.parts.append(windows := Windows(self.particles, self.ranks, Engine(*self.rules), self.box, self.timers))
        return windows

    @property
    def searches(self) -> int:
        return sum(part.searches for part in self.parts)

    @property
    def reached(self) -> float:
        """The time that the last drift with `stop` took."""
        return float(self.stopped[0])

    @property
    def met(self) -> tuple[int, int] | None:
        """The ids of the two particles that ended that drift, the lower one first, or None."""
        lower, higher = int(self.stop[LOWER]), int(self.stop[HIGHER])
        return (lower, higher) if lower >= 0 else None

    def drift(self, h: float, moment: float, rates: Rates, stop: bool = False) -> Array:
        """Do x += v h with every contact on the way; returns the (collisions, wall hits, missed) of this rank. Collective.

        `moment`: the time at which the drift begins; `rates`: how velocities change in the step. With `stop` it ends at the first
        collision of two particles: their ids are `met`, and its time is `reached` (h if there is none).
        """
        given, self.rates = self.given_duration, rates
        self.collapse = self.collapse._replace(duration=DURATION * h if given is None else given)
        if self.hold is None or stop:
            return self.drift_once(h, moment, stop, NEVER_CROWDED)
        p = self.particles
        undone = ["id", *(name for name in CHANGING if name in p.arrays and name != "supported")]
        for tried, crowd_from in enumerate(self.attempts):
            before, tc_elastic_before = {name: p[name].copy() for name in undone}, self.tc_elastic
            happened = self.drift_once(h, moment, False, crowd_from)
            if crowd_from == NEVER_CROWDED or not self.ranks.any((p["supported"] == CROWD).any()):
                break
            self.undo(before)
            self.tc_elastic = tc_elastic_before
            self.hold(h, tried)
            self.crowded_steps += tried == 0
        return happened

    def undo(self, rows: dict[str, Array]) -> None:
        """Undo a drift: `rows` are copies, from before it, of all columns that it may change. Collective."""
        p = self.particles
        if self.ranks.any(not np.array_equal(p.id, rows["id"])):
            rows = allgather_rows(self.ranks, rows)
            rows = rows_of(rows, rows_with(rows["id"], p.id))
        for name, values in rows.items():
            p[name][:] = values

    def drift_once(self, h: float, moment: float, stop: bool, crowd_from: int) -> Array:
        """Try the drift once: a particle with `crowd_from` quick contacts in it has no further ones, and is marked as CROWD."""
        step = crowd_from, self.rates, self.collapse
        if self.divided and not stop and self.pause:
            self.pause -= 1
        elif self.divided and not stop:
            windows = self.windows
            windows.engine.set_step(*step)
            in_windows = windows.drift(h, moment)
            self.migrated, self.ghost_rows = windows.partition.migrated, windows.partition.ghost_rows
            self.window_counts = windows.count, windows.redone
            if in_windows is not None:
                self.next_pause = 1
                self.count_tc_elastic(moment, windows.engine)
                if self.noting:
                    self.last = windows.engine.last_contacts(windows.partition.own_rows, moment)
                return in_windows
            self.pause, self.next_pause = self.next_pause, min(2 * self.next_pause, LONGEST_PAUSE)
        engine = self.whole.engine
        engine.set_step(*step)
        happened = self.whole.drift(h, moment, stop)
        if self.noting:
            self.last = engine.last_contacts(self.whole.rows_of_rank(), moment)
        if self.divided:
            self.windows.engine.events = engine.events // self.ranks.size  # what a rank has to expect
        self.stop[:], self.stopped[:] = engine.work.stop, engine.work.stopped
        if self.ranks.is_root:  # all ranks saw the same
            self.count_tc_elastic(moment, engine)
        return happened * self.ranks.is_root

    def count_tc_elastic(self, moment: float, engine: Engine) -> None:
        """Count the contacts that took no energy, and keep the first ones."""
        count, before = int(engine.work.counts[TC_ELASTIC]), self.tc_elastic
        if count:
            kept = before if before.number else ElasticContacts(0, moment, engine.work.tc_elastic[:count].copy())
            self.tc_elastic = kept._replace(number=before.number + count)

    def pass_by(self, h: float, drifts: int) -> None:
        """Do nothing about drifts that were done elsewhere: the next drift notices by itself that rows have moved."""

    def notes(self) -> ContactNotes:
        """Return what may be wrong with the contacts so far. Collective."""
        found = [ElasticContacts(*of_rank) for of_rank in self.ranks.allgather(tuple(self.tc_elastic))]
        crowds, number = int(self.crowded_steps), sum(of_rank.number for of_rank in found)
        if not number:
            return ContactNotes(crowded_steps=crowds)
        moment = min(of_rank.moment for of_rank in found)
        first = sorted(list(map(float, row)) for of_rank in found if of_rank.moment == moment for row in of_rank.first)
        return ContactNotes(crowded_steps=crowds, lossless=number, moment=moment, first=first[:NAMED])
