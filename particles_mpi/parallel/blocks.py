"""All particles on every rank, one rank's share at a time and in the order of their ids: for sums over all pairs."""

from __future__ import annotations

from collections.abc import Iterator
from math import prod

import numpy as np
from mpi4py import MPI

from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import IdRange, allgather_rows, columns_of, in_id_order
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
    counts = ranks.allgather_array(np.array(len(mine["id"])))
    width = sum(prod(column.shape[1:]) for column in columns.values())

    def start(rank: int) -> tuple[dict[str, Array], MPI.Request]:
        """Begin to send the block of a rank to all."""
        buffer = np.empty(int(counts[rank]) * width, np.int64)
        block = dict(columns_of(buffer, int(counts[rank]), columns))
        if rank == ranks.rank:
            ranks.messages += 1
            for name, column in block.items():
                column[:] = mine[name]
        return block, ranks.comm.Ibcast(buffer, root=rank)

    coming = start(0)
    for rank in range(ranks.size):
        block, request = coming
        request.Wait()
        if rank + 1 < ranks.size:
            coming = start(rank + 1)
        yield block
