"""One tree on several ranks: where the range of keys is cut, which nodes another rank needs, how the parts are joined.

Arrays only, no messages. A rank owns the particles whose keys lie between two cuts. Of the other ranks' cells it needs with all
their parts those that its own particles may open; of all others the moments are enough. Together they are its locally
essential tree (M. Warren and J. Salmon, Supercomputing '92, 570): joined in the order of keys it is the one tree of all
particles, without the insides of cells that nobody on this rank opens.
"""

from __future__ import annotations

import numpy as np

from particles_mpi.gravity.octree import CENTER, GROUP, RADIUS, combine_moments, is_far, levels
from particles_mpi.kernels.jit import kernel
from particles_mpi.particles import Array

SAMPLES = 512  # keys that each rank sends to all others, to find the cuts


def sample_keys(keys: Array, work: Array) -> Array:
    """SAMPLES of a rank's sorted keys (n,) that divide its `work` (n,) into equal parts, and its total work; int64.

    The work is a float64 in the last place, as its 64 bits.
    """
    reached = np.cumsum(work)
    if not len(keys):
        return np.zeros(SAMPLES + 1, np.int64)
    at = np.searchsorted(reached, (np.arange(SAMPLES) + 0.5) / SAMPLES * reached[-1])
    return np.append(keys[np.minimum(at, len(keys) - 1)], reached[-1:].view(np.int64))


def quantiles(table: Array) -> Array:
    """The size - 1 keys that divide the work of all ranks into equal parts; table (size, SAMPLES + 1): their samples."""
    size = len(table)
    work = np.repeat(table[:, -1].copy().view(np.float64) / SAMPLES, SAMPLES)
    keys = table[:, :-1].reshape(-1)
    keys, work = keys[work > 0.0], work[work > 0.0]
    if not len(keys):
        return np.zeros(size - 1, np.int64)
    order = np.argsort(keys, kind="stable")
    reached = np.cumsum(work[order])
    at = np.searchsorted(reached, np.arange(1, size) / size * reached[-1])
    return keys[order][np.minimum(at, len(keys) - 1)]


def cells_of(cuts: Array, d: int) -> tuple[Array, Array]:
    """First and last key of the cell that contains each cut, for every level: two arrays (cuts, levels + 1)."""
    deep = levels(d)
    shift = d * (deep - np.arange(deep + 1))
    size = np.minimum(shift, 62)
    first = np.where(shift < 63, cuts[:, None] >> size << size, 0)
    return first, np.where(shift < 63, first + (1 << size) - 1, np.iinfo(np.int64).max)


def count_in_cells(keys: Array, cuts: Array, d: int) -> Array:
    """How many of the sorted keys lie in the cells of `cells_of`, (cuts, levels + 1)."""
    first, last = cells_of(cuts, d)
    return np.searchsorted(keys, last, "right") - np.searchsorted(keys, first)


def cut_between_groups(cuts: Array, counts: Array, d: int) -> Array:
    """Each cut moved to the first key of the group it lies in, so that no group is divided.

    `counts` (cuts, levels + 1): the sum of `count_in_cells` over all ranks.
    """
    small = counts <= GROUP
    small[:, -1] = True
    return cells_of(cuts, d)[0][np.arange(len(cuts)), small.argmax(axis=1)]


@kernel
def select_essential(skip, count, first, cells, boxes, angle):
    """What a rank needs of this rank's nodes, whose rows begin at `first`, if its branches have the bounding boxes (b, 6).

    Returns the numbers of the nodes, how many of the particles of each are needed, and the rows of those particles. A cell that
    is far from all boxes is sent without its parts: it is then far from all groups within the boxes, in floating point
    too, because rounding preserves order, and `is_far` is the very test that the walk makes.
    """
    angle2 = angle * angle
    nodes, counts, rows = [], [], []
    node = 0
    while node < len(skip) and len(boxes):
        opened = False
        for b in range(len(boxes)):
            lx, ly, lz, hx, hy, hz = boxes[b, 0], boxes[b, 1], boxes[b, 2], boxes[b, 3], boxes[b, 4], boxes[b, 5]
            cx, cy, cz = cells[node, CENTER], cells[node, CENTER + 1], cells[node, CENTER + 2]
            opened = opened or not is_far(lx, ly, lz, hx, hy, hz, cx, cy, cz, cells[node, RADIUS], angle2)
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
