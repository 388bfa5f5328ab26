"""Random rows to random ranks, many times; every rank knows all of it and checks what it gets. The cases: a JSON file."""

import json
import sys
from pathlib import Path

import numpy as np

from particles_mpi.parallel import buffers
from particles_mpi.parallel.buffers import RowBuffers
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import by_destination, id_range, in_id_order, send_rows
from particles_mpi.particles import Particles

ranks = Communicator()


def everyone(random, total, dimension):
    """Particles of all ranks, with values that show which row is which."""
    ids = random.permutation(total).astype(np.int64)
    x = ids[:, None] + np.linspace(0.0, 0.5, dimension)
    return {"id": ids, "position": x, "velocity": -x, "radius": ids * 2.0, "mass": ids + 0.5, "owner": -ids}


for seed, total, dimension, emptied in json.loads(Path(sys.argv[1]).read_text()):
    random = np.random.default_rng(seed)
    every = everyone(random, total, dimension)
    holder, owner = random.integers(0, ranks.size, total), random.integers(0, ranks.size, total)
    holder[holder == emptied] = ranks.size - 1
    owner[owner == (emptied + 1) % ranks.size] = 0
    mine = np.flatnonzero(holder == ranks.rank)

    held = {name: column[mine] for name, column in every.items()}
    order, counts = by_destination(owner[mine], ranks.size)
    arrived, arriving = send_rows(ranks, held, order, counts)
    expected = np.concatenate([np.flatnonzero((holder == p) & (owner == ranks.rank)) for p in range(ranks.size)])
    assert arriving.sum() == len(expected)
    for name, column in every.items():
        assert arrived[name].dtype == column.dtype and (arrived[name] == column[expected]).all(), (seed, name)

    buffers.ROWS_AT_ONCE = (100_000, 3)[seed % 2]
    store = RowBuffers(Particles(dimension, held))
    store.adopt()
    left = store.migrate(ranks, owner[mine])
    assert left == np.count_nonzero(owner[mine] != ranks.rank)
    shown = store.particles.arrays
    places = np.argsort(shown["id"])
    expected = np.flatnonzero(owner == ranks.rank)
    expected = expected[np.argsort(every["id"][expected])]
    for name, column in every.items():
        assert (shown[name][places] == column[expected]).all(), (seed, name)

    writers = 1 + seed % ranks.size
    ids = id_range(ranks, shown["id"])
    block = in_id_order(ranks, shown, ids, writers)
    assert (np.concatenate(ranks.allgather(block["id"])) == np.arange(total)).all()
    assert len(block["id"]) <= -(-total // writers)
    sent = ranks.messages
    again = in_id_order(ranks, block, ids, writers)  # now each has its own
    assert ranks.messages == sent and all(again[name] is block[name] for name in block)
if ranks.is_root:
    print("all arrived")
