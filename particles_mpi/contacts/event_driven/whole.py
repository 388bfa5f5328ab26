"""The drift where space is not divided: every rank has all particles and computes all contacts, so ranks need not compare."""

import numpy as np

from particles_mpi.contacts.event_driven.engine import MOST_EXPIRIES, Engine
from particles_mpi.contacts.event_driven.event_loop import COLLISIONS, WALL_HITS
from particles_mpi.errors import StateError
from particles_mpi.neighbours.cells import bounds, order_in_space
from particles_mpi.neighbours.trajectories import fastest
from particles_mpi.neighbours.verlet_lists import contact_distance
from particles_mpi.parallel.agreement import require_finite
from particles_mpi.parallel.buffers import Replica, RowBuffers
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Array, Particles, row_dot
from particles_mpi.timers import Timers

MOST_SKINS = 1e7  # times that a particle may leave its neighbourhood in a drift, some seconds of work
CHANGING = ("position", "velocity", "contacted", "virial", "supported", "total_acceleration", "spin")  # columns, in a drift


class Whole:
    """All particles on every rank, sorted in space, and an `Engine` that holds them. A drift takes as long as on one rank."""

    def __init__(self, particles: Particles, ranks: Communicator, engine: Engine, timers: Timers):
        self.engine, self.ranks, self.timers = engine, ranks, timers
        self.replica = Replica(particles, ranks, [name for name in CHANGING if name in particles.arrays])
        self.particles = self.replica.all_particles
        self.row_buffers = RowBuffers(self.particles)
        self.version = -1
        self.searches = 0

    def drift(self, h: float, moment: float, stop: bool) -> Array:
        """Drift all particles over h; returns the (collisions, wall hits, missed) of all. Collective."""
        p, engine = self.particles, self.engine
        with self.timers("exchange"):
            self.replica.gather()
        with self.timers("pairs"):
            if self.version != p.version or engine.expiries > MOST_EXPIRIES * len(p):
                speed = fastest(p.position, p.velocity)
                self.check(speed, moment)
                self.reload(speed * h)
        with self.timers("search"):
            moved, speed = engine.start_drift(p, self.own_rows)
            self.check(speed, moment)
            if moved:
                self.reload(speed * h)
                engine.start_drift(p, self.own_rows)
            self.check_way(speed * h, moment)
            engine.work.stop[:] = stop, -1, -1
            engine.begin(h)
        with self.timers("collide"):
            engine.run(0.0, np.inf, moment)
        with self.timers("drift"):
            squeezed = engine.end_drift()
            engine.write_back(p, self.own_rows)
        with self.timers("exchange"):
            self.replica.write_back()
        return np.array([engine.work.counts[COLLISIONS], engine.work.counts[WALL_HITS], squeezed])

    def rows_of_rank(self) -> Array:
        """Return the rows of this rank's particles among those of all ranks."""
        return self.own_rows if self.ranks.size == 1 else self.replica.row_of[self.replica.particles.id]

    def check(self, speed: float, moment: float) -> None:
        """Raise where the largest speed shows that a number is not finite."""
        require_finite(self.ranks, self.particles, speed, f"t = {moment:g}")

    def check_way(self, longest: float, moment: float) -> None:
        """Raise StateError where the fastest particle leaves its neighbourhood so often in a drift that it takes minutes."""
        times = longest / self.engine.lists.skin
        if times > MOST_SKINS:
            p, square = self.particles, row_dot(self.particles.velocity, self.particles.velocity)
            name = p.id[square == square.max()].min()
            raise StateError(
                f"t = {moment:g}: particle {name} crosses {longest:.3g} in a step, {times:.1g} times as far as its list of"
                " neighbours reaches: shorten time.step"
            )

    def reload(self, way: float) -> None:
        """Sort the particles in space and load them into the engine, with new lists. `way`: the longest one in a drift."""
        p = self.particles
        self.row_buffers.adopt()
        if len(p) > 1:
            self.row_buffers.sort(order_in_space(p.position, bounds(p.position)))
        w = p.inverse_mass
        self.engine.lists.tune(p.position, p.radius, w, sum(contact_distance(p.radius, w)), way)
        self.engine.load(p, len(p))
        self.own_rows = np.arange(len(p), dtype=np.int32)
        self.version = p.version
        self.searches += 1
