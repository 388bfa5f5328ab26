"""The rows of a rank in arrays with spare space: rows arrive, leave, are sorted and get ghosts without new arrays."""

from __future__ import annotations

import numpy as np

from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import by_destination, send_rows
from particles_mpi.particles import Array, Particles

GROWTH = 1.2  # of the rows that are needed: how many new arrays have space for


class RowBuffers:
    """Holds the arrays of `particles`, which shows their first `count` rows. Behind these ghosts may stand."""

    def __init__(self, particles: Particles):
        self.particles = particles
        self.buffers: dict[str, Array] = {}
        self.spare: dict[str, Array] = {}

    @property
    def count(self) -> int:
        return len(self.particles)

    def adopt(self) -> None:
        """Copy the arrays of `particles` into the buffers, if somebody else has put new ones there."""
        arrays = self.particles.arrays
        if any(array.base is not self.buffers.get(name, self) for name, array in arrays.items()):
            self.buffers = {name: np.array(array, order="C") for name, array in arrays.items()}
            self.spare = {name: np.empty_like(array) for name, array in self.buffers.items()}
            self.show(len(self.buffers["id"]))

    def show(self, count: int) -> None:
        """From here on the first `count` rows are the particles."""
        self.particles.replace({name: array[:count] for name, array in self.buffers.items()})

    def reserve(self, rows: int) -> None:
        """Make space for so many rows; the particles keep theirs."""
        if rows <= len(self.buffers["id"]):
            return
        n, space = self.count, int(rows * GROWTH) + 1
        for name, old in self.buffers.items():
            self.buffers[name], self.spare[name] = (np.empty((space, *old.shape[1:]), old.dtype) for _ in range(2))
            self.buffers[name][:n] = old[:n]
        self.show(n)

    def sort(self, order: Array) -> None:
        """Put the rows into another order: row i becomes what row order[i] was."""
        n = len(order)
        for name, old in self.buffers.items():
            new = self.spare[name]
            old[:n].take(order, axis=0, out=new[:n], mode="clip")
            self.buffers[name], self.spare[name] = new, old
        self.show(n)

    def migrate(self, ranks: Communicator, owner: Array) -> int:
        """Send every row to its owner (n,), any rank; returns how many rows this rank sent away. Collective."""
        if ranks.size == 1:
            return 0
        n, leaving = self.count, np.flatnonzero(owner != ranks.rank)
        if ranks.allreduce_sum(len(leaving))[0] == 0:
            return 0
        order, counts = by_destination(owner[leaving], ranks.size)
        arrived, _ = send_rows(ranks, self.particles.arrays, leaving[order], counts)
        came = len(arrived["id"])
        after = n - len(leaving) + came
        self.reserve(after)
        # Arriving rows take the places of those that left; if fewer arrive, the last rows fill the other places.
        places, left = np.concatenate((leaving[:came], np.arange(n, after))), leaving[came:]
        holes, last = left[left < after], np.setdiff1d(np.arange(after, n), left, assume_unique=True)
        for name, array in self.buffers.items():
            array[places] = arrived[name]
            array[holes] = array[last]
        self.show(after)
        return len(leaving)

    def append_ghosts(self, arrived: dict[str, Array]) -> dict[str, Array]:
        """Put ghosts behind the particles; returns the arrays of both together, for the fields that ghosts have."""
        n = self.count
        rows = n + len(arrived["id"])
        self.reserve(rows)
        for name, array in arrived.items():
            self.buffers[name][n:rows] = array
        return {name: self.buffers[name][:rows] for name in arrived}
