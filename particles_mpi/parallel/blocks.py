"""All particles on every rank, one rank's share at a time and in the order of their ids: for sums over all pairs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from mpi4py import MPI

from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import IdRange, allgather_rows, in_id_order
from particles_mpi.particles import Array, rows_of

FEW = 10_000  # most rows that are sent to all ranks in one message


def blocks(ranks: Communicator, columns: dict[str, Array], ids: IdRange) -> Iterator[dict[str, Array]]:
    """The rows of all ranks in id order, as one block for each rank; `columns` (with "id") are float64 or int64. Collective.

    Few rows are a single block. Otherwise the next block is on its way while the caller works on one: a rank holds two blocks
    at a time, which are O(N/P) rows.
    """
    if ranks.size == 1 or ids.total <= FEW:
        rows = columns if ranks.size == 1 else allgather_rows(ranks, columns)
        yield rows if (rows["id"][1:] > rows["id"][:-1]).all() else rows_of(rows, np.argsort(rows["id"]))
        return
    mine = in_id_order(ranks, columns, ids, ranks.size)
    ranks.all_to_alls += 1
    ranks.rows += ids.total - len(mine["id"])
    widths = {name: int(np.prod(column.shape[1:])) for name, column in columns.items()}
    counts = ranks.allgather_array(np.array(len(mine["id"])))

    def start(rank: int) -> tuple[Array, MPI.Request]:
        """Begin to send the block of a rank to all; its numbers, column after column."""
        if rank == ranks.rank:
            buffer = np.concatenate([mine[name].reshape(-1).view(np.float64) for name in columns])
        else:
            buffer = np.empty(int(counts[rank]) * sum(widths.values()))
        ranks.messages += rank == ranks.rank
        return buffer, ranks.comm.Ibcast([buffer, MPI.DOUBLE], root=rank)

    coming = start(0)
    for rank in range(ranks.size):
        buffer, request = coming
        request.Wait()
        if rank + 1 < ranks.size:
            coming = start(rank + 1)
        count, begin, block = int(counts[rank]), 0, {}
        for name, column in columns.items():
            end = begin + count * widths[name]
            block[name] = buffer[begin:end].view(column.dtype).reshape(count, *column.shape[1:])
            begin = end
        yield block
