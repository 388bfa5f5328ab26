"""Rows to ranks: migration to any rank, rows in id order for files, and ghosts that are refreshed as they change."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from particles_mpi.parallel.ranks import Ranks
from particles_mpi.particles import FIELDS, Array, shape


def send_rows(
    ranks: Ranks, arrays: dict[str, Array], rows: Array, counts: Array, dimension: int
) -> tuple[dict[str, Array], Array]:
    """Send `rows` of the arrays, sorted by destination with `counts[p]` of them for rank p.

    Returns what arrived, in order of the sender, and how many rows from each. Collective.
    """
    if ranks.size == 1:
        return {name: array[rows] for name, array in arrays.items()}, counts
    arriving = np.empty_like(counts)
    ranks.comm.Alltoall(counts, arriving)
    ranks.messages += int((counts > 0).sum())
    row_type = np.dtype([(name, FIELDS[name].dtype, shape(name, 1, dimension)[1:]) for name in arrays])
    outgoing = np.empty(len(rows), row_type)
    for name, array in arrays.items():
        outgoing[name] = array[rows]
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


def migrate(ranks: Ranks, arrays: dict[str, Array], owner: Array, dimension: int) -> tuple[dict[str, Array], int]:
    """Every row to its owner, any rank; returns the rows held now and how many this rank sent away. Collective."""
    if ranks.size == 1:
        return arrays, 0
    stays = owner == ranks.rank
    leaving = np.flatnonzero(~stays)
    if ranks.total(len(leaving))[0] == 0:
        return arrays, 0
    order, counts = by_destination(owner[leaving], ranks.size)
    arrived, _ = send_rows(ranks, arrays, leaving[order], counts, dimension)
    return {n: np.concatenate((a[stays], arrived[n])) for n, a in arrays.items()}, len(leaving)


def in_id_order(ranks: Ranks, arrays: dict[str, Array], total: int, writers: int, dimension: int) -> dict[str, Array]:
    """Rows in id order, an equal block of ids on each of the first `writers` ranks. Collective."""
    owner = arrays["id"] * writers // max(total, 1)
    order, counts = by_destination(owner, ranks.size)
    arrived, _ = send_rows(ranks, arrays, order, counts, dimension)
    order = np.argsort(arrived["id"], kind="stable")
    return {name: array[order] for name, array in arrived.items()}


class Halo:
    """The ghosts of a rank: which rows go to which rank, and where theirs arrive, until the next search for pairs.

    Ghost rows stand behind the owned ones, in order of their owner. Non-blocking, one message a pair of ranks and refresh.
    """

    def __init__(self, ranks: Ranks, rows: Array, counts: Array, arriving: Array, owned: int):
        self.ranks = ranks
        ends, begins = np.cumsum(counts), starts(counts)
        self.outgoing = [(int(p), rows[begins[p] : ends[p]]) for p in np.flatnonzero(counts)]
        ends, begins = owned + np.cumsum(arriving), owned + starts(arriving)
        self.incoming = [(int(p), slice(int(begins[p]), int(ends[p]))) for p in np.flatnonzero(arriving)]
        self.sent = 0

    def refresh(self, *arrays: Array) -> None:
        """Overwrite the ghost rows of the arrays (8-byte numbers, (n,) or (n, d)) by what their owners hold."""
        comm = self.ranks.comm
        widths = [a.size // max(len(a), 1) for a in arrays]
        width = sum(widths)
        received, requests = [], []
        for p, ghosts in self.incoming:
            buffer = np.empty((ghosts.stop - ghosts.start) * width)
            received.append(buffer)
            requests.append(comm.Irecv([buffer, MPI.DOUBLE], source=p))
        kept = []
        for p, rows in self.outgoing:
            buffer = np.concatenate([a[rows].view(np.float64).ravel() for a in arrays])
            kept.append(buffer)
            requests.append(comm.Isend([buffer, MPI.DOUBLE], dest=p))
            self.sent += len(rows)
        self.ranks.messages += len(kept)
        MPI.Request.Waitall(requests)
        for (_, ghosts), buffer in zip(self.incoming, received, strict=True):
            begin = 0
            for array, columns in zip(arrays, widths, strict=True):
                end = begin + columns * (ghosts.stop - ghosts.start)
                array[ghosts] = buffer[begin:end].view(array.dtype).reshape(array[ghosts].shape)
                begin = end
