"""The neighbourhood of a rank's particles: ghosts, and candidate pairs kept while nothing moved further than the skin.

Owned rows come first in every array, ghosts behind them. The particles' own position and velocity are views of the first
`owned` rows, so that forces and drift work in place on what the pair search reads.
"""

from __future__ import annotations

import numpy as np

from particles_mpi.collide.contact import NOBODY
from particles_mpi.errors import StoppedError
from particles_mpi.neighbours.cells import best_skin, bounds, candidate_pairs, cell_order, fastest, furthest, grid
from particles_mpi.parallel.balance import Balance
from particles_mpi.parallel.domain import near_box
from particles_mpi.parallel.exchange import Halo, migrate, send_rows
from particles_mpi.parallel.ranks import Ranks
from particles_mpi.particles import FIELDS, Array, Particles, shape
from particles_mpi.timers import Timers

SORT_EVERY = 8  # searches; between two sorts in space the rows keep their order, which changes slowly


class Neighbourhood:
    """Who is near whom. `search` finds out, `prepare` makes sure before a drift that it still holds.

    x, v (n, d), ids, radius, w = 1/m, s, met (n,): owned rows, then ghosts. `first`, `second`: rows of the candidate pairs.
    `room`: how far a row may be from where the search saw it (half the skin). `length` (d,): periodic box lengths, else 0.
    """

    def __init__(self, ranks: Ranks, length: Array, timers: Timers):
        self.ranks, self.length, self.timers = ranks, length, timers
        self.axes = (0,) * len(length)
        self.balance = Balance(ranks, timers)
        self.version = -1
        self.room = 0.0
        self.searches = self.migrated = self.ghost_rows = 0
        self.pairs_each = self.cut = 0.0
        self.first = np.empty(0, np.int32)

    def prepare(self, particles: Particles, h: float) -> None:
        """Before a drift over h: fresh ghosts, and pairs that reach as far as it will take any particle. Collective."""
        with self.timers("agree"):
            travel = np.inf
            if self.version == particles.version and particles.position.base is self.x:
                travel = furthest(self.axes, particles.position, self.reference, particles.velocity, h, self.length)
            travel = float(self.ranks.largest(np.array([travel]))[0])
        if not np.isfinite(travel) or travel > self.room:
            self.search(particles, h, 0.0)
        else:
            with self.timers("ghosts"):
                self.refresh(self.x, self.v)

    def search(self, particles: Particles, h: float, at_least: float) -> None:
        """Migrate, fetch ghosts and find the candidate pairs, to last some steps of h; room >= `at_least`. Collective."""
        with self.timers("migrate"):
            self.balance.update(particles, self.searches)
            arrays, gone = migrate(self.ranks, particles.arrays, self.balance.owner(particles.position), particles.dimension)
            self.migrated += gone
            if arrays is not particles.arrays:
                particles.replace(arrays)
        with self.timers("pairs"):
            skin, reach = self.choose_skin(particles, h, at_least)
            if self.searches % SORT_EVERY == 0 and len(particles) > 1:
                order, *_ = cell_order(particles.position, *grid(particles.position, reach))
                particles.replace({name: array[order] for name, array in particles.arrays.items()})
        with self.timers("ghosts"):
            self.fetch_ghosts(particles, reach)
        with self.timers("pairs"):
            self.reference = particles.position.copy()
            self.room = 0.5 * skin
            self.first, self.second = candidate_pairs(
                self.x, self.radius, self.w, self.ids, self.owned, skin, self.length, len(self.first)
            )
            capacity = len(self.first) + self.owned
            self.hits = np.empty(capacity, np.int32), np.empty(capacity, np.int32), np.empty(capacity)
        self.searches += 1

    def choose_skin(self, particles: Particles, h: float, at_least: float) -> tuple[float, float]:
        """(skin, reach = 2 R_max + skin), the same on all ranks."""
        d, x = particles.dimension, particles.position
        low, high = bounds(x)
        speed = fastest(self.axes, x, particles.velocity)
        most = self.ranks.largest(np.concatenate(([speed, particles.radius.max(initial=0.0)], high, -low)))
        if not np.isfinite(most[:2]).all():
            raise StoppedError("a position, velocity or radius is not a finite number")
        count, pairs = self.ranks.total(np.array([len(x), len(self.first)]))
        travel, diameter = float(most[0]) * h, 2.0 * float(most[1])
        extent = np.maximum(most[2 : 2 + d] + most[2 + d :], max(diameter, 1e-300)) if count else np.ones(d)
        spacing = float(np.exp(np.log(extent).mean()) / max(count, 1) ** (1.0 / d))
        self.pairs_each = pairs / max(count, 1)
        skin = best_skin(travel, diameter, self.pairs_each, self.cut or 1.0, spacing, d)
        least = max(2.01 * travel, 2.01 * at_least)
        skin = max(skin, least)
        periodic = self.length[self.length > 0.0]
        if len(periodic):
            widest = 0.5 * float(periodic.min()) - diameter
            if least > widest:
                raise StoppedError(
                    f"time.step: a particle crosses {0.5 * least:.3g} in one step, too far for the periodic box of "
                    f"{periodic.min():.3g} to tell a particle from its image; use a shorter step or a larger box"
                )
            skin = min(skin, widest)
        self.cut = diameter + skin
        return skin, self.cut

    def fetch_ghosts(self, particles: Particles, reach: float) -> None:
        """Copies of all particles within `reach` of this rank's domain, behind the owned rows. Collective."""
        ranks, names = self.ranks, [name for name in particles.arrays if FIELDS[name].ghost]
        arrays, d, self.owned = particles.arrays, particles.dimension, len(particles)
        arrived = {name: np.empty(shape(name, 0, d), FIELDS[name].dtype) for name in names}
        self.halo = None
        if ranks.size > 1:
            domain = self.balance.domain
            populated = ranks.gathered(len(particles))
            wanted = [
                near_box(particles.position, domain.lower[p], domain.upper[p], reach, self.length)
                if p != ranks.rank and populated[p]
                else np.empty(0, np.int64)
                for p in range(ranks.size)
            ]
            rows, counts = np.concatenate(wanted), np.array([len(w) for w in wanted], np.int32)
            arrived, arriving = send_rows(ranks, {n: arrays[n] for n in names}, rows, counts, d)
            self.halo = Halo(ranks, rows, counts, arriving, self.owned)
            self.ghost_rows += len(arrived["id"])
        everyone = Particles(d, {n: np.concatenate((arrays[n], arrived[n])) for n in names})
        self.ids, self.radius, self.w = everyone.id, everyone.radius, everyone.inverse_mass
        self.x, self.v = np.array(everyone.position), np.array(everyone.velocity)
        n = len(everyone)
        self.s, self.met, self.live = np.zeros(n), np.full(n, NOBODY), np.zeros(n, np.bool_)
        self.choice, self.best = np.full(n, NOBODY), np.empty((self.owned, 3))
        self.log = np.empty(self.owned, np.int64)
        self.log_x, self.log_v = np.empty((self.owned, d)), np.empty((self.owned, d))
        particles.replace({**arrays, "position": self.x[: self.owned], "velocity": self.v[: self.owned]})
        self.version = particles.version

    def refresh(self, *arrays: Array) -> None:
        """Ghost rows of the arrays, as their owners have them."""
        if self.halo:
            self.halo.refresh(*arrays)

    def refresh_legs(self) -> None:
        """Ghosts after a pass; those whose leg is a new one are live."""
        if self.halo:
            before = self.s[self.owned :].copy(), self.met[self.owned :].copy()
            self.halo.refresh(self.x, self.v, self.s, self.met)
            self.live[self.owned :] |= (before[0] != self.s[self.owned :]) | (before[1] != self.met[self.owned :])
