"""Attraction by a tree that all ranks share: each builds its part of it and receives the nodes of others that it needs.

Particles are sent to the rank that owns their Morton key, in equal shares of the work of the last evaluation, and the results are
sent back; which rank holds a particle otherwise does not matter. A cut between ranks never divides a group, so every list of
sources is made by one rank alone, always in the same order: the result has the same bits on any number of ranks.
"""

from __future__ import annotations

import numpy as np

from particles_mpi.gravity.locally_essential import (
    add_shared_moments,
    assemble,
    count_in_cells,
    cut_between_groups,
    quantiles,
    sample_keys,
    select_essential,
)
from particles_mpi.gravity.octree import divide, levels, moments, morton, skips, sort_ties
from particles_mpi.gravity.walk import RESULT, Law, Nodes, walk
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import allgather_rows, send_rows
from particles_mpi.particles import Array, rows_of

SMALLEST = -900  # the least power of two that the side of the cube may be
LAST_KEY = np.iinfo(np.int64).max


class Tree:
    """The tree over the particles of `ranks`, in dimension 1, 2 or 3: `angle` is the opening angle, `softening2` eps^2.

    Far cells act by their mass and, with `quadrupoles`, by their second moments. `interactions`: sources that this rank added
    up in the last call, over all its targets, themselves included.
    """

    def __init__(self, ranks: Communicator, dimension: int, angle: float, softening2: float, quadrupoles: bool = True):
        self.ranks, self.dimension, self.law = ranks, dimension, Law(angle, softening2, quadrupoles)
        self.interactions = 0

    def attract(self, ids: Array, position: Array, mass: Array, work: Array) -> Array:
        """Acceleration, potential and work of this rank's particles for G = 1, (n, RESULT); nan if a position is not finite.

        `work` (n,): an estimate of each particle's share of the work, that of the last call, or ones. Collective.
        """
        ranks, d, self.interactions = self.ranks, self.dimension, 0
        x = np.zeros((len(position), 3))
        x[:, :d] = position
        ends = np.full(7, -np.inf)
        if len(x):
            ends[:3], ends[3:6], ends[6] = x.max(axis=0), -x.min(axis=0), not np.isfinite(x).all()
        ends = ranks.allreduce_max(ends)
        lower, extent = -ends[3:6], float((ends[:3] + ends[3:6]).max())
        if not (extent < np.inf and ends[6] < 1.0):
            return np.full((len(x), RESULT), np.nan)
        side = max(int(np.frexp(extent)[1]), SMALLEST)  # of the cube, as a power of two, so that cells are halved exactly
        keys = morton(x, lower, 2.0 ** (levels(d) - side), d)
        order = np.argsort(keys, kind="stable")
        cuts = self.cut(keys[order], work[order])
        counts = np.diff(np.searchsorted(keys[order], cuts), prepend=0, append=len(keys)).astype(np.int32)
        arrived, arriving = send_rows(ranks, {"id": ids, "key": keys, "position": x, "mass": mass}, order, counts)
        by_key = np.argsort(arrived["key"], kind="stable")
        sort_ties(arrived["key"], arrived["id"], by_key)
        mine = rows_of(arrived, by_key)
        low, high = [0, *cuts][ranks.rank], [*(cuts - 1), LAST_KEY][ranks.rank]
        theirs, result = np.empty((len(by_key), RESULT)), np.empty((len(x), RESULT))
        theirs[by_key] = self.attract_sorted(mine["key"], mine["position"], mine["mass"], low, high)
        result[order] = send_rows(ranks, {"result": theirs}, np.arange(len(theirs)), arriving)[0]["result"]
        return result

    def cut(self, keys: Array, work: Array) -> Array:
        """The first key of every rank but the first, (ranks - 1,), from this rank's sorted keys. Collective."""
        cuts = quantiles(self.ranks.allgather_array(sample_keys(keys, work)))
        return cut_between_groups(cuts, self.ranks.allreduce_sum(count_in_cells(keys, cuts, self.dimension)), self.dimension)

    def attract_sorted(self, keys: Array, x: Array, mass: Array, low: int, high: int) -> Array:
        """The result (n, RESULT) for this rank's targets, by key: all with keys from `low` to `high`. Collective."""
        ranks, d = self.ranks, self.dimension
        level, count, groups, branches = divide(keys, d, low, high)
        roots = branches[:, 0].copy()
        skip = skips(level, roots)
        cells, bounds = moments(skip, count, x, mass)
        mine = {"level": level[roots], "key": branches[:, 1], "bounds": bounds[roots], "rank": np.full(len(roots), ranks.rank)}
        every = allgather_rows(ranks, mine)
        nodes = {"level": level, "count": count, "cell": cells, "root": np.isin(np.arange(len(level)), roots)}
        nodes, rows, offset = self.exchange(nodes, {"position": x, "mass": mass}, skip, every["bounds"], every["rank"])
        if not len(x):
            return np.empty((0, RESULT))
        source, level, place = assemble(every["level"], every["key"], nodes["level"], nodes["root"], d)
        skip = skips(level, np.zeros(1, np.int64))
        cells = nodes["cell"][source]
        count = np.where(source >= 0, nodes["count"][source], 0)
        bounds = np.empty((len(source), 6))
        bounds[place] = every["bounds"]
        add_shared_moments(source, skip, cells, bounds)
        tree = Nodes(skip, np.cumsum(count) - count, count, cells, rows["position"], rows["mass"])
        result, self.interactions = walk(tree, groups, offset, self.law)
        return result

    def exchange(
        self, nodes: dict[str, Array], rows: dict[str, Array], skip: Array, bounds: Array, rank: Array
    ) -> tuple[dict[str, Array], dict[str, Array], int]:
        """The locally essential nodes and rows of all ranks, in the order of keys, and where this rank's rows begin. Collective.

        `bounds` (b, 6), `rank` (b,): bounding box and owner of the branches of all ranks.
        """
        ranks, first = self.ranks, np.cumsum(nodes["count"]) - nodes["count"]
        boxes = [bounds[rank == p] if p != ranks.rank else bounds[:0] for p in range(ranks.size)]
        parts = [select_essential(skip, nodes["count"], first, nodes["cell"], box, self.law.angle) for box in boxes]
        chosen, counts, chosen_rows = (np.concatenate([part[k] for part in parts]) for k in range(3))
        node_numbers, row_numbers = (np.array([len(part[k]) for part in parts], np.int32) for k in (0, 2))
        outgoing = {name: column[chosen] for name, column in nodes.items()} | {"count": counts}
        their_nodes, nodes_arriving = send_rows(ranks, outgoing, np.arange(len(chosen)), node_numbers)
        their_rows, rows_arriving = send_rows(ranks, rows, chosen_rows, row_numbers)
        nodes_before, rows_before = (int(arriving[: ranks.rank].sum()) for arriving in (nodes_arriving, rows_arriving))
        return insert(nodes, their_nodes, nodes_before), insert(rows, their_rows, rows_before), rows_before


def insert(mine: dict[str, Array], theirs: dict[str, Array], place: int) -> dict[str, Array]:
    """The rows of others with this rank's own inserted at `place`."""
    return {name: np.concatenate((theirs[name][:place], mine[name], theirs[name][place:])) for name in mine}
