"""Attraction by a tree that all ranks share: each builds its part of it and receives the nodes of others that it needs.

Particles are sent to the rank that owns their Morton key, in equal shares of the work of the last evaluation, and the results are
sent back; which rank holds a particle otherwise does not matter. A cut between ranks never divides a group, so every list of
sources is made by one rank alone, always in the same order: the result has the same bits on any number of ranks.

A rank needs those cells of other ranks, with all their parts, that its own particles may open; of all other cells the moments are
enough. Together they are its locally essential tree (M. Warren and J. Salmon, Supercomputing '92, 570). Joined in the order of
keys it is the one tree of all particles, without the insides of cells that no group of this rank opens.
"""

from typing import NamedTuple

import numpy as np

from particles_mpi.gravity.octree import (
    CENTER,
    GROUP,
    RADIUS,
    combine_moments,
    distance2,
    divide,
    is_far,
    levels,
    moments,
    morton,
    skips,
    sort_ties,
)
from particles_mpi.gravity.sources import POTENTIAL
from particles_mpi.gravity.walk import RESULT, WORK, Law, Nodes, walk
from particles_mpi.kernels.jit import kernel
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import allgather_rows, rows_in_order, send_rows
from particles_mpi.particles import Array, rows_of

SECTIONS = 64  # into which the keys between two bounds of a cut are divided
KNOWN_WELL = 0.02  # of the work of a rank: a cut is known well enough where there is no more between its bounds
SMALLEST_POWER = -900  # the least power of two that the side of the cube may be
LAST_KEY = np.iinfo(np.int64).max


class TreeResult(NamedTuple):
    """What a tree gives for G = 1: accelerations (n, 3), zero beyond the dimension; potentials and the work of each row (n,)."""

    acceleration: Array
    potential: Array
    work: Array


class Tree:
    """The tree over the particles of `ranks`, in dimension 1, 2 or 3: `angle` is the opening angle, `softening2` eps^2.

    Far cells act by their mass and, with `quadrupoles`, by their second moments. `interactions`: sources that this rank added
    up in the last call, over all its targets, themselves included.
    """

    def __init__(self, ranks: Communicator, dimension: int, angle: float, softening2: float, quadrupoles: bool = True):
        self.ranks, self.dimension, self.law = ranks, dimension, Law(angle, softening2, quadrupoles)
        self.interactions = 0
        self.order = np.empty(0, np.int64)  # of this rank's rows by key in the last call, which is nearly that of the next

    def attract(self, ids: Array, position: Array, mass: Array, work: Array) -> TreeResult:
        """Return the attraction of all on each row, nan if a place is not finite. `work`: of the last call. Collective."""
        ranks, d, self.interactions = self.ranks, self.dimension, 0
        x = np.zeros((len(position), 3))
        x[:, :d] = position
        ends = np.full(7, -np.inf)
        if len(x):
            ends[:3], ends[3:6] = [column.max() for column in x.T], [-column.min() for column in x.T]
            ends[6] = not np.isfinite(ends[:6]).all()  # an extreme value is not a number where one of the numbers is none
        ends = ranks.allreduce_max(np.where(np.isnan(ends), np.inf, ends))
        lower, extent = -ends[3:6], float((ends[:3] + ends[3:6]).max())
        if not (extent < np.inf and ends[6] < 1.0):
            return named_columns(np.full((len(x), RESULT), np.nan))
        side = max(int(np.frexp(extent)[1]), SMALLEST_POWER)  # of the cube, as a power of two, so that cells are halved exactly
        unit = max(int(np.frexp(max(extent, self.law.softening2**0.5))[1]), SMALLEST_POWER)  # of length, as a power of two
        x, lower = np.ldexp(x, -unit), np.ldexp(lower, -unit)  # so that high powers of distances are never out of range
        keys = morton(x, lower, 2.0 ** (levels(d) - side + unit), d)
        before = self.order if len(self.order) == len(keys) else np.arange(len(keys))
        order = self.order = before[np.argsort(keys[before], kind="stable")]
        cuts = self.cut(keys[order], work[order])
        counts = np.diff(np.searchsorted(keys[order], cuts), prepend=0, append=len(keys)).astype(np.int32)
        arrived, arriving = send_rows(ranks, {"id": ids, "key": keys, "position": x, "mass": mass}, order, counts)
        by_key = np.argsort(arrived["key"], kind="stable")
        sort_ties(arrived["key"], arrived["id"], by_key)
        mine = rows_of(arrived, by_key)
        low, high = [0, *cuts][ranks.rank], [*(cuts - 1), LAST_KEY][ranks.rank]
        found = self.attract_sorted(mine["key"], mine["position"], mine["mass"], low, high, unit)
        back, _ = send_rows(ranks, {"result": found}, rows_in_order(by_key), arriving)
        return named_columns(back["result"].take(rows_in_order(order), axis=0))

    def cut(self, keys: Array, work: Array) -> Array:
        """The first key of every rank but the first, (ranks - 1,), from this rank's sorted keys. Collective.

        A cut that gives equal shares of the work moves to the first key of the group that it lies in, which is the largest cell
        around it with at most GROUP particles. In `first` and `last` are the keys at the ends of its cells, level by level.
        """
        cuts, d, deep = equal_shares(self.ranks, keys, work), self.dimension, levels(self.dimension)
        shift = d * (deep - np.arange(deep + 1))
        size = np.minimum(shift, 62)
        first = np.where(shift < 63, cuts[:, None] >> size << size, 0)
        last = np.where(shift < 63, first + (1 << size) - 1, LAST_KEY)
        counts = self.ranks.allreduce_sum(np.searchsorted(keys, last, "right") - np.searchsorted(keys, first))
        small = counts <= GROUP
        small[:, -1] = True
        return first[np.arange(len(cuts)), small.argmax(axis=1)]

    def attract_sorted(self, keys: Array, x: Array, mass: Array, low: int, high: int, unit: int) -> Array:
        """The result (n, RESULT) for this rank's targets, by key: all with keys from `low` to `high`. Collective.

        Positions are given in units of 2^unit.
        """
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
        law = self.law._replace(softening2=np.ldexp(self.law.softening2, -2 * unit))
        result, self.interactions = walk(tree, groups, offset, law)
        for columns in (slice(POTENTIAL + 1), slice(POTENTIAL)):
            result[:, columns] *= 2.0**-unit  # accelerations twice: a power of 2 unit may be out of range
        return result

    def exchange(
        self, nodes: dict[str, Array], rows: dict[str, Array], skip: Array, bounds: Array, rank: Array
    ) -> tuple[dict[str, Array], dict[str, Array], int]:
        """Essential nodes and rows of all ranks by key, and the first own row; `bounds`, `rank`: of all branches. Collective."""
        ranks, first = self.ranks, np.cumsum(nodes["count"]) - nodes["count"]
        boxes = [bounds[rank == p] if p != ranks.rank else bounds[:0] for p in range(ranks.size)]
        parts = [select_essential(skip, nodes["count"], first, nodes["cell"], box, self.law.angle) for box in boxes]
        chosen, counts, chosen_rows = (np.concatenate([part[k] for part in parts]) for k in range(3))
        node_numbers, row_numbers = (np.array([len(part[k]) for part in parts], np.int32) for k in (0, 2))
        outgoing = {name: column[chosen] for name, column in nodes.items()} | {"count": counts}
        their_nodes, nodes_arriving = send_rows(ranks, outgoing, np.arange(len(chosen)), node_numbers)
        their_rows, rows_arriving = send_rows(ranks, rows, chosen_rows, row_numbers)
        nodes_before, rows_before = (int(arriving[: ranks.rank].sum()) for arriving in (nodes_arriving, rows_arriving))
        return inserted(nodes, their_nodes, nodes_before), inserted(rows, their_rows, rows_before), rows_before


def named_columns(result: Array) -> TreeResult:
    """The columns of a result (n, RESULT)."""
    return TreeResult(result[:, :POTENTIAL], result[:, POTENTIAL], result[:, WORK])


def inserted(mine: dict[str, Array], theirs: dict[str, Array], place: int) -> dict[str, Array]:
    """The rows of others with this rank's own inserted at `place`."""
    if not any(map(len, theirs.values())):
        return mine
    return {name: np.concatenate((theirs[name][:place], mine[name], theirs[name][place:])) for name in mine}


def equal_shares(ranks: Communicator, keys: Array, work: Array) -> Array:
    """The ranks - 1 keys that divide the work of all ranks into equal parts; keys (n,): sorted, work (n,). Collective.

    For all cuts at once the keys between two bounds are divided into SECTIONS, and the section that holds the cut is kept, until
    there is little work in it: a number of reductions that grows as the logarithm of the number of ranks.
    """
    low, high = np.zeros(ranks.size - 1, np.int64), np.full(ranks.size - 1, LAST_KEY)
    before = np.concatenate(([0.0], np.cumsum(work)))
    every = np.arange(len(low))
    while True:
        step = np.maximum((high - low) // SECTIONS, 1)
        edges = np.column_stack((low[:, None] + np.minimum(step[:, None] * np.arange(SECTIONS), (high - low)[:, None]), high))
        reached = ranks.allreduce_sum(np.append(before[np.searchsorted(keys, edges)], before[-1]))
        total, reached = reached[-1], reached[:-1].reshape(edges.shape)
        wanted = total * np.arange(1, ranks.size) / ranks.size
        at = np.minimum((reached <= wanted[:, None]).sum(axis=1), SECTIONS)  # the first edge beyond, if there is one
        at = np.maximum(at, 1)
        low, high = edges[every, at - 1], edges[every, at]
        if not ((reached[every, at] - reached[every, at - 1] > KNOWN_WELL * total / ranks.size) & (high - low > 1)).any():
            return low


@kernel
def select_essential(skip, count, first, cells, boxes, angle):
    """Select what a rank needs of this rank's nodes, whose rows begin at `first`, if its branches have the bounding boxes (b, 6).

    Returns the numbers of the nodes, how many of the particles of each are needed, and the rows of those particles. A cell that
    is far from all boxes is sent without its parts: it is then far from all groups within the boxes, in floating point too,
    because rounding preserves order, and `is_far` is the very test that the walk makes.
    """
    angle2 = angle * angle
    nodes, counts, rows = [], [], []
    node = 0
    while node < len(skip) and len(boxes):
        opened = False
        for b in range(len(boxes)):
            lx, ly, lz, hx, hy, hz = boxes[b, 0], boxes[b, 1], boxes[b, 2], boxes[b, 3], boxes[b, 4], boxes[b, 5]
            cx, cy, cz = cells[node, CENTER], cells[node, CENTER + 1], cells[node, CENTER + 2]
            apart2 = distance2(lx, ly, lz, hx, hy, hz, cx, cy, cz)
            opened = opened or not is_far(apart2, cells[node, RADIUS], angle2)
        nodes.append(node)
        counts.append(count[node] if opened else 0)
        for p in range(first[node], first[node] + counts[-1]):
            rows.append(p)
        node = node + 1 if opened else skip[node]
    return np.array(nodes), np.array(counts), np.array(rows)


@kernel
def assemble(branch_level, branch_key, level, root, d):
    """Join the branches of all ranks to one tree in preorder, with the cells above them, which several ranks share.

    `branch_level`, `branch_key` (b,): level and first key of every branch; `level`, `root` (n,): the level of every node of
    the branches that are here, and whether it is the first of its branch. Returns for each node of the joined tree its
    place in `level`, or -1 for a shared cell, and its level; and for each branch the node that it became.
    """
    deep, node = levels(d), 0
    source, new_level, place = [], [], np.empty_like(branch_level)
    for b in range(len(branch_level)):
        shared = -1  # the deepest level at which one cell contains both this branch and the one before
        while b > 0 and shared + 1 < branch_level[b]:
            shift = d * (deep - shared - 1)
            if shift < 63 and branch_key[b] >> shift != branch_key[b - 1] >> shift:
                break
            shared += 1
        for above in range(shared + 1, branch_level[b]):
            source.append(-1)
            new_level.append(above)
        place[b] = len(source)
        while node < len(level) and (len(source) == place[b] or not root[node]):
            source.append(node)
            new_level.append(level[node])
            node += 1
    return np.array(source), np.array(new_level), place


@kernel
def add_shared_moments(source, skip, cells, bounds):
    """The moments and bounding boxes of the cells that several ranks share (source -1). In place."""
    for i in range(len(source) - 1, -1, -1):
        if source[i] < 0:
            combine_moments(i, skip, cells, bounds)
