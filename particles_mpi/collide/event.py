"""The operator `event`: hard spheres and walls in exact order of time, the reference for `rewind`.

Every particle is on a straight leg since its last contact and knows its next event: the first contact on the present legs, or
that it leaves its shell (`neighbours.shells`). The first event of all takes place, the partners set out on new legs, and
only they, and those who had meant to meet them, look for their next events again: O(1) work a contact, whatever N is.

On several ranks every rank has all particles during the drift, and computes all contacts: the same bits, and no faster.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from particles_mpi.collide.contact import NOBODY
from particles_mpi.collide.events import AHEAD, COLLISIONS, HOMES, SPARED, WALL_HITS, arrive, run, set_out
from particles_mpi.collide.planes import Planes, no_planes
from particles_mpi.collide.queue import NOTHING, SLOT
from particles_mpi.errors import StoppedError
from particles_mpi.neighbours.cells import bounds, order_in_space
from particles_mpi.neighbours.homes import Homes, aligned
from particles_mpi.neighbours.paths import fastest
from particles_mpi.parallel.ranks import Ranks
from particles_mpi.parallel.replica import Replica
from particles_mpi.parallel.store import Store
from particles_mpi.particles import Array, Particles
from particles_mpi.timers import Timers

SETTLED = 8  # new homes a particle, on average; then all are sorted in space and settled again
CONTACTS = 1.0  # expected in a bucket of the queue


class Event:
    """Drifts particles that collide with one another, and with walls if there are any."""

    def __init__(
        self,
        particles: Particles,
        ranks: Ranks,
        box: tuple[Array, Array, Array],
        loss: tuple[float, float],
        soft: float,
        planes: Planes | None,
        timers: Timers,
    ):
        self.ranks, self.timers = ranks, timers
        changing: list[str] = [name for name in ("position", "velocity", "contacted", "virial") if name in particles.arrays]
        self.replica = Replica(particles, ranks, changing)
        self.particles = self.replica.everyone
        self.restitution, self.keep = loss
        self.soft = soft
        self.lower, _, self.length = box
        self.planes = planes or no_planes(particles.dimension)
        self.axes = (0,) * particles.dimension
        self.store, self.homes = Store(self.particles), Homes(box)
        self.version, self.moved = -1, 0
        self.searches = self.ghost_rows = self.migrated = 0
        self.counts = np.zeros(4, np.int64)
        self.events = 0  # in the last drift
        self.ahead = 0.0
        self.eased = 0
        self.first_eased: tuple[float, list[int]] | None = None
        self.stop, self.stopped = np.zeros(3, np.int64), np.zeros(1)
        self.spared = np.empty((64, 2), np.int64)

    def drift(self, h: float, moment: float, stop: bool = False) -> Array:
        """x += v h with every contact on the way; returns the (collisions, wall hits, missed) of this rank. Collective.

        `moment`: the time at which the drift begins. With `stop` it ends with the first collision of two particles, after
        `self.stopped[0]` (h if there is none), and `self.stop[1:]` are their ids, the lower one first, or -1.
        """
        p = self.particles
        with self.timers("exchange"):
            self.replica.gather()
            if not np.isfinite(fastest(self.axes, p.position, p.velocity)):
                self.stop_for_numbers(moment)
        with self.timers("pairs"):
            if self.version != p.version or self.moved > SETTLED * len(p):
                self.settle()
        n, d = len(p), p.dimension
        counts = self.counts
        counts[:] = 0
        virial = p.arrays.get("virial", self.unasked)
        self.stop[:], self.stopped[0] = (stop, -1, -1), h
        with self.timers("search"):
            set_out(self.axes, self.leg, p.position, p.velocity, p.radius)
            self.met[:] = NOBODY
            self.stuck[:] = 0
            self.slot[:, 0] = NOTHING
            buckets = int(min(max(self.events / CONTACTS, 64), 4 * n + 64))
            heads = np.full(buckets, -1, np.int32)
            queue: Any = (
                self.slot,
                self.when,
                heads,
                buckets / h,
                np.zeros(1, np.int64),
                np.zeros(1, np.bool_),
                np.empty(d),
                np.empty(d),
            )
            homes, planes = self.homes, self.planes
            walls = planes.point, planes.normal, planes.lower, planes.upper, planes.oblique
            todo = np.arange(n, dtype=np.int32)
        with self.timers("collide"):
            pending = n
            while True:
                short = run(
                    self.axes, self.leg, p.id, self.w, self.met, self.stuck, self.turns, p.contacted, virial, h, moment,
                    self.length, homes.pool, homes.lists, homes.top, homes.home, homes.links, homes.level, homes.head, homes.grid,
                    walls, planes.restitution, planes.keep, self.restitution, self.keep, self.soft, queue, counts,
                    self.spared, self.ahead, self.lower, homes.around, todo, pending, self.stop, self.stopped,
                )  # fmt: skip
                if not short:
                    break
                homes.pool = np.concatenate((homes.pool, np.empty(short + len(homes.pool), np.int32)))
                pending = 0
        with self.timers("drift"):
            squeezed = arrive(
                self.axes,
                self.leg,
                p.position,
                p.velocity,
                self.stuck,
                float(self.stopped[0]),
                homes.home,
                self.length,
                self.lower,
            )
        with self.timers("exchange"):
            self.replica.give_back()
        if counts[SPARED]:
            self.remember(moment, int(counts[SPARED]))
        self.moved += int(counts[HOMES])
        self.events = int(counts[COLLISIONS] + counts[WALL_HITS] + counts[HOMES])
        self.ahead = AHEAD / (1.0 + 2.0 * counts[COLLISIONS] / max(counts[HOMES], 1))
        return np.array([counts[COLLISIONS], counts[WALL_HITS], squeezed]) * self.ranks.is_root  # all ranks saw the same

    def stop_for_numbers(self, moment: float) -> None:
        """Something is not finite, or too fast for its square to be: say whose, on all ranks."""
        p = self.particles
        with np.errstate(over="ignore", invalid="ignore"):
            bad = p.id[~np.isfinite((p.velocity**2).sum(axis=1) + p.position.sum(axis=1))]
        raise StoppedError(f"t = {moment:g}: particle {bad.min(initial=2**62)} has a position or velocity that is not finite")

    def remember(self, moment: float, eased: int) -> None:
        """How many contacts took no energy, and in which cluster it began."""
        self.eased += eased
        if self.first_eased is None:
            pairs = self.spared[: min(eased, len(self.spared))].tolist()
            cluster = set(pairs[0])
            for pair in pairs:  # in order of time: a cluster grows from its first pair
                if cluster & {member for member in pair if member >= 0}:
                    cluster |= set(pair)
            self.first_eased = moment, sorted(cluster)

    def remarks(self) -> list[str]:
        """What a user should be told at the end."""
        if self.first_eased is None:
            return []
        moment, cluster = self.first_eased
        ids, walls = [str(k) for k in cluster if k >= 0], [str(-1 - k) for k in cluster if k < 0]
        where = f"particles {', '.join(ids)}" + (f" and wall {', '.join(walls)}" if walls else "")
        return [
            f"inelastic collapse: {self.eased} contacts within {self.soft:.3g} of the last one took no energy, "
            f"the first in the step from t = {moment:g} among {where}"
        ]

    def settle(self) -> None:
        """Rows sorted in space, with new homes, and all that goes with them."""
        p = self.particles
        n, d = len(p), p.dimension
        self.store.adopt()
        if n > 1:
            self.store.sort(order_in_space(p.position, bounds(p.position)))
        self.w = p.inverse_mass
        self.homes.settle(p.position, p.radius, self.w)
        self.leg = aligned(n, 2 * d + 2)
        self.unasked = np.zeros(n)
        self.met, self.stuck, self.turns = np.full(n, NOBODY), np.zeros(n, np.int32), np.zeros(n, np.int32)
        self.slot, self.when = np.full((n, SLOT), NOTHING, np.int32), np.empty(n)
        self.version, self.moved = p.version, 0
        self.searches += 1
