"""The rows of a rank in arrays with spare space for rows that arrive and for ghosts; and the rows of all ranks on every rank."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from particles_mpi.kernels.limits import require_countable
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import allgather_rows, by_destination, send_rows
from particles_mpi.particles import MEETING, Array, Particles, field

OWNER = "rank of the owner"  # a name that no field has
ROWS_AT_ONCE = 100_000  # rows that a rank sends away in one message to each other rank
GROWTH = 1.2  # of the rows that are needed: how many new arrays have space for


class RowBuffers:
    """Holds the arrays of `particles`, which are views of their first rows. Ghosts may stand behind these."""

    def __init__(self, particles: Particles):
        self.particles = particles
        self.buffers: dict[str, Array] = {}
        self.spare: dict[Any, Array] = {}  # one array for each type and width, into which columns are sorted in turn

    def adopt(self) -> None:
        """Copy the arrays of `particles` into the buffers, if other code has put new ones there."""
        arrays = self.particles.arrays
        if any(array.base is not self.buffers.get(name, self) for name, array in arrays.items()):
            require_countable(len(self.particles), "particles")
            self.buffers = {}
            for name, array in arrays.items():
                arrays[name] = self.buffers[name] = np.array(array, order="C")  # one column at a time is there twice
            self.show(len(self.buffers["id"]))

    def show(self, count: int) -> None:
        """Make the first `count` rows the particles."""
        self.particles.replace({name: array[:count] for name, array in self.buffers.items()})

    def reserve(self, rows: int) -> None:
        """Make space for so many rows; the particles keep theirs."""
        if rows <= len(self.buffers["id"]):
            return
        require_countable(rows, "particles and ghosts")
        n, space = len(self.particles), int(rows * GROWTH) + 1
        self.spare = {}
        for name, old in self.buffers.items():
            self.buffers[name] = np.empty((space, *old.shape[1:]), old.dtype)
            self.buffers[name][:n] = old[:n]
            self.particles.arrays[name] = self.buffers[name][:n]
        self.show(n)

    def sort(self, order: Array) -> None:
        """Put the rows into another order: row i becomes what row order[i] was."""
        n = len(order)
        for name, old in self.buffers.items():
            kind = old.dtype, old.shape[1:]
            new = self.spare.get(kind)
            if new is None or len(new) != len(old):
                new = np.empty_like(old)
            old[:n].take(order, axis=0, out=new[:n], mode="clip")
            self.buffers[name], self.spare[kind] = new, old
        self.show(n)

    def migrate(self, ranks: Communicator, owner: Array) -> int:
        """Send every row to its owner (n,), any rank; returns how many rows this rank sent away. Collective.

        A rank sends at most ROWS_AT_ONCE rows at a time: so messages need little memory, even where all rows move.
        """
        if ranks.size == 1:
            return 0
        leaving = np.flatnonzero(owner != ranks.rank)
        away, most = len(leaving), int(ranks.largest(len(leaving))[0])
        if 0 < most <= ROWS_AT_ONCE:
            self.send(ranks, leaving, owner[leaving])
        elif most:
            self.buffers[OWNER] = np.resize(owner, len(self.buffers["id"]))  # goes where its row goes
            self.show(len(owner))
            while ranks.any(len(leaving)):
                leaving = leaving[:ROWS_AT_ONCE]
                self.send(ranks, leaving, self.buffers[OWNER][leaving])
                leaving = np.flatnonzero(self.particles.arrays[OWNER] != ranks.rank)
            del self.buffers[OWNER]
            self.show(len(self.particles))
        return away

    def send(self, ranks: Communicator, leaving: Array, owner: Array) -> None:
        """Send the rows `leaving`, ascending, to the ranks `owner`, and take those that arrive. Collective."""
        n = len(self.particles)
        order, counts = by_destination(owner, ranks.size)
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

    def append_ghosts(self, arrived: dict[str, Array]) -> dict[str, Array]:
        """Put ghosts behind the particles; returns the arrays of both together, for the fields that ghosts have."""
        n = len(self.particles)
        rows = n + len(arrived["id"])
        self.reserve(rows)
        for name, array in arrived.items():
            self.buffers[name][n:rows] = array
        return {name: self.buffers[name][:rows] for name in arrived}


class Replica:
    """All particles on every rank, kept up to date, for a computation in one order of time that all ranks do alike.

    `all_particles` holds the rows of all ranks, the same on each, in any order; on one rank it is `particles` itself.

    The version of `all_particles` is raised where a field of `MEETING` changed that is not among the `changing` ones, which a
    drift changes. `self.version` is the one for which `row_of` holds.
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
