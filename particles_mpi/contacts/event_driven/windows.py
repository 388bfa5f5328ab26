"""Mode `event` on several ranks: each computes its part of space a short window of time ahead, and ranks verify one another.

Space is divided into regions. A rank owns the particles whose reference positions are in its region, has those near it as ghosts,
and computes all contacts among these rows in the window as if there were no others. That is right for its own particles unless
one of them touched, or should have touched, a ghost that is wrong here because particles beyond the ghosts are unknown. So owners
send what happened to their rows after a window. If a ghost has another trajectory hash at its owner, and was so near to an own
particle that the two can have touched, all ranks undo the window and compute half of it. Otherwise the results of all owners
together are the exact run (contacts/README.md has the proof), and wrong ghosts further out are corrected. Windows leave no trace
in the bits.
"""

import numpy as np

from particles_mpi.contacts.event_driven.arrivals import apply_moves, reconcile, roll_back, verify
from particles_mpi.contacts.event_driven.engine import MOST_EXPIRIES, Engine
from particles_mpi.contacts.event_driven.event_loop import COLLISIONS, WALL_HITS
from particles_mpi.contacts.event_driven.messages import message_of
from particles_mpi.contacts.event_driven.partition import Partition
from particles_mpi.contacts.event_driven.regions import Moves
from particles_mpi.kernels.geometry import Box
from particles_mpi.neighbours.trajectories import fastest
from particles_mpi.parallel.agreement import require_finite
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import sendrecv
from particles_mpi.particles import Array, Particles
from particles_mpi.timers import Timers

LEAST_DEPTH, MOST_DEPTH = 1.0, 4.0  # of the ghosts, which is fitted: then windows need not be shorter on more ranks
DEEPER, MOST_REDONE = 0.2, 0.02  # added if more than this part of the windows was redone
SHALLOWER, ENOUGH = 0.1, 100  # taken off after so many windows of which none was
FASTER, SLOWER = 1.015, 0.6  # what success and failure do to the length of a window: in balance about 3 % fail
FIRST_WINDOW, GROWING = 0.25, 1.2  # of the longest window: the first one; and how it grows until one fails
LONGEST_WINDOW = 0.9  # of the time in which the fastest particle gets as far as the regions allow
LEAST_WINDOW = 1e-3  # of the longest window: with shorter ones it is no use
MOST_HALVINGS = 8  # of a window, each of half the length; then contacts follow one another in no time (touching spheres)
WORTH = 10  # contacts a window and rank, or windows are not worth their messages
CHEAP = 8  # windows in a step, which cost less than a drift without them
UNTRIED = 1000  # windows a step at most where the number of contacts is not known yet


class Windows:
    """Drifts the particles of all ranks; `count`: how many windows there were; `redone`: how many of these were undone.

    `always`: use windows even where they do not pay, for tests and to compile all kernels.
    """

    events: float

    def __init__(self, particles: Particles, ranks: Communicator, engine: Engine, box: Box, timers: Timers):
        self.particles, self.ranks, self.engine, self.timers = particles, ranks, engine, timers
        self.partition = Partition(particles, ranks, engine, box, timers)
        self.count = self.redone = 0
        self.always = False
        self.length = 0.0  # of the next one
        self.growing = True
        self.verified = 0, 0  # `count` and `redone` when the depth was last fitted

    @property
    def searches(self) -> int:
        return self.partition.searches

    def drift(self, h: float, moment: float) -> Array | None:
        """Return the (collisions, wall hits, missed) of this rank; None if it cannot be done, with no change. Collective."""
        engine, p = self.engine, self.particles
        with self.timers("agree"):
            speed = self.prepare(moment)
        if self.partition.one_holds_most and not self.always:
            return None
        self.longest = LONGEST_WINDOW * self.partition.regions.bound / speed if speed > 0.0 else np.inf
        if h / self.longest > (max(self.events / WORTH, CHEAP) if self.events else UNTRIED) and not self.always:
            return None
        self.length = min(self.length or FIRST_WINDOW * self.longest, self.longest)
        with self.timers("ghosts"):
            self.partition.send_motion()
        with self.timers("search"):
            engine.begin(h)
            engine.work.any_squeezed[0] = True  # a squeezed ghost may come by message
        begin = end = 0.0
        tries = self.transferred = 0
        while begin < h:
            end = begin + self.length if tries == 0 else begin + 0.5 * (min(end, h) - begin)
            last = end >= h
            if self.one_window(begin, np.inf if last else end, min(end, h) - begin, moment):
                if tries == 0:
                    self.length = min(self.length * (GROWING if self.growing else FASTER), self.longest)
                begin, tries = end, 0
            else:
                self.length *= SLOWER if tries == 0 else 1.0  # one contact may need many tries
                self.growing = False
                tries += 1
                if tries > MOST_HALVINGS or self.length < LEAST_WINDOW * self.longest:
                    self.partition.version = -1  # rows of the engine mean nothing now; those of the particles were not touched
                    self.length, self.growing = 0.0, True
                    return None
        with self.timers("drift"):
            squeezed = engine.end_drift()
        with self.timers("migrate"):
            if self.transferred:
                self.partition.migrate()
            engine.write_back(p, self.partition.own_rows)
        return np.array([engine.work.counts[COLLISIONS], engine.work.counts[WALL_HITS], squeezed])

    def prepare(self, moment: float) -> float:
        """Start own rows, after `redistribute` where it is due; returns the largest speed of all ranks. Collective."""
        p, engine = self.particles, self.engine
        while True:
            outdated = self.partition.version != p.version
            if outdated:
                speed = fastest(p.position, p.velocity)
            else:
                moved, speed = engine.start_drift(p, self.partition.own_rows)
                outdated = moved or engine.expiries > MOST_EXPIRIES * len(engine.rows.segment) or self.redone_often()
            speed = speed if speed < np.inf else np.inf  # or it is not a number
            outdated, speed, self.events = self.ranks.allreduce_max(np.array([outdated, speed, engine.events], float))
            require_finite(self.ranks, p, speed, f"t = {moment:g}")
            if not outdated:
                break
            self.fit_depth()
            self.partition.redistribute()
        self.partition.locate_fields()
        return float(speed)

    def redone_often(self) -> bool:
        """Were too many windows redone since the depth of the ghosts was last fitted?"""
        count, redone = self.count - self.verified[0], self.redone - self.verified[1]
        return redone > MOST_REDONE * max(count, ENOUGH) and self.partition.depth < MOST_DEPTH

    def fit_depth(self) -> None:
        """Make ghosts deeper where many windows were redone, and less deep where none was or there are too many ghosts."""
        if self.redone_often():
            self.partition.depth += DEEPER
        elif self.partition.one_holds_most or (self.redone == self.verified[1] and self.count > self.verified[0] + ENOUGH):
            self.partition.depth = max(self.partition.depth - SHALLOWER, LEAST_DEPTH)
        self.verified = self.count, self.redone

    def one_window(self, begin: float, until: float, length: float, moment: float) -> bool:
        """Compute and verify all contacts from `begin` to `until`; False if they had to be undone. Collective."""
        engine, log, ranks, part = self.engine, self.engine.log, self.ranks, self.partition
        self.count += 1
        log.window[0] = self.count
        log.stamp[0] += log.changed_count[0]
        log.changed_count[0], log.border_count[0], log.fastest2[0] = 0, 0, 0.0
        before = engine.work.counts.copy()
        with self.timers("collide"):
            engine.run(begin, until, moment)
        with self.timers("ghosts"):
            moves = part.plan_moves()
            changes = [part.changes_for(bit, moves) for bit in range(len(part.neighbours))]
            message = message_of(sendrecv(ranks, part.neighbours, changes))  # what happened elsewhere to rows that are here too
            rows, directory, regions = tuple(engine.rows), tuple(part.directory), tuple(part.regions)
            wrong, differing = verify(rows, tuple(engine.lists.arrays), directory, tuple(log), regions, begin, message)
        with self.timers("agree"):
            transferred = self.transferred + int((moves.owner != ranks.rank).sum())
            wrong, fastest2, transferred = ranks.allreduce_max(np.array([wrong, log.fastest2[0], transferred], float))
        with self.timers("ghosts"):
            if wrong or np.sqrt(fastest2) * length > part.regions.bound:
                self.undo(before)
                return False
            self.transferred = int(transferred)
            if fastest2 > 0.0:
                self.longest = min(self.longest, LONGEST_WINDOW * part.regions.bound / np.sqrt(fastest2))
            self.accept(message, differing, moves)
        return True

    def undo(self, before: Array) -> None:
        """Set all rows and counts back to the start of the window."""
        engine = self.engine
        engine.pending = roll_back(tuple(engine.rows), tuple(engine.log), engine.work.stale)
        engine.work.counts[:] = before
        self.redone += 1

    def accept(self, message: tuple[Array, Array], differing: Array, moves: Moves) -> None:
        """Accept a window that is right: correct the other ghosts, and let rows come, go and change owners."""
        engine, part, at = self.engine, self.partition, 0
        rows, directory, regions = tuple(engine.rows), tuple(part.directory), tuple(part.regions)
        pending = reconcile(rows, directory, tuple(engine.log), message, differing, tuple(moves), regions, engine.work.stale)
        stale_count = np.array([pending])
        while at < len(message[0]):
            at, short = apply_moves(
                engine.axes, tuple(engine.rows), tuple(engine.lists.arrays), tuple(engine.queue), tuple(part.directory),
                regions, message, at, part.skin, engine.work.stale, stale_count,
            )  # fmt: skip
            if short > 0:
                engine.lists.enlarge(short)
            elif short < 0:
                part.grow()
        engine.pending = int(stale_count[0])
