"""The drift of a step: particles move for a time, with every contact on the way.

A scene loads the operator of its mode, and the search for neighbours, only if it has pairs that collide.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from particles_mpi.contacts.closing_kick import ClosingKick
from particles_mpi.contacts.notes import ContactNotes
from particles_mpi.contacts.velocity_flow import Rates
from particles_mpi.kernels.geometry import wrap
from particles_mpi.kernels.jit import plain
from particles_mpi.kernels.motion import free_drift
from particles_mpi.kernels.turning import turn
from particles_mpi.particles import Array, Particles, rows_with, to_read
from particles_mpi.scene.active import ActiveEffects
from particles_mpi.scene.calls import call_method, number_from
from particles_mpi.scene.effect import Context, Damping, Event, PairContacts, RollingResistance, WallContacts

if TYPE_CHECKING:
    from particles_mpi.contacts.event_driven.operator import EventDriven
    from particles_mpi.contacts.persistent.operator import PersistentContacts
    from particles_mpi.contacts.time_stepped.operator import Rewind
    from particles_mpi.neighbours.neighbour_list import Neighbourhood

HAPPENED = ("collisions", "wall_hits", "missed", "exchanges")  # in a drift
COUNTS = (*HAPPENED, "unconverged")
WORK = ("pair_tests", "pair_searches", "ghost_rows", "windows", "windows_redone")


class Drift:
    """Moves the rows of this rank.

    persistent: keeps contacts that last; near: the search for neighbours; operator: computes the contacts of pairs, one class for
    each mode; any of these may be None. accelerations: called for the present accelerations (n, d). totals: counts of what
    happened, by the names of COUNTS; calls: how often each effect was called.
    """

    def __init__(
        self, rows: Particles, context: Context, effects: ActiveEffects, persistent: PersistentContacts | None,
        accelerations: Callable[[], Array | None],
    ):  # fmt: skip
        self.rows, self.context, self.effects, self.persistent = rows, context, effects, persistent
        self.totals, self.calls = dict.fromkeys(COUNTS, 0), Counter[str]()
        if persistent:
            persistent.totals = self.totals
        self.events = effects.events
        self.wall_names = effects.names(WallContacts, RollingResistance)
        self.contact_names = effects.names(PairContacts, WallContacts, RollingResistance)
        self.damping, self.strength = effects.names(Damping), effects.friction.strength if effects.friction else 0.0
        self.total: Array | None = None  # accelerations that `rates` wrote last
        self.known = -1, -1  # version and edition of the particles then
        self.pushed: Array = np.empty(0, np.int64)  # rows to which lasting contacts added more
        self.past_work: dict[str, int] = {}  # of operators that are no longer there
        self.past_notes = ContactNotes()
        self.accelerations = accelerations
        self.near: Neighbourhood | EventDriven | None = None
        self.operator: Rewind | EventDriven | None = None
        if effects.pairs:
            self.load_operator(effects.pairs)
        self.closing = ClosingKick(rows, context, effects) if effects.finishes_bounces else None

    def load_operator(self, pairs: PairContacts) -> None:
        """Load the collision operator that the scene names, and its search for neighbours. Collective."""
        if pairs.options.mode == "event":
            self.near = self.operator = self.exact
            return
        from particles_mpi.contacts.time_stepped.operator import Rewind
        from particles_mpi.neighbours.neighbour_list import Neighbourhood

        context, effects = self.context, self.effects
        kicked = bool(effects.forces or effects.on_velocities or self.events)
        self.near = Neighbourhood(self.rows, context.ranks, context.box, plain(effects.planes), kicked, context.timers)
        self.operator = Rewind(self.near, effects, pairs, lambda: self.exact)

    @cached_property
    def exact(self) -> EventDriven:
        """The operator `event`, also in mode rewind: where `passes` are too few, or to end at a collision. Collective."""
        from particles_mpi.contacts.event_driven.operator import EventDriven

        assert self.effects.pairs
        hold = self.keep_crowds if self.persistent and self.persistent.pairs else None
        return EventDriven(self.rows, self.context, self.effects, self.effects.pairs, hold)

    def keep_crowds(self, h: float, tried: int) -> None:
        """See `PersistentContacts.keep_crowds`. Collective."""
        accelerations = self.accelerations()
        assert self.persistent and accelerations is not None  # without forces nothing lasts
        self.persistent.keep_crowds(self.rows, accelerations, h, tried)

    def advance(self, h: float, time: float, rates: Rates, contacts: bool = True, stop: bool = False) -> None:
        """Move the particles over h, from `time` on, while velocities change by `rates`. Collective.

        Without `contacts` particles pass through one another and through walls; with `stop` it ends at the first collision.
        """
        p, context = self.rows, self.context
        wrapped = False
        turns = "orientation" in p.arrays
        before = (p.id.copy(), p["spin"].copy()) if turns and stop else None
        if turns and not stop:  # by the spins before hits for half of the time, and by those after them: off by little
            turn(p["orientation"], p["spin"], 0.5 * h)
        last = None
        if contacts and self.operator and self.near:
            migrated = self.near.migrated
            found, last = self.operator.drift(h, time, rates, stop), self.operator.last
            if stop:
                h = self.exact.reached
            happened = [*found, self.near.migrated - migrated]
            self.calls.update(self.contact_names)
            wrapped = True  # ghosts too
        elif contacts and self.effects.walls:
            with context.timers("walls"):
                hits, missed, last = self.effects.walls.drift(p, h, rates.of(p.arrays), self.closing is not None)
            happened = [0, hits, missed, 0]
            self.calls.update(self.wall_names)
        else:
            with context.timers("drift"):
                free_drift(p.position, p.velocity, h)
            happened = [0, 0, 0, 0]
            p.version += self.effects.pairs is not None  # what is known of neighbours does not hold any longer
        if self.closing and last is not None:
            self.closing.note(last, h)
        if before:  # the first hit of two particles is at the end; rows may have been put in another order
            ids, spin = before
            turn(p["orientation"], spin[rows_with(ids, p.id)], h)
        elif turns:
            turn(p["orientation"], p["spin"], 0.5 * h)
        for name, number in zip(HAPPENED, happened, strict=True):
            self.totals[name] += int(number)
        if self.events:
            changed = self.act(self.events, h)
            wrapped = wrapped and not changed
            if self.closing and context.ranks.any(changed):
                self.closing.forget()  # places and velocities are not those of the contacts any longer
        if context.length.any() and not wrapped:
            with context.timers("drift"):
                wrap(p.position, context.lower, context.upper, context.length)

    def pass_by(self, h: float, drifts: int) -> None:
        """Take note of drifts over h that `ManySteps` has done, in which no particle that collides met anything."""
        assert self.operator
        self.calls.update(dict.fromkeys(self.contact_names, drifts))
        self.operator.pass_by(h, drifts)

    def act(self, events: dict[str, Event], h: float) -> bool:
        """Call the events at the end of the drift. Returns whether any row of this rank was changed."""
        changed, rows = 0, to_read(self.rows, ("id",))
        for name, event in events.items():
            with self.context.timers("events"):
                changed += number_from(name, call_method(name, event.act, rows, h))
            self.calls[name] += 1
        if changed:
            self.rows.hold_fixed()
            self.rows.version += 1  # nothing that was known of neighbours holds any longer
        return changed > 0

    def rates(self, g: Array, total: Array | None, middle: float) -> Rates:
        """Return the `Rates` at which velocities change between the contacts of this step.

        g (d,): the acceleration that all particles have in common; total (n, d): the sum of all forces, None without forces.
        Where it differs between particles it is stored in their field `total_acceleration`. middle: half of the step, as a time
        from its start.

        Velocity flows are left out. Their rate after a contact is not known, and with the rate before it a flow that does no
        work, such as a magnetic field, would change the energy.
        """
        p, none = self.rows, np.empty((0, self.rows.dimension))
        if "total_acceleration" in p.arrays:
            field, known = p["total_acceleration"], (p.version, p.edition)
            if total is not None and total is self.total and known == self.known:
                field[self.pushed] = total[self.pushed]  # the other rows have it since last time
            else:
                field[:] = 0.0 if total is None else total
            self.total, self.known, self.pushed = total, known, np.empty(0, np.int64)
            if "free_acceleration" in p.arrays:
                p["free_acceleration"][:] = field
        if self.persistent:  # contacts that last push too: what lies on something does not fall
            self.pushed, given = self.persistent.given
            field[self.pushed] += given.reshape(len(given), p.dimension) / middle
        kicked = self.effects.forces or self.damping or self.strength
        return Rates(g[None, :] if kicked else none, np.zeros(len(self.damping)), self.strength, middle)

    def continue_counts(self, before: Drift) -> None:
        """Continue the counts of the drift object that this one replaces. Collective."""
        self.totals, self.calls = before.totals, before.calls
        if self.persistent:
            self.persistent.totals = self.totals
        self.past_work, self.past_notes = before.work(), before.notes()

    def remarks(self) -> list[str]:
        """Return what happened that a user should know, one line for each remark. Collective."""
        counts = np.array([self.totals["missed"], self.totals["unconverged"]])
        missed, unsolved = self.context.ranks.allreduce_sum(counts).tolist()
        more = [f"lasting contacts: {unsolved} solutions ended above contact_tolerance"] if unsolved else []
        if missed:
            crowded = "a particle had no room, or had more contacts in a step than could be put in order"
            rewind = self.effects.pairs and self.effects.pairs.options.mode == "rewind"
            cure = "; shorter steps, more collisions.passes or mode event help" if rewind else ""
            more.append(f"missed: {missed} times {crowded}; diagnostics.csv shows when{cure}")
        return [*more, *self.notes().remarks()]

    def notes(self) -> ContactNotes:
        """Return what may be wrong with the contacts of the present operator, and of those before it. Collective."""
        return self.past_notes + self.operator.notes() if self.operator else self.past_notes

    def work(self) -> dict[str, int]:
        """Searches for neighbours, ghosts, tests of pairs and windows of time so far, of this rank."""
        near = self.near
        now = (near.pair_tests, near.searches, near.ghost_rows, *near.window_counts) if near else (0,) * len(WORK)
        return {name: number + self.past_work.get(name, 0) for name, number in zip(WORK, now, strict=True)}
