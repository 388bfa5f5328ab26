"""Mode `event` on several ranks: each computes its part of space a short window of time ahead, and ranks verify one another.

Space is divided into regions. A rank owns the particles whose homes are in its region and has the others near it as ghosts,
and computes all contacts among these rows in the window as if there were nobody else. That is right for particles of its own
unless one of them met, or should have met, a ghost that had a wrong history here, for lack of what is beyond the ghosts. So
owners tell what happened to their rows; if a ghost that may have met an own particle had another history here, all ranks undo
the window and compute half of it. If not, the union of what the owners found is the exact run (README, by induction over the
contacts in order of time). Ghosts that went wrong further out are corrected. Windows leave no trace in the bits.
"""

from __future__ import annotations

import numpy as np

from particles_mpi.contacts.event_driven.engine import SETTLED, Engine
from particles_mpi.contacts.event_driven.event_loop import COLLISIONS, WALL_HITS
from particles_mpi.contacts.event_driven.messages import (
    admit,
    check,
    correct,
    mark_holders,
    pack_motion,
    pack_news,
    plan_moves,
    undo,
    unpack_motion,
)
from particles_mpi.contacts.event_driven.rollback import KNOWN, MINE, OWN, record_width
from particles_mpi.neighbours.cells import bounds, order_in_space
from particles_mpi.neighbours.trajectories import fastest
from particles_mpi.neighbours.verlet_kernels import MARGIN
from particles_mpi.parallel.agreement import require_finite
from particles_mpi.parallel.buffers import RowBuffers
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import by_destination, send_rows, sendrecv
from particles_mpi.parallel.load_balance import LoadBalance
from particles_mpi.particles import Array, Particles, field
from particles_mpi.timers import Timers

STRAY = 0.125  # of a shell: how far a row may get in a window
DEPTH = 1.2  # mean diameters of ghosts beyond those that own particles can meet: wrong histories have to come through them
CROWDED = 0.75  # of all particles on one rank, ghosts included: then each may as well compute everything
FASTER, SLOWER = 1.015, 0.6  # what success and failure do to the length of a window: in balance about 3 % fail
START, GROWING = 0.25, 1.2  # of the longest window: the first one; and how it grows until one fails
LEAST = 1e-3  # of the longest window: with shorter ones it is no use
MOST_TRIES = 8  # of a window, each of half the length; then contacts follow one another in no time (touching spheres)
WORTH = 10  # contacts a window and rank, or windows are not worth their messages
UNTRIED = 1000  # windows a step at most where the number of contacts is not known yet


class Windows:
    """Drifts the particles of all ranks; `count` and `redone` are the numbers of windows.

    `always`: even where it does not pay, for tests and to compile everything.
    """

    def __init__(
        self, particles: Particles, ranks: Communicator, engine: Engine, box: tuple[Array, Array, Array], timers: Timers
    ):
        self.particles, self.ranks, self.engine, self.timers = particles, ranks, engine, timers
        self.lower, self.upper, self.length = box
        self.balance, self.row_buffers = LoadBalance(ranks, timers), RowBuffers(particles)
        self.version = -1
        self.searches = self.migrated = self.ghost_rows = self.count = self.redone = 0
        self.always = False
        self.window = 0.0
        self.growing = True
        self.buffers: dict[int, Array] = {}
        self.total = int(ranks.allreduce_sum(len(particles))[0])
        self.row_of = np.full(int(ranks.allreduce_max(particles.id.max(initial=-1))[0]) + 1, -1, np.int32)  # of each id here

    def drift(self, h: float, moment: float) -> Array | None:
        """(collisions, wall hits, missed) of this rank, or None where it cannot be done; then nothing has changed. Collective."""
        engine, p = self.engine, self.particles
        with self.timers("agree"):
            speed = self.set_out(moment)
        if self.crowded and not self.always:
            return None
        self.longest = 0.9 * self.stray / speed if speed > 0.0 else np.inf
        if h / self.longest > (self.events / WORTH if self.events else UNTRIED) and not self.always:
            return None
        self.window = min(self.window or START * self.longest, self.longest)
        with self.timers("ghosts"):
            self.tell_motion()
        with self.timers("search"):
            engine.begin(h)
            engine.far[1] = True  # a squeezed ghost may come by message
        begin = end = 0.0
        tries = self.given = 0
        while begin < h:
            end = begin + self.window if tries == 0 else begin + 0.5 * (min(end, h) - begin)
            last = end >= h
            if self.one_window(begin, np.inf if last else end, min(end, h) - begin, moment):
                if tries == 0:
                    self.window = min(self.window * (GROWING if self.growing else FASTER), self.longest)
                begin, tries = end, 0
            else:
                self.window *= SLOWER if tries == 0 else 1.0  # one contact may need many tries
                self.growing = False
                tries += 1
                if tries > MOST_TRIES or self.window < LEAST * self.longest:
                    self.version = -1  # rows of the engine mean nothing now; those of the particles were not touched
                    self.window, self.growing = 0.0, True
                    return None
        with self.timers("drift"):
            squeezed = engine.arrive()
        with self.timers("migrate"):
            self.migrate()
            engine.hand_over(p, self.seat)
        return np.array([engine.counts[COLLISIONS], engine.counts[WALL_HITS], squeezed])

    def set_out(self, moment: float) -> float:
        """Own rows on their way, all rows settled where they must be; returns the largest speed of all."""
        p, engine = self.particles, self.engine
        while True:
            stale = self.version != p.version
            if stale:
                speed = fastest(p.position, p.velocity)
            else:
                moved, speed = engine.set_out(p, self.seat)
                stale = moved or engine.moved > SETTLED * len(engine.leg)
            speed = speed if speed < np.inf else np.inf  # or it is not a number
            stale, speed, self.events = self.ranks.allreduce_max(np.array([stale, speed, engine.events], float))
            require_finite(self.ranks, p, speed, f"t = {moment:g}")
            if not stale:
                break
            self.settle()
        self.holder[self.seat, 0], self.holder[self.seat, 1] = self.ranks.rank, np.arange(len(p))
        return float(speed)

    def settle(self) -> None:
        """Particles to the ranks whose regions they are in, ghosts to all who need them, new homes for all. Collective."""
        p, engine, ranks = self.particles, self.engine, self.ranks
        homes = engine.homes
        self.balance.update(p, self.searches)
        self.row_buffers.adopt()
        self.migrated += self.row_buffers.migrate(ranks, self.balance.decomposition.owner(self.wrapped(p.position)))
        n, d = len(p), p.dimension
        if n > 1:
            self.row_buffers.sort(order_in_space(p.position, bounds(p.position)))
        homes.settle(p.position, p.radius, p.inverse_mass)
        total = self.total
        mine = np.array([homes.shell, p.radius.max(initial=0.0)])
        self.shell, largest = (float(value) for value in ranks.allreduce_max(mine))
        mean = float(ranks.allgather_array(np.array([p.radius.sum()])).sum()) / max(total, 1)
        self.stray = STRAY * self.shell
        # Between a region and whom its particles may meet in a window, less the radius of that one:
        self.reach = (self.shell + 2.0 * self.stray + largest) * MARGIN
        self.depth = (self.reach + 2.0 * max(DEPTH * mean, largest)) * MARGIN
        homes.shell_width = self.shell
        self.cut()
        self.near = self.neighbours(self.depth + largest + self.shell + 2.0 * self.shell + self.stray)
        self.known = np.array([*self.near, ranks.rank])
        told = np.zeros((n, ranks.size // 64 + 1), np.int64)
        homes.home[:n, d] = p.radius + np.where(p.inverse_mass > 0.0, self.shell, 0.0)
        self.mark(np.arange(n, dtype=np.int32), told)
        bits = [told[:, r >> 6] >> (r & 63) & 1 for r in range(ranks.size)]
        sent = [np.flatnonzero(bit) if r != ranks.rank else np.empty(0, int) for r, bit in enumerate(bits)]
        names = [name for name in p.arrays if field(name).ghost or name == "virial"]
        arrived, _ = send_rows(
            ranks, {name: p[name] for name in names}, np.concatenate(sent), np.array([len(rows) for rows in sent], np.int32)
        )
        rows = Particles(d, {name: np.concatenate((p[name], arrived[name])) for name in names})
        ghosts = len(rows) - n
        spare = ghosts // 2 + 256
        homes.share = total / max(len(rows), 1)
        homes.build(rows.position, rows.radius, rows.inverse_mass, spare)
        engine.settle(rows, n, spare)
        others = told.copy()
        others[:, ranks.rank >> 6] &= ~(np.int64(1) << np.int64(ranks.rank & 63))
        engine.state[:n, MINE][others.any(axis=1)] = KNOWN
        self.told, self.holder, self.heard = (
            np.concatenate((told, np.zeros((ghosts + spare, told.shape[1]), np.int64))),
            np.zeros((n + ghosts + spare, 2), np.int64),
            np.zeros(n + ghosts + spare, np.int64),
        )
        self.free = np.roll(np.arange(n + ghosts + spare, dtype=np.int32), spare)  # the first `free_count` of these
        self.free_count = np.array([spare])
        self.row_of[:] = -1
        self.row_of[rows.id] = np.arange(len(rows))
        self.seat = np.arange(n, dtype=np.int32)
        self.crowded = bool(ranks.allreduce_max(float(len(rows)))[0] > CROWDED * total)
        self.ghost_rows += ghosts
        self.version = p.version
        self.searches += 1

    def wrapped(self, x: Array) -> Array:
        """Places x (n, d) in the box where it is periodic."""
        periodic = self.length > 0.0
        x = x.copy()
        x[:, periodic] -= np.floor((x - self.lower)[:, periodic] / self.length[periodic]) * self.length[periodic]
        return x

    def cut(self) -> None:
        """The regions of all ranks: `low`, `high` (ranks, d), within the box where it is periodic."""
        domain, periodic = self.balance.decomposition, self.length > 0.0
        self.low = np.where(periodic, np.maximum(domain.lower, self.lower), domain.lower)
        self.high = np.where(periodic, np.minimum(domain.upper, self.upper), domain.upper)

    def neighbours(self, distance: float) -> list[int]:
        """The ranks whose regions, or images of them, are no further than this from this one's."""
        me, apart = self.ranks.rank, np.full(self.low.shape, np.inf)
        for shift in (0.0, self.length, -self.length):
            gap = np.maximum(np.maximum(self.low[me] + shift - self.high, self.low - self.high[me] - shift), 0.0)
            apart = np.minimum(apart, gap)
        near = np.flatnonzero((apart**2).sum(axis=1) <= distance**2)
        return [int(rank) for rank in near if rank != me]

    def mark(self, rows: Array, masks: Array) -> None:
        """masks[p]: all ranks that must know row rows[p], this one too."""
        engine = self.engine
        mark_holders(engine.homes.home, rows, self.known, self.low, self.high, self.length, self.lower, self.depth, masks)

    def tell_motion(self) -> None:
        """Ghosts on their way as their owners are."""
        engine = self.engine
        outgoing = []
        for rank in self.near:
            buffer = self.buffer(rank, len(engine.leg) * (1 + 3 * len(engine.axes)))
            size = pack_motion(engine.leg, engine.state, engine.accelerations, self.told, rank, buffer, buffer.view(np.int64))
            outgoing.append(buffer[:size])
        message = sendrecv(self.ranks, self.near, outgoing)
        unpack_motion(engine.leg, engine.state, engine.accelerations, self.row_of, message, message.view(np.int64))

    def buffer(self, rank: int, size: int) -> Array:
        """Room for a message to a rank."""
        if len(self.buffers.get(rank, ())) < size:
            self.buffers[rank] = np.empty(2 * size)
        return self.buffers[rank]

    def one_window(self, begin: float, until: float, length: float, moment: float) -> bool:
        """All contacts from `begin` to `until`, verified; False if they had to be undone. Collective."""
        engine, log = self.engine, self.engine.log
        self.count += 1
        log.window[0] = self.count
        log.count[0], log.shared[0], log.fastest[0] = 0, 0, 0.0
        before = engine.counts.copy()
        with self.timers("collide"):
            engine.run(begin, until, moment)
        with self.timers("ghosts"):
            wanted, owner = self.plan_moves()
            incoming = sendrecv(self.ranks, self.near, [self.news(rank, wanted, owner) for rank in self.near])
            wrong = self.wrong(begin, incoming)
        with self.timers("agree"):
            given = self.given + int((owner != self.ranks.rank).sum())
            wrong, fastest2, given = self.ranks.allreduce_max(np.array([wrong, log.fastest[0], given], float))
        with self.timers("ghosts"):
            if wrong or np.sqrt(fastest2) * length > self.stray:
                self.undo(before)
                return False
            self.given = int(given)
            self.longest = min(self.longest, 0.9 * self.stray / np.sqrt(fastest2)) if fastest2 > 0.0 else self.longest
            self.accept(incoming, wanted, owner)
        return True

    def plan_moves(self) -> tuple[Array, Array]:
        """(masks of who must know them, owner) of own rows that got new homes."""
        log, me = self.engine.log, self.ranks.rank
        domain = self.balance.decomposition
        tree = domain.axis, domain.cut, domain.below, domain.above
        moved = int(log.moved[0])
        wanted, owner = np.zeros((moved, self.told.shape[1]), np.int64), np.empty(moved, np.int64)
        plan_moves(
            self.engine.homes.home, log.arrays(), me, self.known, self.low, self.high, self.length,
            self.lower, self.depth, tree, wanted, owner,
        )  # fmt: skip
        return wanted, owner

    def news(self, rank: int, wanted: Array, owner: Array) -> Array:
        """What a rank must hear."""
        engine, log, d = self.engine, self.engine.log, len(self.length)
        part = record_width(d) + d + 6 + self.told.shape[1] + engine.differing
        buffer = self.buffer(rank, (int(log.shared[0]) + 3 * int(log.moved[0])) * part)
        size = pack_news(
            engine.leg, engine.state, engine.homes.home, engine.accelerations, engine.drags, self.told, self.holder,
            log.arrays(), wanted, owner, rank, buffer, buffer.view(np.int64),
        )  # fmt: skip
        return buffer[:size]

    def wrong(self, begin: float, message: Array) -> bool:
        """Had a ghost that may have met an own row another history at its owner?"""
        engine, me = self.engine, self.ranks.rank
        return check(
            engine.leg, engine.state, self.row_of, engine.log.arrays(), self.heard, begin, self.low[me],
            self.high[me], self.length, self.lower, self.reach, message, message.view(np.int64), self.told.shape[1],
            engine.differing,
        )  # fmt: skip

    def undo(self, before: Array) -> None:
        """All rows and counts as they were when the window began."""
        engine = self.engine
        engine.pending = undo(engine.leg, engine.state, engine.log.arrays(), engine.todo)
        engine.counts[:] = before
        self.redone += 1

    def accept(self, message: Array, wanted: Array, owner: Array) -> None:
        """The window is right: correct the other ghosts, and let rows come, go and change owners."""
        engine, words = self.engine, message.view(np.int64)
        pending = np.zeros(1, np.int64)
        pending[0] = correct(
            engine.leg, engine.state, self.row_of, engine.log.arrays(), self.heard, message, words,
            engine.differing, self.told, wanted, owner, self.ranks.rank, engine.todo,
        )  # fmt: skip
        at = 0
        while at < len(message):
            homes = engine.homes
            places = homes.home, homes.links, homes.lists, homes.pool, homes.top, homes.head, homes.around
            at, short = admit(
                engine.leg, engine.state, engine.accelerations, engine.drags, engine.slot, engine.heads, self.row_of,
                places, homes.grid, homes.level, self.shell, self.length, self.told, self.holder, self.free, self.free_count,
                engine.todo, pending, message, words, at,
            )  # fmt: skip
            if short > 0:
                homes.enlarge(short)
            elif short < 0:
                self.grow()
        engine.pending = int(pending[0])

    def grow(self) -> None:
        """More rows than there is room for came near."""
        more = self.engine.grow()
        self.free = np.concatenate((more, self.free))
        self.free_count[0] = len(more)
        self.told, self.holder, self.heard = (
            np.concatenate((old, np.zeros_like(old))) for old in (self.told, self.holder, self.heard)
        )

    def migrate(self) -> None:
        """The fields of particles that changed owner go to their new owners. Collective."""
        if not self.given:
            return
        engine, p, ranks = self.engine, self.particles, self.ranks
        came = np.flatnonzero((engine.state[:, MINE] >= OWN) & (self.holder[:, 0] != ranks.rank))
        order, counts = by_destination(self.holder[came, 0], ranks.size)
        asked, of = send_rows(ranks, {"row": self.holder[:, 1]}, came[order], counts)
        owner = np.full(len(p), ranks.rank)
        owner[asked["row"]] = np.repeat(np.arange(ranks.size), of)
        self.row_buffers.adopt()
        self.migrated += self.row_buffers.migrate(ranks, owner)
        self.seat = self.row_of[p.id]
        self.version = p.version
