"""When to cut space anew: as soon as the time lost to imbalance since the last cut exceeds what a cut costs."""

from __future__ import annotations

from time import perf_counter

import numpy as np

from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.decomposition import Decomposition, bisect
from particles_mpi.particles import Array, Particles
from particles_mpi.timers import Timers

LOOK_EVERY = 8  # searches for neighbours between two comparisons of the ranks' times
NOISE = 0.05  # of the mean time: differences between ranks with equal work on a shared machine
MOVING = 10.0  # cost of a new decomposition, in units of the time for the cuts: rows have to move too
WORK = ("search", "collide", "drift", "pairs")  # phases in which a rank works, and does not wait for others


class LoadBalance:
    """Holds the domain decomposition. Which rank owns a particle never changes a result, so measured times may decide."""

    def __init__(self, ranks: Communicator, timers: Timers):
        self.ranks, self.timers = ranks, timers
        self.decomposition: Decomposition
        self.cuts = 0
        self.cost = self.lost = self.worked = 0.0

    def update(self, particles: Particles, searches: int) -> None:
        """Cut space for the first time, or again if that saves time; `searches`: for neighbours, so far. Collective."""
        if self.cuts == 0:
            self.cut(particles.position, 1.0)
        elif self.ranks.size > 1 and searches % LOOK_EVERY == 0:
            worked = sum(self.timers.seconds.get(phase, 0.0) for phase in WORK)
            mine = worked - self.worked
            self.worked = worked
            times = np.array(self.ranks.allgather(mine))
            self.lost += float(times.max() - times.mean()) - NOISE * float(times.mean())
            self.lost = max(self.lost, 0.0)
            if self.lost > self.cost:
                each = mine / max(len(particles), 1)
                typical = float(times.sum()) / max(int(self.ranks.allreduce_sum(len(particles))[0]), 1)
                self.cut(particles.position, float(np.clip(each / typical, 0.5, 2.0)) if typical > 0.0 else 1.0)

    def cut(self, x: Array, weight: float) -> None:
        """A new decomposition, from this rank's positions x (n, d), each of which means `weight` units of work. Collective."""
        begin = perf_counter()
        self.decomposition = bisect(self.ranks, x, weight)
        self.cost = float(self.ranks.allreduce_max(perf_counter() - begin)[0]) * MOVING
        self.lost = 0.0
        self.cuts += 1
