"""Rows to ranks: migration to any rank, rows in id order for files, and ghosts that are refreshed as they change."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from mpi4py import MPI
from numba import njit

from particles_mpi.collide.contact import NOBODY
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
    rank that has ghosts of ours; after a pass it holds only the rows to which something happened.
    """

    def __init__(self, ranks: Ranks, rows: Array, counts: Array, arriving: Array, owned: int, dimension: int):
        self.ranks, self.owned = ranks, owned
        self.rows = rows.astype(np.int32)
        width = 3 + 2 * dimension  # the longest row of a message: place, last met, start of the leg, x, v
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

    def refresh(self, x: Array, v: Array) -> None:
        """Ghost rows of x and v (n, d), as their owners have them."""
        for first, message in self.exchange(lambda rows, buffer: pack_state(rows, x, v, buffer)):
            unpack_state(first, message, x, v)

    def tell_choices(self, choice: Array, a: Array, b: Array, marked: Array) -> None:
        """The choices of owned rows among the hits (a, b) to all who hold them as ghosts. `marked`: no row, now and after."""
        for first, message in self.exchange(
            lambda rows, buffer: pack_choices(rows, choice, a, b, self.owned, marked, buffer.view(np.int64))
        ):
            unpack_choices(first, message.view(np.int64), choice)

    def tell_legs(self, live: Array, x: Array, v: Array, s: Array, met: Array, touched: Array, count: int) -> int:
        """New legs of the owned ones of the live rows, touched[:count], to all who hold them as ghosts.

        They are live there too if their leg is news. Returns the count with the ghosts that came to it.
        """
        mine = touched[:count]
        for first, message in self.exchange(
            lambda rows, buffer: pack_legs(rows, mine, x, v, s, met, buffer, buffer.view(np.int64))
        ):
            count = unpack_legs(first, message, message.view(np.int64), live, x, v, s, met, touched, count)
        return count


@njit(cache=True)
def place_of(row, rows):
    """Where `row` is among ascending rows, or -1."""
    low, high = 0, len(rows)
    while low < high:
        middle = (low + high) // 2
        if rows[middle] < row:
            low = middle + 1
        else:
            high = middle
    return low if low < len(rows) and rows[low] == row else -1


@njit(cache=True)
def pack_state(rows, x, v, out):
    """x and v of rows, one after the other."""
    d = x.shape[1]
    for r in range(len(rows)):
        for k in range(d):
            out[2 * d * r + k] = x[rows[r], k]
            out[2 * d * r + d + k] = v[rows[r], k]
    return 2 * d * len(rows)


@njit(cache=True)
def unpack_state(first, message, x, v):
    """What pack_state wrote, to the rows from `first` on."""
    d = x.shape[1]
    for r in range(len(message) // (2 * d)):
        for k in range(d):
            x[first + r, k] = message[2 * d * r + k]
            v[first + r, k] = message[2 * d * r + d + k]


@njit(cache=True)
def pack_choices(rows, choice, a, b, owned, marked, out):
    """(place among rows, choice) of the owned rows of the hits that are among them."""
    size = 0
    for told in (True, False):  # each row once, and all unmarked again
        for p in range(len(a)):
            for i in (a[p], b[p]):
                if 0 <= i < owned and marked[i] != told:
                    marked[i] = told
                    place = place_of(i, rows) if told and choice[i] != NOBODY else -1
                    if place >= 0:
                        out[size] = place
                        out[size + 1] = choice[i]
                        size += 2
    return size


@njit(cache=True)
def unpack_choices(first, message, choice):
    """What pack_choices wrote."""
    for m in range(0, len(message), 2):
        choice[first + message[m]] = message[m + 1]


@njit(cache=True)
def pack_legs(rows, touched, x, v, s, met, out, words):
    """(place among rows, met, s, x, v) of the touched rows that are among them; `words` is `out` as integers."""
    d = x.shape[1]
    size = 0
    for i in touched:
        place = place_of(i, rows)
        if place >= 0:
            words[size] = place
            words[size + 1] = met[i]
            out[size + 2] = s[i]
            for k in range(d):
                out[size + 3 + k] = x[i, k]
                out[size + 3 + d + k] = v[i, k]
            size += 3 + 2 * d
    return size


@njit(cache=True)
def unpack_legs(first, message, words, live, x, v, s, met, touched, count):
    """What pack_legs wrote; rows whose leg is news become live and touched."""
    d = x.shape[1]
    for m in range(0, len(message), 3 + 2 * d):
        i = first + words[m]
        if (met[i] != words[m + 1] or s[i] != message[m + 2]) and not live[i]:
            live[i] = True
            touched[count] = i
            count += 1
        met[i] = words[m + 1]
        s[i] = message[m + 2]
        for k in range(d):
            x[i, k] = message[m + 3 + k]
            v[i, k] = message[m + 3 + d + k]
    return count
