"""Mode `event` on several ranks: each computes its part of space a short window of time ahead, and ranks verify one another.

Space is divided into regions. A rank owns the particles whose reference positions are in its region, has those near it as
ghosts, and computes all contacts among these rows in the window as if there were no others. That is right for its own particles
unless one of them touched, or should have touched, a ghost that went wrong here for lack of what is beyond the ghosts. So after
a window owners send what happened to their rows. If a ghost that was so near to an own particle that they can have touched has
another trajectory hash at its owner, all ranks undo the window and compute half of it. If there is none, the union of what the
owners found is the exact run (contacts/README.md has the proof); ghosts that went wrong further out are
corrected. Windows leave no trace in the bits.
"""

import numpy as np

from particles_mpi.contacts.event_driven.arrivals import apply_moves, reconcile, roll_back, verify
from particles_mpi.contacts.event_driven.engine import MOST_EXPIRIES, Engine
from particles_mpi.contacts.event_driven.event_loop import COLLISIONS, WALL_HITS
from particles_mpi.contacts.event_driven.id_table import rows_of_ids, table_of
from particles_mpi.contacts.event_driven.messages import HOLDER, PLACE, Directory, message_of, pack_changes, widest_part
from particles_mpi.contacts.event_driven.regions import Moves, Regions, mark_holders, plan_moves
from particles_mpi.contacts.event_driven.rows import (
    ID,
    LAST_PARTNER,
    NOT_HERE,
    OWN,
    OWNERSHIP,
    RAPID_EVENTS,
    SHARED,
    START,
    TRAJECTORY_HASH,
)
from particles_mpi.kernels.geometry import Box, wrap
from particles_mpi.kernels.markers import NOBODY
from particles_mpi.kernels.memory import doubled, enlarged
from particles_mpi.neighbours.cells import bounds, order_in_space
from particles_mpi.neighbours.trajectories import fastest
from particles_mpi.neighbours.verlet_cells import MARGIN
from particles_mpi.neighbours.verlet_kernels import SIZE
from particles_mpi.neighbours.verlet_lists import contact_distance
from particles_mpi.parallel.agreement import require_finite
from particles_mpi.parallel.buffers import RowBuffers
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.decomposition import LoadBalance
from particles_mpi.parallel.exchange import by_destination, send_rows, sendrecv
from particles_mpi.particles import Array, Particles, field
from particles_mpi.timers import Timers

DISPLACEMENT_BOUND = 0.25  # of a skin: how far a row may get in a window
DEPTH = 1.4  # mean diameters: thickness of the ghosts beyond those that own particles can touch, through which errors must come
LEAST_DEPTH, MOST_DEPTH = 1.0, 4.0  # bounds of that depth, which is fitted: then windows need not be shorter on more ranks
DEEPER, MOST_REDONE = 0.2, 0.02  # added if more than this part of the windows was redone
SHALLOWER, ENOUGH = 0.1, 100  # taken off after so many windows of which none was
MOST_ON_ONE_RANK = 0.75  # of all particles on one rank, ghosts included: then each may as well compute everything
FASTER, SLOWER = 1.015, 0.6  # what success and failure do to the length of a window: in balance about 3 % fail
FIRST, GROWING = 0.25, 1.2  # of the longest window: the first one; and how it grows until one fails
LEAST = 1e-3  # of the longest window: with shorter ones it is no use
MOST_TRIES = 8  # of a window, each of half the length; then contacts follow one another in no time (touching spheres)
WORTH = 10  # contacts a window and rank, or windows are not worth their messages
CHEAP = 8  # windows in a step, which cost less than a drift without them
UNTRIED = 1000  # windows a step at most where the number of contacts is not known yet


class Windows:
    """Drifts the particles of all ranks; `count` and `redone` are the numbers of windows.

    `always`: even where it does not pay, for tests and to compile everything. `own_rows` (particles,): the row of each in the
    engine, which was loaded for this `version` of the particles.
    """

    directory: Directory
    regions: Regions
    events: float

    def __init__(self, particles: Particles, ranks: Communicator, engine: Engine, box: Box, timers: Timers):
        self.particles, self.ranks, self.engine, self.timers = particles, ranks, engine, timers
        self.box = box
        self.balance, self.row_buffers = LoadBalance(ranks, timers), RowBuffers(particles)
        self.version = -1
        self.searches = self.migrated = self.ghost_rows = self.count = self.redone = 0
        self.always = False
        self.window = 0.0  # length of the next one
        self.crowded = False
        self.growing = True
        self.depth = DEPTH
        self.verified = 0, 0  # `count` and `redone` when the depth was last fitted
        self.total = int(ranks.allreduce_sum(len(particles))[0])

    def drift(self, h: float, moment: float) -> Array | None:
        """(collisions, wall hits, missed) of this rank, or None where it cannot be done; then nothing has changed. Collective."""
        engine, p = self.engine, self.particles
        with self.timers("agree"):
            speed = self.prepare(moment)
        if self.crowded and not self.always:
            return None
        self.longest = 0.9 * self.regions.bound / speed if speed > 0.0 else np.inf
        if h / self.longest > (max(self.events / WORTH, CHEAP) if self.events else UNTRIED) and not self.always:
            return None
        self.window = min(self.window or FIRST * self.longest, self.longest)
        with self.timers("ghosts"):
            self.send_motion()
        with self.timers("search"):
            engine.begin(h)
            engine.work.any_squeezed[0] = True  # a squeezed ghost may come by message
        begin = end = 0.0
        tries = self.transferred = 0
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
            squeezed = engine.end_drift()
        with self.timers("migrate"):
            self.migrate()
            engine.write_back(p, self.own_rows)
        return np.array([engine.work.counts[COLLISIONS], engine.work.counts[WALL_HITS], squeezed])

    def prepare(self, moment: float) -> float:
        """Own rows on their way, after `redistribute` where it is time for that; returns the largest speed of all. Collective."""
        p, engine = self.particles, self.engine
        while True:
            outdated = self.version != p.version
            if outdated:
                speed = fastest(p.position, p.velocity)
            else:
                moved, speed = engine.start_drift(p, self.own_rows)
                outdated = moved or engine.expiries > MOST_EXPIRIES * len(engine.rows.segment) or self.redone_often()
            speed = speed if speed < np.inf else np.inf  # or it is not a number
            outdated, speed, self.events = self.ranks.allreduce_max(np.array([outdated, speed, engine.events], float))
            require_finite(self.ranks, p, speed, f"t = {moment:g}")
            if not outdated:
                break
            self.redistribute()
        self.directory.fields_at[self.own_rows, HOLDER] = self.ranks.rank
        self.directory.fields_at[self.own_rows, PLACE] = np.arange(len(p))
        return float(speed)

    def redone_often(self) -> bool:
        """Were too many windows redone since the depth of the ghosts was fitted?"""
        count, redone = self.count - self.verified[0], self.redone - self.verified[1]
        return redone > MOST_REDONE * max(count, ENOUGH) and self.depth < MOST_DEPTH

    def fit_depth(self) -> None:
        """More ghosts where many windows were redone, fewer where none was or ghosts are too many."""
        if self.redone_often():
            self.depth += DEEPER
        elif self.crowded or (self.redone == self.verified[1] and self.count > self.verified[0] + ENOUGH):
            self.depth = max(self.depth - SHALLOWER, LEAST_DEPTH)
        self.verified = self.count, self.redone

    def redistribute(self) -> None:
        """Particles to the ranks whose regions they are in, ghosts to all who need them, new lists for all. Collective."""
        p, engine, ranks, lists = self.particles, self.engine, self.ranks, self.engine.lists
        self.fit_depth()
        self.balance.update(p, self.searches)
        self.row_buffers.adopt()
        inside = p.position.copy()
        wrap(inside, *self.box)
        self.migrated += self.row_buffers.migrate(ranks, self.balance.decomposition.owner(inside))
        n, d = len(p), p.dimension
        if n > 1:
            self.row_buffers.sort(order_in_space(p.position, bounds(p.position)))
        w = p.inverse_mass
        largest, movable = ranks.allreduce_max(np.array(contact_distance(p.radius, w))).tolist()
        lists.tune(p.position, p.radius, w, largest + movable, way=0.0)
        self.skin = float(ranks.allreduce_max(lists.skin if n else 0.0)[0])
        mean = float(ranks.allreduce_sum(p.radius.sum())[0]) / max(self.total, 1)
        lists.width = self.skin
        self.divide(largest, mean)
        known = len(self.regions.known)
        holders = np.zeros((n, known // 64 + 1), np.int64)
        reference = lists.arrays.reference
        reference[:n, d + SIZE] = p.radius + np.where(p.inverse_mass > 0.0, self.skin, 0.0)
        mark_holders(reference, np.arange(n, dtype=np.int32), tuple(self.regions), holders)
        held = [np.flatnonzero(holders[:, k >> 6] >> (k & 63) & 1) for k in range(known - 1)]
        shared, counts = np.concatenate([*held, np.empty(0, np.int64)]).astype(np.int64), np.zeros(ranks.size, np.int32)
        counts[self.near] = list(map(len, held))
        sent = {name: column for name, column in p.arrays.items() if field(name).ghost or name == "virial"}
        arrived, _ = send_rows(ranks, sent, shared, counts)
        here = Particles(d, {name: np.concatenate((column, arrived[name])) for name, column in sent.items()})
        ghosts = len(here) - n
        spare = ghosts // 2 + 256
        lists.share = self.total / max(len(here), 1)
        lists.build(here.position, here.radius, here.inverse_mass, spare)
        engine.load(here, n, spare)
        engine.rows.state[shared, OWNERSHIP] = SHARED
        total = len(here) + spare
        self.directory = Directory(
            table_of(here.id, np.arange(len(here)), total),
            enlarged(holders, np.zeros((total, holders.shape[1]), np.int64)), np.zeros((total, 2), np.int64),
            np.zeros(total, np.int64), np.roll(np.arange(total, dtype=np.int32), spare), np.array([spare]),
        )  # fmt: skip
        self.own_rows = np.arange(n, dtype=np.int32)
        self.crowded = bool(ranks.allreduce_max(float(len(here)))[0] > MOST_ON_ONE_RANK * self.total)
        self.ghost_rows += ghosts
        self.version = p.version
        self.searches += 1

    def divide(self, largest: float, mean: float) -> None:
        """The regions of all ranks, and those who may have to exchange messages; `largest`, `mean`: radius of all particles."""
        me, domain, length = self.ranks.rank, self.balance.decomposition, self.box.length
        low = np.where(length > 0.0, np.maximum(domain.lower, self.box.lower), domain.lower)
        high = np.where(length > 0.0, np.minimum(domain.upper, self.box.upper), domain.upper)
        bound = DISPLACEMENT_BOUND * self.skin
        reach = (self.skin + 2.0 * bound + largest) * MARGIN
        depth = (reach + 2.0 * max(self.depth * mean, largest)) * MARGIN
        apart = np.full(low.shape, np.inf)  # from the region of this rank to the nearest image of each
        for shift in (0.0, length, -length):
            apart = np.minimum(apart, np.maximum(np.maximum(low[me] + shift - high, low - high[me] - shift), 0.0))
        within = depth + largest + self.skin + 2.0 * self.skin + bound
        self.near = [int(rank) for rank in np.flatnonzero((apart**2).sum(axis=1) <= within**2) if rank != me]
        self.regions = Regions(low, high, tuple(self.box), me, np.array([*self.near, me]), reach, bound, depth)

    def send_motion(self) -> None:
        """Ghosts start on the segments that their owners' rows start on. Collective."""
        rows, holders, d = self.engine.rows, self.directory.holders, len(self.box.length)
        shared = np.flatnonzero(rows.state[:, OWNERSHIP] == SHARED)
        numbers = [rows.state[shared, ID].view(float), rows.segment[shared, : 2 * d]]
        numbers += [column[shared] for column in (rows.acceleration, rows.spin) if len(column)]
        table = np.column_stack(numbers)
        outgoing = [table[(holders[shared, k >> 6] >> (k & 63) & 1) == 1].ravel() for k in range(len(self.near))]
        arrived = sendrecv(self.ranks, self.near, outgoing).reshape(-1, table.shape[1])
        ghosts = rows_of_ids(self.directory.table, arrived[:, 0].copy().view(np.int64))
        rows.segment[ghosts, : 2 * d], rows.segment[ghosts, 2 * d + START] = arrived[:, 1 : 2 * d + 1], 0.0
        rows.state[ghosts, LAST_PARTNER] = NOBODY
        rows.state[ghosts, RAPID_EVENTS] = rows.state[ghosts, TRAJECTORY_HASH] = 0
        at = 2 * d + 1
        for column in (rows.acceleration, rows.spin):
            if len(column):
                column[ghosts] = arrived[:, at : at + column.shape[1]]
                at += column.shape[1]

    def one_window(self, begin: float, until: float, length: float, moment: float) -> bool:
        """All contacts from `begin` to `until`, verified; False if they had to be undone. Collective."""
        engine, log, ranks = self.engine, self.engine.log, self.ranks
        self.count += 1
        log.window[0] = self.count
        log.stamp[0] += log.changed_count[0]
        log.changed_count[0], log.border_count[0], log.fastest2[0] = 0, 0, 0.0
        before = engine.work.counts.copy()
        with self.timers("collide"):
            engine.run(begin, until, moment)
        with self.timers("ghosts"):
            moves = self.plan_moves()
            message = message_of(sendrecv(ranks, self.near, [self.changes_for(k, moves) for k in range(len(self.near))]))
            rows, directory, regions = tuple(engine.rows), tuple(self.directory), tuple(self.regions)
            wrong, differing = verify(rows, tuple(engine.lists.arrays), directory, tuple(log), regions, begin, message)
        with self.timers("agree"):
            transferred = self.transferred + int((moves.owner != ranks.rank).sum())
            wrong, fastest2, transferred = ranks.allreduce_max(np.array([wrong, log.fastest2[0], transferred], float))
        with self.timers("ghosts"):
            if wrong or np.sqrt(fastest2) * length > self.regions.bound:
                self.undo(before)
                return False
            self.transferred = int(transferred)
            if fastest2 > 0.0:
                self.longest = min(self.longest, 0.9 * self.regions.bound / np.sqrt(fastest2))
            self.accept(message, differing, moves)
        return True

    def plan_moves(self) -> Moves:
        """For the own rows that got new reference positions: who must hold them, and who owns them."""
        log, domain = self.engine.log, self.balance.decomposition
        moved = int(log.moved_count[0])
        moves = Moves(np.zeros((moved, self.directory.holders.shape[1]), np.int64), np.empty(moved, np.int64))
        tree = domain.axis, domain.cut, domain.below, domain.above
        plan_moves(self.engine.lists.arrays.reference, tuple(log), tuple(self.regions), tree, tuple(moves))
        return moves

    def changes_for(self, bit: int, moves: Moves) -> Array:
        """What happened in the window, for the known rank of a bit."""
        engine, log, d = self.engine, self.engine.log, len(self.box.length)
        parts = int(log.border_count[0]) + 3 * int(log.moved_count[0])
        message = message_of(np.empty(parts * widest_part(d)))
        rows, directory, reference = tuple(engine.rows), tuple(self.directory), engine.lists.arrays.reference
        regions = tuple(self.regions)
        size = pack_changes(rows, reference, directory, tuple(log), tuple(moves), regions, bit, message)
        return message[0][:size].copy()  # the rest of the room is given back

    def undo(self, before: Array) -> None:
        """All rows and counts as they were when the window began."""
        engine = self.engine
        engine.pending = roll_back(tuple(engine.rows), tuple(engine.log), engine.work.stale)
        engine.work.counts[:] = before
        self.redone += 1

    def accept(self, message: tuple[Array, Array], differing: Array, moves: Moves) -> None:
        """The window is right: correct the other ghosts, and let rows come, go and change owners."""
        engine, at = self.engine, 0
        rows, directory, log, regions = tuple(engine.rows), tuple(self.directory), tuple(engine.log), tuple(self.regions)
        pending = reconcile(rows, directory, log, message, differing, tuple(moves), regions, engine.work.stale)
        stale_count = np.array([pending])
        while at < len(message[0]):
            at, short = apply_moves(
                engine.axes, tuple(engine.rows), tuple(engine.lists.arrays), tuple(engine.queue), tuple(self.directory),
                regions, message, at, self.skin, engine.work.stale, stale_count,
            )  # fmt: skip
            if short > 0:
                engine.lists.enlarge(short)
            elif short < 0:
                self.grow()
        engine.pending = int(stale_count[0])

    def grow(self) -> None:
        """More rows than there is room for came near."""
        more, old = self.engine.grow(), self.directory
        old.free_count[0] = len(more)
        state = self.engine.rows.state
        here = np.flatnonzero(state[:, OWNERSHIP] != NOT_HERE)
        self.directory = doubled(old, "holders", "fields_at", "updated")._replace(
            free=np.concatenate((more, old.free)), table=table_of(state[here, ID], here, len(state))
        )

    def migrate(self) -> None:
        """The fields of particles that changed owner go to their new owners. Collective."""
        if not self.transferred:
            return
        p, ranks, fields_at = self.particles, self.ranks, self.directory.fields_at
        came = np.flatnonzero((self.engine.rows.state[:, OWNERSHIP] >= OWN) & (fields_at[:, HOLDER] != ranks.rank))
        order, counts = by_destination(fields_at[came, HOLDER], ranks.size)
        asked, of = send_rows(ranks, {"row": fields_at[:, PLACE]}, came[order], counts)
        owner = np.full(len(p), ranks.rank)
        owner[asked["row"]] = np.repeat(np.arange(ranks.size), of)
        self.row_buffers.adopt()
        self.migrated += self.row_buffers.migrate(ranks, owner)
        self.own_rows = rows_of_ids(self.directory.table, p.id).astype(np.int32)
        self.version = p.version
