"""Rows to ranks: migration to any rank, rows in id order for files, and ghosts that are refreshed as they change."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from math import prod
from typing import NamedTuple

import numpy as np
from mpi4py import MPI

from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Array, rows_of

TAG = 0  # of rows; ranks that fail tell one another so with another one
WORD = 8  # bytes; messages are counted in words, so that 2^31 of them suffice for any rank's rows


class IdRange(NamedTuple):
    """The ids of all particles of all ranks: from `first` up to but not including `end`, `total` of them."""

    first: int
    end: int
    total: int


def send_rows(ranks: Communicator, arrays: dict[str, Array], rows: Array, counts: Array) -> tuple[dict[str, Array], Array]:
    """Send `rows` of the arrays, sorted by destination with `counts[p]` of them for rank p.

    Returns what arrived, in order of the sender, and how many rows from each. Collective.
    """
    if ranks.size == 1:
        return rows_of(arrays, rows), counts
    arriving = np.empty_like(counts)
    ranks.comm.Alltoall(counts, arriving)
    ranks.messages += int((counts > 0).sum())
    ranks.all_to_alls += 1
    ranks.rows += int(arriving.sum() - arriving[ranks.rank])
    row_size = sum(column.dtype.itemsize * prod(column.shape[1:]) for column in arrays.values())
    to, of = (-(row_size * numbers.astype(np.int64) // -WORD) for numbers in (counts, arriving))
    outgoing, incoming = np.empty(to.sum(), np.int64), np.empty(of.sum(), np.int64)
    begins, froms = starts(counts), starts(arriving)
    for p in np.flatnonzero(counts):
        mine = rows[begins[p] : begins[p] + counts[p]]
        for name, part in columns(outgoing[starts(to)[p] :], int(counts[p]), arrays):
            arrays[name].take(mine, axis=0, out=part, mode="clip")
    ranks.comm.Alltoallv([outgoing, (to, starts(to))], [incoming, (of, starts(of))])
    arrived = {name: np.empty((int(arriving.sum()), *column.shape[1:]), column.dtype) for name, column in arrays.items()}
    for p in np.flatnonzero(arriving):
        for name, part in columns(incoming[starts(of)[p] :], int(arriving[p]), arrays):
            arrived[name][froms[p] : froms[p] + arriving[p]] = part
    return arrived, arriving


def allgather_rows(ranks: Communicator, arrays: dict[str, Array]) -> dict[str, Array]:
    """The rows of all ranks on every rank, in order of the owner. Collective."""
    n = len(next(iter(arrays.values())))
    rows, counts = np.tile(np.arange(n), ranks.size), np.full(ranks.size, n, np.int32)
    return send_rows(ranks, arrays, rows, counts)[0]


def sendrecv(ranks: Communicator, others: Sequence[int], outgoing: Sequence[Array]) -> Array:
    """One message of float64 to each of the other ranks, all of which do the same; returns theirs, one after the other."""
    comm = ranks.comm
    requests = [comm.Isend([message, MPI.DOUBLE], dest=p, tag=TAG) for p, message in zip(others, outgoing, strict=True)]
    ranks.messages += len(requests)
    status = MPI.Status()
    messages = [(comm.Mprobe(source=p, tag=TAG, status=status), status.Get_count(MPI.DOUBLE)) for p in others]
    incoming = np.empty(sum(size for _, size in messages))
    at = 0
    for message, size in messages:
        message.Recv([incoming[at : at + size], MPI.DOUBLE])
        at += size
    MPI.Request.Waitall(requests)
    return incoming


def columns(words: Array, count: int, like: dict[str, Array]) -> Iterator[tuple[str, Array]]:
    """(name, view of `count` rows) in one rank's part of a message, the beginning of `words`.

    Column after column, the widest numbers first, so that each is aligned: whole columns are copied faster than rows.
    """
    data, begin = words.view(np.uint8), 0
    for name in sorted(like, key=lambda name: -like[name].dtype.itemsize):
        dtype, rest = like[name].dtype, like[name].shape[1:]
        end = begin + count * prod(rest) * dtype.itemsize
        yield name, data[begin:end].view(dtype).reshape(count, *rest)
        begin = end


def starts(counts: Array) -> Array:
    """Where each part begins: the exclusive cumulative sum."""
    return np.concatenate(([0], np.cumsum(counts)[:-1])).astype(counts.dtype)


def by_destination(destination: Array, size: int) -> tuple[Array, Array]:
    """(rows sorted by destination, rows for each rank)."""
    counts = np.bincount(destination, minlength=size).astype(np.int32)
    return np.argsort(destination, kind="stable"), counts


def id_range(ranks: Communicator, ids: Array) -> IdRange:
    """Where the ids of all ranks lie, `ids` (n,) being this rank's. Collective."""
    low, high = (int(ids.min()), int(ids.max())) if len(ids) else (2**62, -1)
    ends = ranks.allreduce_max(np.array([-low, high], np.int64))
    return IdRange(max(-int(ends[0]), 0) if ends[1] >= 0 else 0, int(ends[1]) + 1, int(ranks.allreduce_sum(len(ids))[0]))


def in_id_order(ranks: Communicator, arrays: dict[str, Array], ids: IdRange, writers: int) -> dict[str, Array]:
    """Rows in id order, equal stretches of the ids on each of the first `writers` ranks. Collective."""
    owner = (arrays["id"] - ids.first) * writers // max(ids.end - ids.first, 1)
    order, counts = by_destination(owner, ranks.size)
    arrived, _ = send_rows(ranks, arrays, order, counts)
    order = np.argsort(arrived["id"], kind="stable")
    return rows_of(arrived, order)


class Halo:
    """The ghosts of a rank: which rows go to which rank, and where theirs arrive, until the next search for pairs.

    Ghost rows stand behind the owned ones, in order of their owner. Each exchange is one non-blocking message to each
    rank that has ghosts of ours, of up to `width` numbers a row.
    """

    def __init__(self, ranks: Communicator, rows: Array, counts: Array, arriving: Array, owned: int, width: int):
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
            requests.append(comm.Irecv([buffer, MPI.DOUBLE], source=p, tag=TAG))
        for (p, begin, end), buffer in zip(self.outgoing, self.out, strict=True):
            size = pack(self.rows[begin:end], buffer)
            requests.append(comm.Isend([buffer, size, MPI.DOUBLE], dest=p, tag=TAG))
        self.ranks.messages += len(self.outgoing)
        statuses = [MPI.Status() for _ in requests]
        MPI.Request.Waitall(requests, statuses)
        return [
            (self.owned + begin, buffer[: status.Get_count(MPI.DOUBLE)])
            for (_, begin, _), buffer, status in zip(self.incoming, self.into, statuses, strict=False)
        ]
