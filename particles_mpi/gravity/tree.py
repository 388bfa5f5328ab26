"""Attraction by a tree that is shared by all ranks: each builds its part and receives what is essential to it.

Particles go to the rank that owns their Morton key, in equal shares of the work of the last time, and the results go back;
where a particle lives otherwise does not matter. A cut never divides a group, so that every list of sources is that of one
rank alone, in the same order: the same bits on any number of ranks.
"""

from __future__ import annotations

import numpy as np

from particles_mpi.gravity.locally_essential import around, assemble, essential, fill, quantiles, sample, snap
from particles_mpi.gravity.octree import divide, levels, moments, morton, skips, sort_ties
from particles_mpi.gravity.walk import walk
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import allgather_rows, send_rows
from particles_mpi.particles import Array

RESULT = 5  # acceleration on three axes, potential, work
SMALLEST = -900  # power of two of the side of a cube, whatever lies in it


class Tree:
    """For particles in `dimension` (1, 2 or 3) on some ranks: `angle` is the opening angle, `softening2` eps^2.

    Far cells act by mass and, with `quadrupoles`, by second moments. `interactions`: particles and cells that this rank added
    up in the last call, over all its targets, themselves included.
    """

    def __init__(self, ranks: Communicator, dimension: int, angle: float, softening2: float, quadrupoles: bool = True):
        self.ranks, self.dimension, self.angle, self.softening2 = ranks, dimension, angle, softening2
        self.quadrupoles, self.interactions = quadrupoles, 0

    def attract(self, ids: Array, position: Array, mass: Array, work: Array) -> Array:
        """Acceleration, potential and work for G = 1, (n, 5), of this rank's particles by those of all; nan if one is not finite.

        `work` (n,): a guess of each particle's share, that of the last time, or ones. Collective.
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
        if ranks.size == 1:
            sort_ties(keys, ids, order)
            result = np.empty((len(x), RESULT))
            result[order] = self.of_my_keys(keys[order], x[order], mass[order], 0, np.iinfo(np.int64).max)
            return result
        cuts = self.cut(keys[order], work[order])
        counts = np.diff(np.searchsorted(keys[order], cuts), prepend=0, append=len(keys)).astype(np.int32)
        arrays = {"id": ids, "key": keys, "position": x, "mass": mass}
        came, arriving = send_rows(ranks, arrays, order, counts)
        sorting = np.argsort(came["key"], kind="stable")
        sort_ties(came["key"], came["id"], sorting)
        low, high = ([0, *cuts][ranks.rank], [*(cuts - 1), np.iinfo(np.int64).max][ranks.rank])
        result = np.empty((len(sorting), RESULT))
        result[sorting] = self.of_my_keys(came["key"][sorting], came["position"][sorting], came["mass"][sorting], low, high)
        back, _ = send_rows(ranks, {"result": result}, np.arange(len(result)), arriving)
        result = np.empty((len(x), RESULT))
        result[order] = back["result"]
        return result

    def cut(self, keys: Array, work: Array) -> Array:
        """The first key of every rank but the first, from the sorted keys of all. Collective."""
        cuts = quantiles(self.ranks.allgather_array(sample(keys, work)))
        return snap(cuts, self.ranks.allreduce_sum(around(keys, cuts, self.dimension)), self.dimension)

    def of_my_keys(self, keys: Array, x: Array, mass: Array, low: int, high: int) -> Array:
        """The result (n, 5) of this rank's particles, in the order of keys: all those with keys low ... high. Collective."""
        ranks, d = self.ranks, self.dimension
        level, count, groups, branches = divide(keys, d, low, high)
        roots = branches[:, 0].copy()
        skip = skips(level, roots)
        cells, bounds = moments(skip, count, x, mass)
        mine = {
            "level": level[roots],
            "key": branches[:, 1].copy(),
            "bounds": bounds[roots],
            "rank": np.full(len(roots), ranks.rank),
        }
        everyone = allgather_rows(ranks, mine) if ranks.size > 1 else mine
        nodes = {"level": level, "count": count, "cell": cells, "root": np.isin(np.arange(len(level)), roots)}
        rows = {"position": x, "mass": mass}
        offset = 0
        if ranks.size > 1:
            nodes, rows, offset = self.gather(nodes, rows, skip, everyone["bounds"], everyone["rank"])
        if not len(x):
            return np.empty((0, RESULT))
        source, level, place = assemble(everyone["level"], everyone["key"], nodes["level"], nodes["root"], d)
        skip, known = skips(level, np.zeros(1, np.int64)), source >= 0
        cells = nodes["cell"][source]
        count = np.where(known, nodes["count"][source], 0)
        bounds = np.empty((len(source), 6))
        bounds[place] = everyone["bounds"]
        fill(source, skip, cells, bounds)
        first = np.cumsum(count) - count
        arrays = groups, skip, first, count, cells, rows["position"], rows["mass"]
        result, self.interactions = walk(*arrays, offset, self.angle, self.softening2, self.quadrupoles)
        return result

    def gather(
        self, nodes: dict[str, Array], rows: dict[str, Array], skip: Array, bounds: Array, rank: Array
    ) -> tuple[dict[str, Array], dict[str, Array], int]:
        """Nodes and rows of all ranks that matter here, in the order of keys, and where this rank's rows begin. Collective."""
        ranks = self.ranks
        parts = []
        for p in range(ranks.size):
            boxes = bounds[rank == p] if p != ranks.rank else bounds[:0]
            parts.append(essential(skip, nodes["count"], nodes["cell"], boxes, self.angle))
        chosen, counts, taken = (np.concatenate([part[k] for part in parts]) for k in range(3))
        numbers, row_numbers = (np.array([len(part[k]) for part in parts], np.int32) for k in (0, 2))
        outgoing = {name: column[chosen] for name, column in nodes.items()} | {"count": counts}
        theirs, arriving = send_rows(ranks, outgoing, np.arange(len(chosen)), numbers)
        their_rows, rows_arriving = send_rows(ranks, rows, taken, row_numbers)
        before, rows_before = int(arriving[: ranks.rank].sum()), int(rows_arriving[: ranks.rank].sum())
        return between(nodes, theirs, before), between(rows, their_rows, rows_before), rows_before


def between(mine: dict[str, Array], theirs: dict[str, Array], place: int) -> dict[str, Array]:
    """Rows of others with this rank's put in at `place`."""
    return {name: np.concatenate((theirs[name][:place], mine[name], theirs[name][place:])) for name in mine}
