"""Rows to ranks: migration to any rank, rows in id order for files, and ghosts that are refreshed as they change."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from mpi4py import MPI

from particles_mpi.parallel.ranks import Ranks
from particles_mpi.particles import FIELDS, Array, rows_of, shape


def send_rows(
    ranks: Ranks, arrays: dict[str, Array], rows: Array, counts: Array, dimension: int
) -> tuple[dict[str, Array], Array]:
    """Send `rows` of the arrays, sorted by destination with `counts[p]` of them for rank p.

    Returns what arrived, in order of the sender, and how many rows from each. Collective.
    """
    if ranks.size == 1:
        return rows_of(arrays, rows), counts
    arriving = np.empty_like(counts)
    ranks.comm.Alltoall(counts, arriving)
    ranks.messages += int((counts > 0).sum())
    row_type = np.dtype([(name, FIELDS[name].dtype, shape(name, 1, dimension)[1:]) for name in arrays])
    outgoing = np.empty(len(rows), row_type)
    for name, array in arrays.items():
        outgoing[name] = array.take(rows, axis=0)
    incoming = np.empty(int(arriving.sum()), row_type)
    mpi_row = MPI.BYTE.Create_contiguous(row_type.itemsize).Commit()
    ranks.comm.Alltoallv([outgoing, (counts, starts(counts)), mpi_row], [incoming, (arriving, starts(arriving)), mpi_row])
    mpi_row.Free()
    return {name: np.ascontiguousarray(incoming[name]) for name in arrays}, arriving


def starts(counts: Array) -> Array:
    """Where each part begins: the exclusive cumulative sum."""
    return np.concatenate(([0], np.cumsum(counts)[:-1])).astype(counts.dtype)


def by_destination(destination: Array, size: int) -> tuple[Array, Array]:
    """(rows sorted by destination, rows for each rank)."""
    counts = np.bincount(destination, minlength=size).astype(np.int32)
    return np.argsort(destination, kind="stable"), counts


def in_id_order(ranks: Ranks, arrays: dict[str, Array], total: int, writers: int, dimension: int) -> dict[str, Array]:
    """Rows in id order, an equal block of ids on each of the first `writers` ranks. Collective."""
    owner = arrays["id"] * writers // max(total, 1)
    order, counts = by_destination(owner, ranks.size)
    arrived, _ = send_rows(ranks, arrays, order, counts, dimension)
    order = np.argsort(arrived["id"], kind="stable")
    return rows_of(arrived, order)


class Halo:
    """The ghosts of a rank: which rows go to which rank, and where theirs arrive, until the next search for pairs.

    Ghost rows stand behind the owned ones, in order of their owner. Each exchange is one non-blocking message to each
    rank that has ghosts of ours, of up to `width` numbers a row.
    """

    def __init__(self, ranks: Ranks, rows: Array, counts: Array, arriving: Array, owned: int, width: int):
        self.ranks, self.owned = ranks, owned
        self.rows = rows.astype(np.int32)
        to, of = np.flatnonzero(counts), np.flatnonzero(arriving)
        self.outgoing = list(zip(to.tolist(), starts(counts)[to].tolist(), np.cumsum(counts)[to].tolist(), strict=True))
        ends = np.cumsum(arriving)
        self.incoming = list(zip(of.tolist(), starts(arriving)[of].tolist(), ends[of].tolist(), strict=True))
        self.out = [np.empty((end - begin) * width) for _, begin, end in self.outgoing]
        self.into = [np.empty((end - begin) * width) for _, begin, end in self.incoming]

    def exchange(self, pack: Callable[[Array, Array], int]) -> list[tuple[int, Array]]:
        """`pack(rows, buffer)` writes a message and returns its length; gives (first ghost row, message) of all that arrived."""
        comm, requests = self.ranks.comm, []
        for (p, _, _), buffer in zip(self.incoming, self.into, strict=True):
            requests.append(comm.Irecv([buffer, MPI.DOUBLE], source=p))
        for (p, begin, end), buffer in zip(self.outgoing, self.out, strict=True):
            size = pack(self.rows[begin:end], buffer)
            requests.append(comm.Isend([buffer, size, MPI.DOUBLE], dest=p))
        self.ranks.messages += len(self.outgoing)
        statuses = [MPI.Status() for _ in requests]
        MPI.Request.Waitall(requests, statuses)
        return [
            (self.owned + begin, buffer[: status.Get_count(MPI.DOUBLE)])
            for (_, begin, _), buffer, status in zip(self.incoming, self.into, statuses, strict=False)
        ]
