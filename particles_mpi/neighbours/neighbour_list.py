"""The neighbourhood of a rank's particles: ghosts, and candidates that hold until a horizon.

Owned rows come first in every array, ghosts behind them. The particles' own position and velocity are the first `owned`
rows, so that forces and drift work in place on what the pair search reads.
"""

from __future__ import annotations

from math import floor
from typing import Any

import numpy as np

from particles_mpi.errors import StoppedError
from particles_mpi.kernels.geometry import wrap
from particles_mpi.kernels.markers import NOBODY
from particles_mpi.kernels.motion import end_legs
from particles_mpi.neighbours.candidates import Candidates
from particles_mpi.neighbours.cells import GRIDDED, bounds, order_in_space, spacing
from particles_mpi.neighbours.halo import any_of, refresh, tell_choices, tell_legs, width
from particles_mpi.neighbours.halo_region import Fence, nowhere, share
from particles_mpi.neighbours.rebuild_interval import Rhythm
from particles_mpi.neighbours.trajectories import fastest
from particles_mpi.parallel.agreement import require_finite
from particles_mpi.parallel.buffers import RowBuffers
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import Halo
from particles_mpi.parallel.load_balance import LoadBalance
from particles_mpi.particles import Array, Particles, field
from particles_mpi.timers import Timers

SORT_EVERY = 2  # searches; between two sorts in space the rows keep their order, which changes slowly
SLACK = 0.2  # how far rows may get over the border of their rank's box, in paths of the fastest one
NONE = np.empty((0, 0))
TOO_MANY = 0.1  # of the rows left their tubes at once: a search of all is cheaper than one for each


class Neighbourhood:
    """Who is near whom. `search` finds out, `prepare` makes sure before a drift that it still holds, `follow` after contacts.

    x, v (n, d), ids, radius, w = 1/m, s, met (n,): owned rows, then ghosts, and so are the arrays of `fields`. `near` holds
    the candidates among them. `box`: (lower, upper, length) (d,), with length 0 where not periodic. `planes`: (point, normal)
    of the walls. `kicked`: do forces or dissipation change velocities? If not, ghosts fly on by themselves, and only contacts
    need a message.
    """

    windows_redone = None  # ranks compute windows of time in mode event only

    def __init__(
        self,
        particles: Particles,
        ranks: Communicator,
        box: tuple[Array, Array, Array],
        planes: tuple[Array, Array],
        kicked: bool,
        timers: Timers,
    ):
        self.particles, self.ranks, self.planes, self.kicked, self.timers = particles, ranks, planes, kicked, timers
        self.lower, self.upper, self.length = box
        length = self.length
        self.axes = (0,) * len(length)
        self.balance = LoadBalance(ranks, timers)
        self.version = -1
        self.halo: Any = None  # on one rank; else a Halo
        self.near: Candidates
        self.row_buffers = RowBuffers(particles)
        self.mine: Array | None = None
        self.box: Any = None  # bounds of the owned rows at the last search
        self.searches = self.migrated = self.ghost_rows = self.expected = self.pair_tests = 0
        self.rhythm = Rhythm()

    def prepare(self, h: float) -> None:
        """Before a drift over h: candidates for wherever it will take any particle. Collective."""
        particles = self.particles
        with self.timers("pairs"):
            valid = self.version == particles.version and particles.position is self.mine
            needed = 0.0 if valid and self.near.time + h <= self.near.end else np.inf
        if self.kicked:
            needed = max(needed, self.follow_kicks(h))
        with self.timers("agree"):
            needed = float(self.ranks.allreduce_max(needed)[0])
        if needed:
            self.search(h, needed if np.isfinite(needed) else 0.0)

    def follow_kicks(self, h: float) -> float:
        """Where forces change velocities: fresh ghosts, and candidates for the rows that are bent out of their tubes.

        Returns 0, or what a search is needed for.
        """
        if self.halo:
            with self.timers("ghosts"):
                refresh(self.halo, self.x, self.v, self.fields.get("total_acceleration", NONE))
        if not self.searches:
            return np.inf
        with self.timers("pairs"):
            strays = self.near.strays(h)
            if len(strays) > TOO_MANY * len(self.x) + 10:
                return np.inf
            return self.near.follow(strays, self.s, h)

    def search(self, h: float, at_least: float) -> None:
        """Migrate, fetch ghosts, find candidates to last some steps of h; `at_least`: how far rows must get. Collective."""
        particles = self.particles
        with self.timers("migrate"):
            self.balance.update(particles, self.searches)
            self.row_buffers.adopt()
            self.migrated += self.row_buffers.migrate(self.ranks, self.balance.decomposition.owner(particles.position))
        with self.timers("agree"):
            end, half, bound, slack = self.horizon(h, at_least)
        with self.timers("pairs"):
            if self.searches % SORT_EVERY == 0 and len(particles) > 1:
                self.sort()
        with self.timers("ghosts"):
            fence = self.fetch_ghosts(end, half, slack)
        with self.timers("pairs"):
            state = self.x, self.v, self.radius, self.w, self.ids
            self.near = Candidates(state, self.owned, self.length, self.planes, end, half, bound, fence, self.expected)
            self.expected = self.near.pairs
        self.searches += 1

    def horizon(self, h: float, at_least: float) -> tuple[float, float, float, float]:
        """(end, half, bound, slack) of the next candidates, the same on all ranks."""
        particles = self.particles
        d, x, n = particles.dimension, particles.position, len(particles)
        self.box = low, high = bounds(x)
        work = self.rhythm.work(len(self.x), self.near.tests, self.near.asked) if self.searches else 0.0
        radius = particles.radius
        mine = np.array([n, fastest(x, particles.velocity), radius.max(initial=0.0), radius.sum(), work, *low, *high])
        table = self.ranks.allgather_array(mine)  # of all in one message
        total, speed, largest = table[:, 0].sum(), table[:, 1].max(), 2.0 * float(table[:, 2].max())
        require_finite(self.ranks, particles, table[:, 1:3], "in a drift")
        mean = 2.0 * float(table[:, 3].sum()) / max(total, 1.0)
        apart = spacing(table[:, 5 : 5 + d].min(axis=0), table[:, 5 + d :].max(axis=0), int(total)) if total else 1.0
        half = 0.5 * max(0.25 * mean, 0.05 * apart)
        travel = float(speed) * h
        steps = self.rhythm.next(float(table[:, 4].sum()), 0.5 * apart / travel if travel > 0.0 else 50.0)
        slack = max(SLACK * travel * steps + travel + 2.0 * half, 1.01 * at_least)
        bound = np.inf
        # Relative paths up to 4 bound long: on a gridded axis of length L one image of a pair at most may meet, on the
        # others it must be the nearest one all the time.
        periodic = np.flatnonzero(self.length)
        if len(periodic):
            widest = float(((0.5 * self.length - largest) * np.where(np.arange(d) < GRIDDED, 0.5, 0.25))[periodic].min()) * (
                1.0 - 1e-9
            )
            least = max(travel, at_least - half)
            if not least < widest:
                raise StoppedError(
                    f"time.step: a particle crosses {least:.3g} in one step, too far for a periodic box of "
                    f"{self.length[periodic].min():.3g} to tell a particle from its image; use a shorter step or a larger box"
                )
            half = min(half, 0.5 * (widest - least))
            bound = widest - half
            if travel > 0.0:
                steps = max(1, min(steps, floor((bound - half) / travel)))
        return steps * h * (1.0 + 1e-9), half, bound, slack

    def sort(self) -> None:
        """Rows that are near in space, near in memory."""
        self.row_buffers.sort(order_in_space(self.particles.position, self.box))

    def fetch_ghosts(self, end: float, half: float, slack: float) -> Fence:
        """Copies of all particles that may meet this rank's, behind the owned rows. Collective."""
        particles = self.particles
        ranks, d, self.owned = self.ranks, particles.dimension, len(particles)
        names = [name for name in particles.arrays if field(name).ghost]
        everyone = {name: particles.arrays[name] for name in names}
        self.halo, fence = None, nowhere(d)
        if ranks.size > 1:
            state = particles.position, particles.velocity, particles.radius
            fence, rows, counts, arrived, arriving = share(ranks, everyone, state, slack, end, half, self.length)
            self.halo = Halo(ranks, rows, counts, arriving, self.owned, width(d))
            self.shared = np.zeros(self.owned + int(arriving.sum()), np.bool_)
            self.shared[rows] = self.shared[self.owned :] = True
            self.ghost_rows += len(arrived["id"])
            everyone = self.row_buffers.append_ghosts(arrived)
        self.x, self.v, self.ids, self.radius = (everyone[n] for n in ("position", "velocity", "id", "radius"))
        self.w, self.fields = Particles(d, everyone).inverse_mass, everyone
        n = len(self.x)
        self.s, self.met, self.live = np.zeros(n), np.full(n, NOBODY), np.zeros(n, np.bool_)
        self.choice, self.best = np.full(n, NOBODY), np.empty((self.owned, 3))
        self.touched, self.touches = np.empty(n, np.int32), 0
        self.log, self.logged = np.empty(self.owned, np.int32), 0
        self.log_x, self.log_v = np.empty((self.owned, d)), np.empty((self.owned, d))
        self.mine = particles.position
        self.version = particles.version
        return fence

    def concern_others(self, hits: tuple[Array, Array, Array]) -> bool:
        """Is a row among the hits that other ranks hold too?"""
        return self.halo is not None and any_of(self.shared, hits[0], hits[1])

    def tell_choices(self, hits: tuple[Array, Array, Array]) -> None:
        """The choices of this rank's rows to all who hold them as ghosts."""
        tell_choices(self.halo, self.choice, hits[0], hits[1], self.near.marked)

    def tell_legs(self) -> None:
        """Ghosts after a pass, as their owners have them; those whose leg is a new one are live."""
        self.choice[self.owned :] = NOBODY
        self.touches = tell_legs(self.halo, self.live, self.x, self.v, self.s, self.met, self.touched, self.touches)

    def follow(self, h: float) -> float:
        """After a pass in the drift over h: candidates for the legs of the touched rows.

        Returns 0, or how far a row gets if that is further than the candidates may reach.
        """
        rows = self.near.turned(self.touched[: self.touches].copy(), self.s)
        return self.near.follow(rows, self.s, h)

    def forget_live(self) -> None:
        """No row is live."""
        self.live[self.touched[: self.touches]] = False
        self.touches = 0

    def note(self, rows: Array) -> None:
        """Owned rows that begin new legs without having met anyone before, each once."""
        fresh = rows[self.met[rows] == NOBODY]
        self.log[self.logged : self.logged + len(fresh)] = fresh
        self.logged += len(fresh)

    def forget_legs(self) -> None:
        """All legs begin at time 0, and no one has met anyone."""
        self.forget_live()
        for rows in (self.log[: self.logged], slice(self.owned, None)):
            self.s[rows] = 0.0
            self.met[rows] = NOBODY
        self.logged = 0

    def advance(self, h: float) -> None:
        """From the starts of the last legs to the end of the drift over h, and back into a periodic box."""
        end_legs(self.axes, self.x, self.v, self.s, h)
        self.forget_legs()
        if self.length.any():
            wrap(self.x, self.lower, self.upper, self.length)
        self.near.time += h
        self.rhythm.step(self.near.pairs)
        self.pair_tests += self.near.pairs

    def distrust(self) -> None:
        """Ghosts are not what their owners have: search before the next drift."""
        self.version = -1
