"""All particles on every rank: for what is computed in one order of time, by all ranks alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import allgather_rows
from particles_mpi.particles import MEETING, Particles, field


class Replica:
    """`everyone` holds the rows of all ranks, in any order; on one rank it is `particles` itself.

    `gather` brings all rows up to date, `give_back` the `changing` fields of this rank's own rows. Who is there stays the
    same; `everyone.version` rises where a field changed that no drift changes (`MEETING`).
    """

    def __init__(self, particles: Particles, ranks: Communicator, changing: Sequence[str]):
        self.particles, self.ranks, self.changing = particles, ranks, changing
        self.everyone = particles
        self.version = -1
        self.names = [name for name in particles.arrays if field(name).ghost or name in changing]
        if ranks.size > 1:
            self.everyone = Particles(particles.dimension, self._of_all())

    def _of_all(self) -> dict[str, np.ndarray]:
        return allgather_rows(self.ranks, {name: self.particles.arrays[name] for name in self.names})

    def _find(self) -> None:
        """Where the row of each id stands among everyone; anew when rows were moved."""
        if self.version != self.everyone.version:
            self.row_of = np.empty(int(self.everyone.id.max(initial=-1)) + 1, np.int64)
            self.row_of[self.everyone.id] = np.arange(len(self.everyone))
            self.version = self.everyone.version

    def gather(self) -> None:
        """`everyone` as the owners have them. Collective."""
        if self.ranks.size > 1:
            arrived = self._of_all()
            self._find()
            rows = self.row_of[arrived.pop("id")]
            for name, column in arrived.items():
                if name in MEETING and name not in self.changing and not np.array_equal(self.everyone[name][rows], column):
                    self.everyone.version += 1
                self.everyone[name][rows] = column

    def give_back(self) -> None:
        """This rank's rows as they are among everyone."""
        if self.ranks.size > 1:
            self._find()
            rows = self.row_of[self.particles.id]
            for name in self.changing:
                self.particles[name][:] = self.everyone[name][rows]
