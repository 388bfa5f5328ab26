"""The ranks of a run: a communicator, passed in, with the few reductions that the program needs, counted."""

from __future__ import annotations

from collections.abc import Callable
from time import sleep
from typing import Any

import numpy as np
from mpi4py import MPI

from particles_mpi.particles import Array

NAP = 0.005  # seconds between two looks of a rank that waits asleep


class Communicator:
    """Thin over a communicator: on one rank nothing is sent, and every message and reduction is counted for `run.json`.

    `rows`: that came from other ranks; `all_to_alls`: exchanges in which every rank may have something for every other.
    """

    def __init__(self, comm: MPI.Comm | None = None):
        self.comm = MPI.COMM_WORLD if comm is None else comm
        self.rank, self.size = self.comm.Get_rank(), self.comm.Get_size()
        self.messages = 0
        self.reductions = 0
        self.all_to_alls = 0
        self.rows = 0

    @classmethod
    def alone(cls) -> Communicator:
        """This rank by itself."""
        return cls(MPI.COMM_SELF)

    def first(self, count: int) -> Communicator | None:
        """The first `count` of these, with a communicator of their own; None on the others. Collective."""
        comm = self.comm.Split(0 if self.rank < count else MPI.UNDEFINED, self.rank)
        return None if comm == MPI.COMM_NULL else Communicator(comm)

    @property
    def is_root(self) -> bool:
        return self.rank == 0

    def _reduce(self, values: Any, operation: MPI.Op) -> Array:
        values = np.atleast_1d(values)
        if self.size == 1:
            return values
        self.reductions += 1
        result = np.empty_like(values)
        self.comm.Allreduce(values, result, operation)
        return result

    def allreduce_sum(self, values: Any) -> Array:
        """Element-wise sum over ranks; exact, so independent of the ranks, for integers only."""
        return self._reduce(values, MPI.SUM)

    def allreduce_max(self, values: Any) -> Array:
        """Element-wise maximum over ranks."""
        return self._reduce(values, MPI.MAX)

    def allreduce_min(self, values: Any) -> Array:
        """Element-wise minimum over ranks."""
        return self._reduce(values, MPI.MIN)

    def barrier(self) -> None:
        """Until every rank has come here."""
        if self.size > 1:
            self.comm.Barrier()

    def sleeping_barrier(self) -> None:
        """The same, without keeping a core busy meanwhile."""
        if self.size > 1:
            arrived = self.comm.Ibarrier()
            while not arrived.Test():
                sleep(NAP)

    def run_on_root(self, work: Callable[[], Any]) -> Any:
        """What `work()` gives on rank 0, where it is called while the others sleep, and None on those. Collective.

        An error there is raised on all.
        """
        value, error = None, None
        if self.is_root:
            try:
                value = work()
            except Exception as raised:
                error = raised
        self.sleeping_barrier()
        error = self.bcast(error)
        if error is not None:
            raise error
        return value

    def allgather_array(self, row: Array) -> Array:
        """A row of numbers (any shape) from each rank, as a table (ranks, *shape) on all of them."""
        table = np.empty((self.size, *row.shape), row.dtype)
        if self.size == 1:
            table[0] = row
        else:
            self.reductions += 1
            self.comm.Allgather(row, table)
        return table

    def bcast(self, value: Any) -> Any:
        """Any small Python object, as rank 0 has it."""
        return value if self.size == 1 else self.comm.bcast(value)

    def allgather(self, value: Any) -> list[Any]:
        """The small Python objects of all ranks, on every rank."""
        return [value] if self.size == 1 else self.comm.allgather(value)


def mpi_library() -> str:
    """The MPI library in use, one line."""
    return MPI.Get_library_version().split("\n")[0].split(",")[0].strip("\0 ")


def now() -> float:
    """Seconds of the MPI clock."""
    return MPI.Wtime()
