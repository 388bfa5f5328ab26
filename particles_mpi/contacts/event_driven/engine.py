"""Rows on straight legs, their homes, and the queue of their next events: what the kernels of `event_loop` work on."""

from __future__ import annotations

from math import prod

import numpy as np

from particles_mpi.contacts.event_driven.calendar_queue import LEAVING, NOTHING, SLOT
from particles_mpi.contacts.event_driven.event_loop import (
    AHEAD,
    BREATH,
    COLLISIONS,
    HOMES,
    STANDSTILL,
    WALL_HITS,
    arrive,
    hand_over,
    run,
    set_out,
)
from particles_mpi.contacts.event_driven.rollback import GHOST, ID, LAST, MINE, NOT_HERE, OWN, VIRIAL, Log
from particles_mpi.contacts.velocity_flow import Rates, no_rates
from particles_mpi.contacts.walls import Planes
from particles_mpi.errors import StateError
from particles_mpi.neighbours.verlet_lists import Homes, aligned, enlarged
from particles_mpi.parallel.signals import breathe
from particles_mpi.particles import Array, Particles

CONTACTS = 1.0  # expected in a bucket of the queue
SETTLED = 8  # new homes a row, on average; then all are sorted in space and settled again
NEVER_CROWDED = 2**31
DIFFERING = "total_acceleration", "drag"  # fields by which velocities change otherwise from row to row
NAMED = 64  # contacts without loss that are remembered by name


class Engine:
    """Computes contacts in order of time among the rows it was given by `settle`: own ones, and ghosts that others own.

    A drift is `set_out`, `begin`, `run` once or more, and `arrive`, `hand_over`. `counts` are those of own rows since `begin`,
    `stopped` and `stop` what `run` stopped for, `spared` the (time, id, id or wall) of the first contacts that took no energy.
    """

    def __init__(self, box: tuple[Array, Array, Array], loss: tuple[float, float], planes: Planes):
        self.lower, _, self.length = box
        self.restitution, self.keep = loss
        self.soft, self.planes = 0.0, planes  # duration of a contact, in this step
        self.axes = (0,) * len(self.length)
        self.homes = Homes(box)
        self.counts = np.zeros(4, np.int64)
        self.events = 0  # in the last drift
        self.ahead, self.moved = 0.0, 0
        self.stop, self.stopped = np.zeros(3, np.int64), np.zeros(1)
        self.spared = np.empty((NAMED, 3))
        self.pending = 0
        self.crowded = NEVER_CROWDED
        self.rates = no_rates(len(self.length))  # in this step, for whom they differ in `fields`

    def set_step(self, crowded: int, rates: Rates, soft: float) -> None:
        """For this step: quick contacts that make a crowd, how velocities change, and the duration of a contact."""
        self.crowded, self.rates, self.soft = crowded, rates, soft

    def settle(self, p: Particles, owned: int, spare: int = 0) -> None:
        """Rows of p, the first `owned` of them own ones; `homes` were built for them, with `spare` rows."""
        n, d = p.position.shape
        rows = n + spare
        self.leg = aligned(rows, 2 * d + 2)
        self.leg[:n, :d], self.leg[:n, 2 * d + 1] = p.position, p.radius
        self.state = aligned(rows, 8).view(np.int64)
        self.reals = self.state.view(np.float64)
        self.state[:] = 0
        self.state[:n, ID], self.state[:n, MINE] = p.id, GHOST
        self.state[:owned, MINE] = OWN
        self.reals[:n, LAST] = p.contacted
        if "virial" in p.arrays:
            self.reals[:n, VIRIAL] = p.virial
        self.slot = np.full((rows, SLOT), NOTHING, np.int32)
        self.todo = np.empty(2 * rows + 2, np.int32)
        self.log = Log(rows, d)
        self.fields = {name: enlarged(p[name], np.zeros((rows, *p[name].shape[1:]))) for name in DIFFERING if name in p.arrays}
        self.moved = 0

    def set_out(self, p: Particles, seat: Array) -> tuple[bool, float]:
        """Own rows on their way: (did anyone move them, largest speed)."""
        virial = p.arrays.get("virial", np.empty(0))
        a = p.arrays.get("total_acceleration", np.empty((0, 0)))
        moved, speed = set_out(
            self.axes, self.leg, self.state, self.reals, self.accelerations, p.position, p.velocity, p.radius, p.contacted,
            virial, a, seat,
        )  # fmt: skip
        return bool(moved), float(speed)

    @property
    def accelerations(self) -> Array:
        """Of the rows, or no row where they are the same for all."""
        return self.fields.get("total_acceleration", np.empty((0, len(self.axes))))

    @property
    def drags(self) -> Array:
        """Of the rows, or no row without drag."""
        return self.fields.get("drag", np.empty(0))

    @property
    def differing(self) -> int:
        """Numbers a row of what differs from row to row."""
        return sum(prod(field.shape[1:]) for field in self.fields.values())

    def begin(self, h: float) -> None:
        """An empty queue for a drift over h; all rows are to find their next events."""
        here = np.flatnonzero(self.state[:, MINE] != NOT_HERE)
        self.todo[: len(here)] = here
        self.pending = len(here)
        self.slot[:, 0] = NOTHING
        self.buckets = int(min(max(self.events / CONTACTS, len(here)), 4 * len(here))) + 64
        self.heads = np.full(self.buckets, -1, np.int32)
        self.h = h
        self.clock, self.far = np.zeros(1, np.int64), np.zeros(2, np.bool_)  # far: flights of many boxes, and squeezed rows
        self.counts[:] = 0
        self.stopped[0] = h
        d = len(self.axes)
        self.scribble = np.empty(d), np.empty(d)

    def run(self, now: float, until: float, moment: float) -> None:
        """All events from `now` to `until`."""
        homes, planes = self.homes, self.planes
        walls = planes.point, planes.normal, planes.lower, planes.upper, planes.oblique
        when = self.slot.view(np.float64)
        per_time = self.buckets / self.h
        self.clock[0] = min(int(now * per_time), self.buckets - 1)  # nothing is left from before
        queue = self.slot, when, self.heads, per_time, self.clock, self.far, *self.scribble
        log, rates = self.log.arrays(), self.rates.of(self.fields)
        pending, self.pending = self.pending, 0
        reached = np.array([now, 0.0])
        while True:
            short = run(
                self.axes, self.leg, self.leg.view(np.int64), self.state, self.reals, self.h, now, until, moment, self.length,
                homes.pool, homes.lists, homes.top, homes.home, homes.links, homes.level, homes.head, homes.grid,
                walls, planes.restitution, planes.velocity_factor, rates, self.restitution, self.keep, self.soft, queue,
                self.counts, self.spared,
                self.ahead, self.lower, homes.around, self.todo, pending, self.stop, self.stopped, self.crowded,
                reached, log,
            )  # fmt: skip
            if not short:
                return
            if short == STANDSTILL:
                raise StateError(self.standstill(moment + reached[0]))
            if short == BREATH:
                breathe()
            else:
                homes.enlarge(short)
            pending = 0

    def standstill(self, time: float) -> str:
        """Who meets whom for ever."""
        row, partner = int(self.todo[0]), int(self.todo[1])
        with_ = f"particle {self.state[partner, ID]}" if partner >= 0 else f"wall {-1 - partner}"
        with_ = "nobody, but leaves its neighbourhood" if partner == LEAVING else with_
        return (
            f"time stands still at t = {time:.9g}: events follow one another without end, the last one of particle"
            f" {self.state[row, ID]} with {with_}"
        )

    def arrive(self) -> int:
        """All rows to the end of the drift. Returns how many own ones were squeezed."""
        squeezed = arrive(self.axes, self.leg, self.state, float(self.stopped[0]), self.homes.home, self.length, self.lower)
        counts = self.counts
        self.moved += int(counts[HOMES])
        self.events = int(counts[COLLISIONS] + counts[WALL_HITS] + counts[HOMES])
        self.ahead = AHEAD / (1.0 + 2.0 * counts[COLLISIONS] / max(counts[HOMES], 1))
        return int(squeezed)

    def grow(self) -> Array:
        """Twice as many rows; returns the new ones, which are free."""
        rows, d = len(self.leg), len(self.axes)
        self.leg = enlarged(self.leg, aligned(2 * rows, 2 * d + 2))
        self.state = enlarged(self.state, aligned(2 * rows, 8).view(np.int64))
        self.state[rows:] = 0
        self.reals = self.state.view(np.float64)
        self.slot = enlarged(self.slot, np.full((2 * rows, SLOT), NOTHING, np.int32))
        self.todo = enlarged(self.todo, np.empty(4 * rows + 2, np.int32))
        self.log.grow()
        self.fields = {name: enlarged(old, np.zeros((2 * rows, *old.shape[1:]))) for name, old in self.fields.items()}
        self.homes.grow()
        return np.arange(rows, 2 * rows, dtype=np.int32)

    def hand_over(self, p: Particles, seat: Array) -> None:
        """Particle r of p as row seat[r] is."""
        virial, supported = p.arrays.get("virial", np.empty(0)), p.arrays.get("supported", np.empty(0, np.uint8))
        hand_over(
            self.axes, self.leg, self.state, self.reals, p.position, p.velocity, p.contacted, virial, supported,
            self.crowded, seat,
        )  # fmt: skip
