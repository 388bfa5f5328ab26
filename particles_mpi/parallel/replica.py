"""All particles on every rank, for a computation in one order of time that all ranks make alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import allgather_rows
from particles_mpi.particles import MEETING, Array, Particles, field


class Replica:
    """`all_particles` holds the rows of all ranks, always the same, in any order; on one rank it is `particles` itself.

    Its version is raised where a field of `MEETING` changed that is not among the `changing` ones, those that a drift changes.
    """

    def __init__(self, particles: Particles, ranks: Communicator, changing: Sequence[str]):
        self.particles, self.ranks, self.changing = particles, ranks, changing
        self.version = -1
        self.names = [name for name in particles.arrays if field(name).ghost or name in changing]
        self.all_particles = particles if ranks.size == 1 else Particles(particles.dimension, self._allgather())

    def _allgather(self) -> dict[str, Array]:
        return allgather_rows(self.ranks, {name: self.particles.arrays[name] for name in self.names})

    def _index(self) -> None:
        """`row_of[id]`: the row of each particle in `all_particles`; made anew when rows were moved."""
        if self.version != self.all_particles.version:
            self.row_of = np.empty(int(self.all_particles.id.max(initial=-1)) + 1, np.int64)
            self.row_of[self.all_particles.id] = np.arange(len(self.all_particles))
            self.version = self.all_particles.version

    def gather(self) -> None:
        """Bring `all_particles` to the state that the owners have. Collective."""
        if self.ranks.size > 1:
            arrived = self._allgather()
            self._index()
            rows = self.row_of[arrived.pop("id")]
            for name, column in arrived.items():
                changed = name in MEETING and name not in self.changing
                if changed and not np.array_equal(self.all_particles[name][rows], column):
                    self.all_particles.version += 1
                self.all_particles[name][rows] = column

    def write_back(self) -> None:
        """Copy the changing fields of this rank's rows from `all_particles` to `particles`."""
        if self.ranks.size > 1:
            self._index()
            rows = self.row_of[self.particles.id]
            for name in self.changing:
                self.particles[name][:] = self.all_particles[name][rows]
