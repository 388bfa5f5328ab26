"""The ghosts of a rank, and their refreshing when owners have changed them."""

from __future__ import annotations

from collections.abc import Callable
from math import prod

import numpy as np
from mpi4py import MPI

from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import TAG, WORD, in_pieces, parts, receive, send
from particles_mpi.particles import Array


class Halo:
    """The ghosts of a rank until the next search for neighbours: which rows are sent to which rank, and where theirs arrive.

    Ghost rows stand behind the `owned` ones, sorted by owner. `refresh` sends all rows, and `exchange` some, of up to `width`
    numbers each, in one non-blocking message to each rank that holds ghosts of this one.
    """

    def __init__(self, ranks: Communicator, rows: Array, counts: Array, arriving: Array, owned: int, width: int):
        """`rows`, `counts`: as for `send_rows`; `arriving` (ranks,): how many ghosts come from each rank."""
        self.ranks, self.owned = ranks, owned
        self.rows = rows.astype(np.int32)
        self.outgoing, self.incoming = parts(counts), parts(arriving)
        self.send_buffers = [np.empty((end - begin) * width) for _, begin, end in self.outgoing]
        self.receive_buffers = [np.empty((end - begin) * width) for _, begin, end in self.incoming]
        self.messages: dict[tuple[int, ...], PersistentMessages] = {}  # by widths of tables

    def refresh(self, *columns: Array) -> None:
        """Ghost rows of float64 columns (rows, ...) as their owners have them, in place. Collective."""
        tables = [column.reshape(len(column), prod(column.shape[1:])) for column in columns]
        widths = tuple(table.shape[1] for table in tables)
        if widths not in self.messages:
            self.messages[widths] = PersistentMessages(self, widths)
        self.messages[widths].exchange(*tables)

    def exchange(self, pack: Callable[[Array, Array], int]) -> list[tuple[int, Array]]:
        """Send each rank what `pack` makes of its ghosts; returns (first ghost row, message) of each sender. Collective.

        `pack(rows, buffer)` writes what is sent of these owned rows, and returns how many float64 these are, `width` a row at
        most. The ghosts stay as they are: the caller unpacks the messages.
        """
        ranks, requests = self.ranks, []
        for (p, _, _), buffer in zip(self.incoming, self.receive_buffers, strict=True):
            requests += receive(ranks, p, buffer)
        for (p, begin, end), buffer in zip(self.outgoing, self.send_buffers, strict=True):
            requests += send(ranks, p, buffer, pack(self.rows[begin:end], buffer))
        statuses = [MPI.Status() for _ in requests]
        MPI.Request.Waitall(requests, statuses)
        sizes, arrived = (status.Get_count(MPI.DOUBLE) for status in statuses), []
        for (_, begin, _), buffer in zip(self.incoming, self.receive_buffers, strict=True):
            size = sum(next(sizes) for _ in in_pieces(buffer))
            arrived.append((self.owned + begin, buffer[:size]))
        return arrived


class PersistentMessages:
    """The messages of a halo for tables of these `widths` together that are refreshed many times: MPI prepares them once.

    In a message each table has its rows together, so that they are copied straight from where they are, and to it.
    """

    def __init__(self, halo: Halo, widths: tuple[int, ...]):
        comm, self.ranks, rows = halo.ranks.comm, halo.ranks, halo.rows.astype(np.intp)
        self.requests: list[MPI.Prequest] = []
        self.taken: list[tuple[int, Array, Array]] = []  # number of the table, its rows, and their place in a message
        self.given: list[tuple[int, slice, Array]] = []
        for p, begin, end in halo.incoming:
            message = np.empty((end - begin) * sum(widths))
            self.requests += [comm.Recv_init(piece, source=p, tag=TAG) for piece in in_pieces(message)]
            ghosts = slice(halo.owned + begin, halo.owned + end)
            self.given += [(table, ghosts, place) for table, place in enumerate(tables_in(message, end - begin, widths))]
        self.receives = len(self.requests)
        for p, begin, end in halo.outgoing:
            message = np.empty((end - begin) * sum(widths))
            self.requests += [comm.Send_init(piece, dest=p, tag=TAG) for piece in in_pieces(message)]
            self.taken += [(table, rows[begin:end], place) for table, place in enumerate(tables_in(message, end - begin, widths))]
        self.bytes = WORD * len(rows) * sum(widths)

    def exchange(self, *tables: Array) -> None:
        """Ghost rows of the tables (rows, width) as their owners have them, in place. Collective."""
        for table, rows, place in self.taken:
            tables[table].take(rows, axis=0, out=place, mode="clip")
        self.ranks.messages += len(self.requests) - self.receives
        self.ranks.bytes["rows"] += self.bytes
        MPI.Prequest.Startall(self.requests)
        MPI.Request.Waitall(self.requests)
        for table, ghosts, place in self.given:
            tables[table][ghosts] = place

    def __del__(self) -> None:
        """MPI forgets the messages."""
        if not MPI.Is_finalized():
            for request in self.requests:
                request.Free()


def tables_in(message: Array, rows: int, widths: tuple[int, ...]) -> list[Array]:
    """The tables (rows, width) that stand one after the other in a message."""
    ends = np.cumsum(widths) * rows
    return [part.reshape(rows, width) for part, width in zip(np.split(message, ends[:-1]), widths, strict=True)]
