"""Space, and the line of Morton keys, divided among the ranks: prints for each start (balance, reductions) as JSON."""

import json

import numpy as np

from particles_mpi.gravity.tree import equal_shares
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.decomposition import bisect

ranks = Communicator()
random = np.random.default_rng(ranks.rank)
N = 20_000
far = np.cbrt(random.random((N, 1)))
direction = random.normal(size=(N, 3))
direction /= np.linalg.norm(direction, axis=1)[:, None]
crowded = random.random((N, 3))
crowded[: N // 2] *= 1e-6
STARTS = {
    "even": random.random((N, 3)),
    "line": random.random((N, 1)),
    "plane": random.random((N, 2)) * [1.0, 1e-3],
    "cluster": direction * far / np.sqrt(1.001 - far**2),
    "crowded": crowded,
    "on one rank": random.random((N if ranks.rank == ranks.size - 1 else 0, 3)),
    "one place": np.ones((N, 3)),
    "nothing": np.empty((0, 2)),
}


def balance(owner, work):
    """The largest work of a rank, in units of the mean."""
    sums = ranks.allreduce_sum(np.bincount(owner, weights=work, minlength=ranks.size))
    return float(sums.max() / sums.mean()) if sums.any() else 1.0


told = {}
for name, x in STARTS.items():
    before = ranks.reductions
    found = bisect(ranks, x, 1.0)
    reductions = ranks.reductions - before
    owner = found.owner(x)
    assert ((x >= found.lower[owner]) & (x < found.upper[owner])).all(), name
    every = ranks.allgather([column.tolist() for column in found])
    assert all(one == every[0] for one in every), name  # the same cuts on all ranks
    keys = np.sort(((0.5 + 0.5 * np.tanh(x[:, 0])) * 2.0**62).astype(np.int64))
    work = 1.0 + random.random(len(x))
    before = ranks.reductions
    cuts = equal_shares(ranks, keys, work)
    rounds = ranks.reductions - before
    owner_of_key = np.searchsorted(cuts, keys, "right")
    assert len(cuts) == ranks.size - 1 and (np.diff(cuts) >= 0).all(), name
    told[name] = balance(owner, np.ones(len(x))), reductions, balance(owner_of_key, work), rounds
if ranks.is_root:
    print(json.dumps(told))
