"""The ranks of a run: an MPI communicator with the collective calls that the program needs; those on arrays are counted."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from time import perf_counter, sleep
from typing import Any

import numpy as np
from mpi4py import MPI

from particles_mpi.particles import Array

NAP = 0.005  # seconds between two checks of a rank that sleeps while it waits
KINDS = ("rows", "counts", "gathers", "reductions")  # of the bytes that a rank sends


class Communicator:
    """A thin layer over an MPI communicator. On a single rank nothing is sent.

    It counts `messages` sent to other single ranks, `reductions` (and other calls that take log2 P stages), `all_to_alls`, and
    `rows` of particles received. `bytes` are those that this rank sends to others, by kind: `rows` in messages to single ranks;
    `counts`, in which every rank tells every other how many rows come; `gathers`, in which every rank sends the same to all
    others, hence P - 1 times; and `reductions`, in which it sends its numbers in each of log2 P stages.
    """

    def __init__(self, comm: MPI.Comm | None = None):
        """`comm`: an MPI communicator, by default that of all ranks that were started."""
        self.comm = MPI.COMM_WORLD if comm is None else comm
        self.rank, self.size = self.comm.Get_rank(), self.comm.Get_size()
        self.is_root = self.rank == 0
        self.stages = (self.size - 1).bit_length()  # log2 of the number of ranks, rounded up
        self.messages = self.reductions = self.all_to_alls = self.rows = 0
        self.bytes = dict.fromkeys(KINDS, 0)

    @classmethod
    def alone(cls) -> Communicator:
        """Return a communicator with this rank only."""
        return cls(MPI.COMM_SELF)

    @property
    def exchanges(self) -> int:
        """How often this rank has sent anything to others."""
        return self.messages + self.reductions + self.all_to_alls

    def subset(self, count: int) -> Communicator | None:
        """The first `count` ranks with a communicator of their own; None on the others. Collective."""
        comm = self.comm.Split(0 if self.rank < count else MPI.UNDEFINED, self.rank)
        return None if comm == MPI.COMM_NULL else Communicator(comm)

    def on_this_machine(self) -> int:
        """How many of the ranks share the memory of this one's machine. Collective."""
        comm = self.comm.Split_type(MPI.COMM_TYPE_SHARED)
        count: int = comm.Get_size()
        comm.Free()
        return count

    def share(self, total: int) -> tuple[int, int]:
        """First and last + 1 of this rank's share of `total` things in a row."""
        return total * self.rank // self.size, total * (self.rank + 1) // self.size

    def sharer(self, total: int, numbers: Array) -> Array:
        """The rank in whose share of `total` things each of these numbers (n,) is."""
        begins = np.array([total * rank // self.size for rank in range(self.size)])
        return np.searchsorted(begins, numbers, "right") - 1

    def _allreduce(self, values: Any, operation: MPI.Op) -> Array:
        values = np.atleast_1d(values)
        if self.size == 1:
            return values
        self.reductions += 1
        self.bytes["reductions"] += values.nbytes * self.stages
        result = np.empty_like(values)
        self.comm.Allreduce(values, result, operation)
        return result

    def allreduce_sum(self, values: Any) -> Array:
        """Sum over the ranks, for each element. Exact, and so independent of the number of ranks, for integers only."""
        return self._allreduce(values, MPI.SUM)

    def allreduce_max(self, values: Any) -> Array:
        """Maximum over the ranks, for each element."""
        return self._allreduce(values, MPI.MAX)

    def largest(self, *numbers: float) -> tuple[float, ...]:
        """The maximum over the ranks of each number; a rank alone makes no array of them."""
        if self.size == 1:
            return tuple(map(float, numbers))
        return tuple(self.allreduce_max(np.array(numbers, np.float64)).tolist())

    def least(self, number: float) -> float:
        """The minimum over the ranks."""
        return -self.largest(-number)[0]

    def any(self, here: Any) -> bool:
        """Is it true on any rank?"""
        return self.largest(bool(here))[0] > 0.0

    def all(self, here: Any) -> bool:
        """Is it true on all ranks?"""
        return not self.any(not here)

    def total(self, *numbers: int | np.integer[Any]) -> tuple[int, ...]:
        """The sum over the ranks of each whole number."""
        if self.size == 1:
            return tuple(map(int, numbers))
        return tuple(self.allreduce_sum(np.array(numbers, np.int64)).tolist())

    def allgather_array(self, row: Array) -> Array:
        """The arrays of all ranks, which have the same shape on each, as one of shape (ranks, *shape) on every rank."""
        table = np.empty((self.size, *row.shape), row.dtype)
        if self.size == 1:
            table[0] = row
        else:
            self.reductions += 1
            self.bytes["gathers"] += row.nbytes * (self.size - 1)
            self.comm.Allgather(row, table)
        return table

    def allgather(self, value: Any) -> list[Any]:
        """The small Python objects of all ranks, on every rank."""
        if self.size == 1:
            return [value]
        packed = MPI.pickle.dumps(value)
        self.reductions += 2  # mpi4py gathers the lengths first
        self.bytes["gathers"] += len(packed) * (self.size - 1)
        return [MPI.pickle.loads(one) for one in self.comm.allgather(packed)]

    def bcast(self, value: Any) -> Any:
        """The small Python object that rank 0 has, on every rank."""
        return value if self.size == 1 else self.comm.bcast(value)

    def barrier(self) -> None:
        """Wait until all ranks have reached this call."""
        self.comm.Barrier()

    def sleeping_barrier(self, patience: float = inf) -> bool:
        """The same, but a waiting rank leaves its core to others. Returns whether all ranks came within `patience` seconds."""
        arrived, end = self.comm.Ibarrier(), perf_counter() + patience
        while not arrived.Test():
            if perf_counter() > end:
                return False
            sleep(NAP)
        return True

    def run_on_root(self, work: Callable[[], Any]) -> Any:
        """Call `work()` on rank 0 while the others sleep: its value there, None elsewhere, its exception on all. Collective."""
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


def mpi_library() -> str:
    """The name and version of the MPI library in use, on one line."""
    return MPI.Get_library_version().split("\n")[0].split(",")[0].strip("\0 ")
