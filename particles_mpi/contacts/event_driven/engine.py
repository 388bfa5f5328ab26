"""The rows, neighbour lists and event queue of a rank, and one drift of them, for which it calls the kernels of `event_loop`."""

import numpy as np

from particles_mpi.contacts.closing_kick import LastContacts
from particles_mpi.contacts.event_driven.calendar_queue import LIST_EXPIRY, NO_EVENT, NODE, PARTNER, Queue, sort_present
from particles_mpi.contacts.event_driven.event_loop import (
    COLLISIONS,
    EXPIRIES,
    FULL_BUCKET,
    LAST_PROGRESS,
    STANDSTILL,
    WALL_HITS,
    Work,
    run,
)
from particles_mpi.contacts.event_driven.jams import Collapse
from particles_mpi.contacts.event_driven.rows import (
    EVENT_COUNT,
    GHOST,
    ID,
    LAST_CONTACT,
    LAST_PARTNER,
    NOT_HERE,
    OWN,
    OWNERSHIP,
    VIRIAL,
    Rows,
    end_drift,
    new_log,
    start_drift,
    write_back,
)
from particles_mpi.contacts.law import Loss
from particles_mpi.contacts.notes import NAMED
from particles_mpi.contacts.velocity_flow import Rates, no_rates
from particles_mpi.errors import StateError
from particles_mpi.kernels.geometry import Box
from particles_mpi.kernels.markers import NO_PARTNER, RADIUS
from particles_mpi.kernels.memory import aligned, doubled, enlarged
from particles_mpi.kernels.planes import Planes
from particles_mpi.neighbours.verlet_kernels import INVERSE_MASS
from particles_mpi.neighbours.verlet_lists import VerletLists
from particles_mpi.parallel.signals import check_signals
from particles_mpi.particles import Array, Particles

EVENTS_PER_BUCKET = 0.5  # expected, in the queue: memory is prefetched for one in each
# A new reference position lies ahead of its row, on the way that it flies: by FLIGHT_AHEAD of a skin where flights are longer
# than skins, TURNING less where there are many collisions an expiry. Fitted to fewest expiries at packing 0.05 to 0.45.
FLIGHT_AHEAD, TURNING = 0.8, 0.35
MOST_EXPIRIES = 8  # of the list of a row, on average; then all rows are sorted in space and listed anew
NEVER_CROWDED = 2**31
NO_SPIN = np.empty((0, 1))


def times_of_contact(p: Particles) -> Array:
    """Return when each particle last had a contact (n,); -inf where a scene keeps no record, because nothing depends on it."""
    return p["contacted"] if "contacted" in p.arrays else np.full(len(p), -np.inf)


class Engine:
    """Computes contacts in order of time among the rows that `load` gave it: its own ones, and ghosts, which other ranks own.

    A drift is `start_drift`, `begin`, `run` once or more, `end_drift` and `write_back`. Its counts are in `work`.
    """

    rows: Rows
    queue: Queue

    def __init__(self, box: Box, loss: Loss, law: Array, planes: Planes):
        """`law`: see `contacts.rough.Rough`."""
        d = len(box.length)
        self.loss, self.law, self.planes = tuple(loss), law, tuple(planes)
        self.axes = (0,) * d
        self.lists = VerletLists(box)
        self.work = Work(
            np.empty(0, np.int32), np.zeros(4, np.int64), np.empty((NAMED, 3)), np.zeros(3, np.int64), np.zeros(1), np.zeros(2),
            np.zeros(1, np.bool_), *np.empty((5, d)),
        )  # fmt: skip
        self.events = 0  # in the last drift
        self.expiries = 0  # of lists since `load`
        self.ahead = 0.0
        self.pending = 0  # rows in work.stale
        self.set_step(NEVER_CROWDED, no_rates(d), Collapse(0.0, 0, 0, False, NEVER_CROWDED, False, planes.lossy))

    def set_step(self, crowd_from: int, rates: Rates, collapse: Collapse) -> None:
        """Set for a step: how many quick contacts make a crowd, `Rates`, and which contacts take no energy."""
        self.crowd_from, self.rates, self.collapse = crowd_from, rates, collapse

    def load(self, p: Particles, owned: int, spare: int = 0) -> None:
        """Take the rows of p, the first `owned` of which are own ones, and `spare` free rows, as `lists` were built for."""
        n, d = p.position.shape
        total = n + spare
        segment, state = aligned(total, 2 * d + 2), aligned(total, 8).view(np.int64)
        reals = state.view(np.float64)
        names = [name for name in ("total_acceleration", "drag") if name in p.arrays]
        fields = {name: enlarged(p[name], np.zeros((total, *p[name].shape[1:]))) for name in names}
        acceleration, drag = fields.get("total_acceleration", np.empty((0, d))), fields.get("drag", np.empty(0))
        spin = enlarged(p["spin"], np.zeros((total, p["spin"].shape[1]))) if "spin" in p.arrays else NO_SPIN
        inverse_inertia = enlarged(p.inverse_inertia, np.zeros(total * (len(spin) > 0)))
        self.rows = Rows(segment, segment.view(np.int64), state, reals, acceleration, drag, spin, inverse_inertia)
        segment[:n, :d], segment[:n, 2 * d + RADIUS] = p.position, p.radius
        state[:] = 0
        state[:n, ID], state[:n, OWNERSHIP] = p.id, GHOST
        state[:owned, OWNERSHIP] = OWN
        reals[:n, LAST_CONTACT] = times_of_contact(p)
        if "virial" in p.arrays:
            reals[:n, VIRIAL] = p.virial
        self.node = np.full((total, NODE), NO_EVENT, np.int32)
        self.work = self.work._replace(stale=np.empty(2 * total + 2, np.int32))
        self.log = new_log(total, d, spin.shape[1] if len(spin) else 0)
        self.expiries = 0

    def grow(self) -> Array:
        """Double the number of rows; returns the new rows, which are free."""
        n = len(self.rows.state)
        rows = doubled(self.rows, "segment", "state", "acceleration", "drag", "spin", "inverse_inertia")
        self.rows = rows._replace(segment_bits=rows.segment.view(np.int64), reals=rows.state.view(np.float64))
        log = doubled(self.log, "changed", "mark", "saved", "moved", "is_moved", "border")
        self.log = log._replace(saved_bits=log.saved.view(np.int64))
        self.node = np.concatenate((self.node, np.full_like(self.node, NO_EVENT)))
        self.queue = self.queue._replace(node=self.node, times=self.node.view(np.float64))
        self.work = doubled(self.work, "stale")
        self.lists.grow()
        return np.arange(n, 2 * n, dtype=np.int32)

    def start_drift(self, p: Particles, own_rows: Array) -> tuple[bool, float]:
        """Start own rows, particle r in row own_rows[r]; returns (were any moved since `end_drift`, largest speed)."""
        virial = p.arrays.get("virial", np.empty(0))
        a = p.arrays.get("total_acceleration", np.empty((0, 0)))
        moved, speed = start_drift(
            self.axes, tuple(self.rows), p.position, p.velocity, p.radius, times_of_contact(p), virial, a,
            p.arrays.get("spin", NO_SPIN), own_rows,
        )  # fmt: skip
        return bool(moved), float(speed)

    def begin(self, h: float) -> None:
        """Empty the queue for a drift over h, and mark all rows to find their next events."""
        here = np.flatnonzero(self.rows.state[:, OWNERSHIP] != NOT_HERE)
        self.pending = len(here)
        self.work.stale[: self.pending] = here
        self.work.counts[:], self.work.any_squeezed[0], self.work.stopped[0] = 0, False, h
        self.node[:, PARTNER] = NO_EVENT
        self.rows.state[:, EVENT_COUNT] = 0  # compared within a drift only, and there with 32 bits
        buckets = int(min(max(self.events / EVENTS_PER_BUCKET, len(here)), 8 * len(here))) + 64
        first = np.full(buckets, -1, np.int32)
        self.h = h
        self.queue = Queue(self.node, self.node.view(np.float64), first, buckets / h, np.zeros(2, np.int64))

    def run(self, now: float, until: float, moment: float) -> None:
        """Carry out all events from `now` to `until`, which are times since the start of the drift; that is at time `moment`."""
        queue, work = self.queue, self.work
        queue.present[:] = min(int(now * queue.per_time), len(queue.first) - 1), 0  # nothing is left from before
        a, drag = self.rows.acceleration, self.rows.drag
        rates = self.rates.of({"drag": drag, "total_acceleration": a} if len(a) else {"drag": drag})
        rules = self.loss, self.law, tuple(self.collapse), self.crowd_from, self.planes, rates
        interval = (self.h, moment), now, until, self.ahead
        rows, written, log = tuple(self.rows), tuple(work), tuple(self.log)
        work.progress[:] = now, 0.0
        pending, self.pending = self.pending, 0
        while short := run(self.axes, rows, tuple(self.lists.arrays), tuple(queue), rules, interval, written, log, pending):
            if short == STANDSTILL:
                raise StateError(self.standstill(moment + work.progress[LAST_PROGRESS]))
            if short > 0:
                self.lists.enlarge(short)
            else:
                check_signals()
            if short == FULL_BUCKET:
                sort_present(tuple(queue), self.rows.state)
            pending = 0

    def standstill(self, time: float) -> str:
        """Return the message about events that follow one another without end."""
        (row, partner), state = self.work.stale[:2], self.rows.state
        last = f"meets particle {state[partner, ID]}" if partner >= 0 else f"meets wall {-1 - partner}"
        last = "leaves its neighbourhood" if partner == LIST_EXPIRY else last
        return (
            f"time does not advance at t = {time:.9g}: events follow one another without end; in the last one particle"
            f" {state[row, ID]} {last}"
        )

    def end_drift(self) -> int:
        """Move all rows to the end of the drift. Returns how many own rows were squeezed."""
        lists = self.lists.arrays
        h, stops = float(self.work.stopped[0]), self.collapse.stops
        squeezed = end_drift(self.axes, tuple(self.rows), h, lists.reference, lists.box, stops)
        counts = self.work.counts
        self.expiries += int(counts[EXPIRIES])
        self.events = int(counts[COLLISIONS] + counts[WALL_HITS] + counts[EXPIRIES])
        self.ahead = FLIGHT_AHEAD / (1.0 + TURNING * counts[COLLISIONS] / max(counts[EXPIRIES], 1))
        return int(squeezed)

    def last_contacts(self, own_rows: Array, moment: float) -> LastContacts:
        """Return the last contacts of own rows in the drift that began at `moment`; particle r is in row own_rows[r]."""
        (segment, _, state, reals), d = self.rows[:4], len(self.axes)
        reference = self.lists.arrays.reference
        fixed = (reference[:, d + INVERSE_MASS] == 0.0) & (state[:, OWNERSHIP] != NOT_HERE)
        moved = np.flatnonzero((state[own_rows, LAST_PARTNER] != NO_PARTNER) & ~fixed[own_rows])
        rows = own_rows[moved]
        known = {"id": state[fixed, ID], "place": segment[fixed, :d], "radius": segment[fixed, 2 * d + RADIUS]}
        return LastContacts(moved, state[rows, LAST_PARTNER], reals[rows, LAST_CONTACT] - moment, known)

    def write_back(self, p: Particles, own_rows: Array) -> None:
        """Copy row own_rows[r] to particle r of p, for all r."""
        virial, supported = p.arrays.get("virial", np.empty(0)), p.arrays.get("supported", np.empty(0, np.uint8))
        fields = p.position, p.velocity, times_of_contact(p), virial, supported, p.arrays.get("spin", NO_SPIN)
        write_back(self.axes, tuple(self.rows), *fields, self.crowd_from, own_rows)
