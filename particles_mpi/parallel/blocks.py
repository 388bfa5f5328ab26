"""All particles on every rank, a block at a time, in the order of their ids: for sums over all pairs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from mpi4py import MPI

from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import IdRange, allgather_rows, in_id_order
from particles_mpi.particles import Array, rows_of

FEW = 10_000  # rows that are sent to all in one message


def blocks(ranks: Communicator, columns: dict[str, Array], span: IdRange) -> Iterator[dict[str, Array]]:
    """The rows of all ranks in id order, cut into a block a rank; `columns` (with "id") hold float64 or int64. Collective.

    A few are one block. Else the next block is on its way while the caller works on one; a rank holds two at a time, O(N/P) rows.
    """
    if ranks.size == 1 or span.total <= FEW:
        everyone = columns if ranks.size == 1 else allgather_rows(ranks, columns)
        ids = everyone["id"]
        yield everyone if (ids[1:] > ids[:-1]).all() else rows_of(everyone, np.argsort(ids))
        return
    mine = in_id_order(ranks, columns, span, ranks.size)
    ranks.all_to_alls += 1
    ranks.rows += span.total - len(mine["id"])
    widths = {name: int(np.prod(column.shape[1:])) for name, column in columns.items()}
    counts = ranks.allgather_array(np.array(len(mine["id"])))

    def start(rank: int) -> tuple[Array, MPI.Request]:
        rows = int(counts[rank])
        if rank == ranks.rank:
            parts = [mine[name].reshape(rows, -1).view(np.float64) for name in columns]
            buffer = np.concatenate([part.ravel() for part in parts])
        else:
            buffer = np.empty(rows * sum(widths.values()))
        ranks.messages += rank == ranks.rank
        return buffer, ranks.comm.Ibcast([buffer, MPI.DOUBLE], root=rank)

    coming = start(0)
    for rank in range(ranks.size):
        buffer, request = coming
        request.Wait()
        if rank + 1 < ranks.size:
            coming = start(rank + 1)
        rows, begin, block = int(counts[rank]), 0, {}
        for name, column in columns.items():
            end = begin + rows * widths[name]
            block[name] = buffer[begin:end].view(column.dtype).reshape(rows, *column.shape[1:])
            begin = end
        yield block
