"""The neighbourhood of a rank's particles: ghosts, and candidates that hold until a horizon.

Owned rows come first in every array, ghosts behind them. The particles' own position and velocity are the first `owned`
rows, so that forces and drift work in place on what the pair search reads.
"""

from math import floor
from typing import Any

import numpy as np

from particles_mpi.errors import StoppedError
from particles_mpi.kernels.geometry import Box, wrap
from particles_mpi.kernels.markers import NO_PARTNER
from particles_mpi.kernels.motion import Segments, end_segments
from particles_mpi.neighbours.candidates import Candidates, Hits
from particles_mpi.neighbours.cells import GRIDDED, bounds, order_in_space, spacing, too_narrow
from particles_mpi.neighbours.halo_region import HaloRegion, Margins, everywhere, fetch_near_rows
from particles_mpi.neighbours.pair_search import LEAVING, TURNED
from particles_mpi.neighbours.pass_messages import OWN_ONLY, Active, message_width, rows_concerned
from particles_mpi.neighbours.rebuild_interval import RebuildTuner
from particles_mpi.neighbours.trajectories import Horizon, Spheres, fastest
from particles_mpi.parallel.agreement import require_finite
from particles_mpi.parallel.buffers import RowBuffers
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.decomposition import LoadBalance
from particles_mpi.parallel.halo import Halo
from particles_mpi.particles import Array, Particles, field
from particles_mpi.timers import Timers

SORT_EVERY = 2  # searches; between two sorts in space the rows keep their order, which changes slowly
CLEARANCE = 0.3  # how near rows may be to the space of a rank that does not hold them, in paths of the fastest one
TOO_MANY = 0.1  # of the rows left their paths at once: a search of all is cheaper than one for each


class Neighbourhood:
    """Ghosts and candidates of this rank: `prepare` renews them before a drift where needed, `follow` after contacts.

    `segments`, `spheres` and the arrays of `fields` hold the owned rows, then ghosts; x, v are those of `segments`, and `rows`
    are both as plain tuples, for kernels. `spin`, `inverse_inertia`: no row where spheres are smooth. `active`: rows whose
    contacts are sought in the next pass. `candidates`: the pairs among all these that can touch. `planes`: as a plain tuple.
    `kicked`: do forces or dissipation change velocities? If not, ghosts follow their paths, and only contacts need a message.
    """

    divided = True  # each rank computes its part of space
    window_counts = 0, 0  # there are windows of time in mode event only

    def __init__(
        self, particles: Particles, ranks: Communicator, box: Box, planes: tuple[Any, ...], kicked: bool, timers: Timers
    ):
        self.particles, self.ranks, self.planes, self.kicked, self.timers = particles, ranks, planes, kicked, timers
        self.box, self.length = box, box.length
        self.axes = (0,) * len(self.length)
        self.balance = LoadBalance(ranks, timers)
        self.version = -1
        self.halo: Any = None  # on one rank; else a Halo
        self.candidates: Candidates
        self.row_buffers = RowBuffers(particles)
        self.position: Array | None = None  # the particles' own array at the last search
        self.searches = self.migrated = self.ghost_rows = self.expected = self.pair_tests = 0
        self.tuner = RebuildTuner()
        self.steps_ahead = 0.0  # for which the last candidates were found, the same on all ranks: a row may shorten it on one
        self.work = 0.0  # of the last search, in the tuner's units

    def prepare(self, h: float) -> None:
        """Make sure, before a drift over h, that candidates hold for all positions to which it takes particles. Collective."""
        particles = self.particles
        with self.timers("pairs"):
            known = self.version == particles.version and particles.position is self.position
            needed = 0.0 if known and self.candidates.time + h <= self.candidates.horizon.valid_until else np.inf
        if self.kicked:
            needed = max(needed, self.follow_kicks(h))
        with self.timers("agree"):
            needed = self.ranks.largest(needed)[0]
        if needed:
            self.search(h, needed if np.isfinite(needed) else 0.0)

    def follow_kicks(self, h: float) -> float:
        """After forces have changed velocities: refresh ghosts, and find candidates for rows that are bent away from their paths.

        Returns 0, or how far a row gets if that is further than the candidates may reach; inf if all must be searched.
        """
        if self.halo:
            with self.timers("ghosts"):
                more = [self.fields[name] for name in ("total_acceleration", "spin") if name in self.fields]
                self.halo.refresh(self.x, self.v, *more)
        if not self.searches:
            return np.inf
        with self.timers("pairs"):
            leaving = self.candidates.leaving(h)
            if len(leaving) > TOO_MANY * len(self.x) + 10:
                return np.inf
            return self.candidates.follow(leaving, LEAVING, self.segments, h)

    def search(self, h: float, at_least: float) -> None:
        """Send rows to their owners, fetch ghosts, and find candidates that hold for some steps of h. Collective.

        `at_least`: how far a row got that made the present candidates invalid, 0 if none did.
        """
        particles = self.particles
        known = self.version != -1
        shortest = known and self.candidates.time == 0.0 and self.steps_ahead == 1
        way = at_least - self.candidates.horizon.tolerance if known else 0.0
        self.forget_candidates()
        with self.timers("migrate"):
            self.balance.update(particles, self.searches)
            self.row_buffers.adopt()
            self.migrated += self.row_buffers.migrate(self.ranks, self.balance.decomposition.owner(particles.position))
        with self.timers("agree"):
            extent = bounds(particles.position)
            horizon, margins = self.horizon(h, at_least, way, shortest, extent)
        with self.timers("pairs"):
            if self.searches % SORT_EVERY == 0 and len(particles) > 1:
                self.row_buffers.sort(order_in_space(particles.position, extent))
        with self.timers("ghosts"):
            region = self.fetch_ghosts(horizon, margins)
        with self.timers("pairs"):
            self.candidates = Candidates(self.x, self.v, self.spheres, self.length, self.planes, horizon, region, self.expected)
            self.expected = self.candidates.pair_count
        self.searches += 1

    def forget_candidates(self) -> None:
        """Free the memory of the last search before the next one takes its own."""
        if self.searches:
            self.work = self.tuner.work(len(self.x), self.candidates.tests, self.candidates.seekers)
            del self.candidates, self.segments, self.active, self.rows, self.spheres, self.fields, self.x, self.v
            del self.spin, self.inverse_inertia
        self.version = -1

    def horizon(
        self, h: float, at_least: float, way: float, shortest: bool, extent: tuple[Array, Array]
    ) -> tuple[Horizon, Margins]:
        """Return horizon and margins of the next candidates, the same on all ranks; `extent`: bounds of this rank's particles.

        `at_least`: see `search`; `way`: the same without the tolerance of the candidates. If a periodic box is too narrow for it,
        candidates may be for this drift alone, from the present positions, unless the last ones already were (`shortest`).
        """
        particles = self.particles
        d, x, n = particles.dimension, particles.position, len(particles)
        radius = particles.radius
        largest = radius.max(initial=0.0), radius.max(initial=0.0, where=particles.fixed == 0)
        mine = np.array([n, radius.sum(), self.work, fastest(x, particles.velocity), *largest])
        total, radii, work, *checked = self.ranks.allreduce_sum(mine)  # a sum is not a number where one of the numbers is none
        require_finite(self.ranks, particles, checked, "in a drift")
        ends = self.ranks.allreduce_max(np.concatenate((mine[3:], -extent[0], extent[1])))
        speed, contact, lowest, highest = ends[0], float(ends[1] + ends[2]), -ends[3 : 3 + d], ends[3 + d :]
        mean = 2.0 * float(radii) / max(total, 1.0)
        apart = spacing(lowest, highest, int(total)) if total else 1.0
        tolerance = 0.5 * max(0.25 * mean, 0.05 * apart)
        travel = float(speed) * h
        steps = self.tuner.next(float(work), 0.5 * apart / travel if travel > 0.0 else 50.0)
        bound = np.inf
        # Relative paths up to 4 bound long: on a gridded axis of length L one image of a pair at most may meet, on the
        # others it must be the nearest one all the time.
        periodic = np.flatnonzero(self.length)
        if len(periodic):
            part = np.where(np.arange(d) < GRIDDED, 0.5, 0.25)
            if not 2.0 * contact < self.length[periodic].min():
                raise too_narrow(self.length, contact)
            widest = float(((0.5 * self.length - contact) * part)[periodic].min()) * (1.0 - 1e-9)
            least = max(travel, way)
            if travel < widest <= least and not shortest:
                least, steps = travel, 1
            if not least < widest:
                raise StoppedError(
                    f"time.step: a particle crosses {least:.3g} in one step, too far to tell particles from their images in a "
                    f"periodic box of {self.length[periodic].min():.3g}; use a shorter step or a larger box"
                )
            tolerance = min(tolerance, 0.5 * (widest - least))
            bound = widest - tolerance
            if travel > 0.0:
                steps = max(1, min(steps, floor((bound - tolerance) / travel)))
        self.steps_ahead = steps
        slack = max(travel + 2.0 * tolerance, 1.01 * at_least)  # what a turned row may take in one drift
        margins = Margins(slack, slack + CLEARANCE * travel * steps)
        return Horizon(steps * h * (1.0 + 1e-9), tolerance, bound), margins

    def fetch_ghosts(self, horizon: Horizon, margins: Margins) -> HaloRegion:
        """Fetch copies of all particles that may meet this rank's, and put them behind the owned rows. Collective."""
        particles = self.particles
        ranks, d, owned = self.ranks, particles.dimension, len(particles)
        columns = {name: column for name, column in particles.arrays.items() if field(name).ghost}
        self.halo, region = None, everywhere(d)
        if ranks.size > 1:
            state = particles.position, particles.velocity, particles.radius
            region, rows, counts, arrived, arriving = fetch_near_rows(ranks, columns, state, horizon, self.length, margins)
            self.halo = Halo(ranks, rows, counts, arriving, owned, message_width(d))
            self.shared = np.zeros(owned + int(arriving.sum()), np.bool_)
            self.shared[rows] = self.shared[owned:] = True
            self.ghost_rows += len(arrived["id"])
            columns = self.row_buffers.append_ghosts(arrived)
        self.fields, self.x, self.v = columns, columns["position"], columns["velocity"]
        known = Particles(d, columns)
        self.spheres = Spheres(columns["radius"], known.inverse_mass, columns["id"], owned)
        self.spin, self.inverse_inertia = columns.get("spin", np.empty((0, 1))), known.inverse_inertia
        n = len(self.x)
        self.segments = Segments(self.x, self.v, np.zeros(n), np.full(n, NO_PARTNER))
        self.active = Active(np.zeros(n, np.bool_), np.empty(n, np.int32), np.zeros(1, np.int64))
        self.rows = tuple(self.segments), tuple(self.spheres)
        self.position, self.version = particles.position, particles.version
        return region

    def concerned(self, hits: Hits) -> int:
        """Which rows the hits are about: OWN_ONLY, SHARED_ROWS or ACROSS."""
        return int(rows_concerned(self.shared, self.spheres.owned, hits.first, hits.second)) if self.halo else OWN_ONLY

    def follow(self, h: float) -> float:
        """Find, after a pass in the drift over h, candidates for the segments of the active rows.

        Returns 0, or how far a row gets if that is further than the candidates may reach.
        """
        rows = self.active.rows[: self.active.number[0]].copy()
        return self.candidates.follow(rows, TURNED, self.segments, h)

    def forget_segments(self, changed: Array) -> None:
        """Set all segments to begin at time 0, without a last partner, and no row active; `changed`: owned rows with contacts."""
        self.active.flag[self.active.rows[: self.active.number[0]]] = False
        self.active.number[0] = 0
        for rows in (changed, slice(self.spheres.owned, None)):
            self.segments.start[rows] = 0.0
            self.segments.last_partner[rows] = NO_PARTNER

    def advance(self, h: float) -> None:
        """Move all rows from the starts of their last segments to the end of the drift over h, and into a periodic box."""
        end_segments(self.axes, self.x, self.v, self.segments.start, h)
        if self.length.any():
            wrap(self.x, *self.box)
        self.candidates.time += h
        self.tuner.step(self.candidates.pair_count)
        self.pair_tests += self.candidates.pair_count

    def pass_by(self, h: float, drifts: int) -> None:
        """Take note of drifts over h that were done elsewhere without any contact: candidates still hold, but ghosts do not."""
        if self.halo:
            self.end_candidates()
        elif self.version != -1:
            self.candidates.time += drifts * h
            self.tuner.lasted += drifts

    def end_candidates(self) -> None:
        """End the candidates, if there are any: they serve this one more step, which is done by other means."""
        if self.version != -1:
            self.tuner.step(self.candidates.pair_count)
        self.version = -1  # ghosts are not what their owners have: search before the next drift
