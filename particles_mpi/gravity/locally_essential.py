"""Trees of several ranks: where the keys are cut, what of a tree is essential to another rank, how the parts are put together.

Plain arrays. A rank owns the particles between two keys. Of the cells of others it needs those that its own particles may
open (the locally essential tree: M. Warren and J. Salmon, Supercomputing '92, 570); all others it needs closed: moments only.
Put together in the order of keys they are the one tree of all particles, with branches closed that nobody here opens.
"""

from __future__ import annotations

import numpy as np

from particles_mpi.gravity.octree import CENTER, DEEPEST, GROUP, RADIUS, levels, of_parts
from particles_mpi.kernels.jit import kernel
from particles_mpi.particles import Array

SAMPLES = 512  # of its keys that a rank tells


def sample(keys: Array, work: Array) -> Array:
    """SAMPLES of a rank's sorted keys that cut its work into equal parts, and the work of all: (SAMPLES + 1,) int64."""
    reached = np.cumsum(work)
    total = reached[-1] if len(keys) else 0.0
    at = np.searchsorted(reached, (np.arange(SAMPLES) + 0.5) / SAMPLES * total)
    told = np.zeros(SAMPLES + 1, np.int64)
    if len(keys):
        told[:-1] = keys[np.minimum(at, len(keys) - 1)]
    told[-1:] = np.array([total]).view(np.int64)
    return told


def quantiles(table: Array) -> Array:
    """size - 1 keys that cut the work of all ranks, whose samples are table (size, SAMPLES + 1), into equal parts."""
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
    """First and last key of the cell of each level around each cut, (cuts, levels + 1)."""
    deep = levels(d)
    shift = d * (deep - np.arange(deep + 1))
    size = np.minimum(shift, 62)
    first = np.where(shift < 63, cuts[:, None] >> size << size, 0)
    return first, np.where(shift < 63, first + (1 << size) - 1, np.iinfo(np.int64).max)


def around(keys: Array, cuts: Array, d: int) -> Array:
    """How many of the sorted keys lie in the cell of each level around each cut, (cuts, levels + 1)."""
    first, last = cells_of(cuts, d)
    return np.searchsorted(keys, last, "right") - np.searchsorted(keys, first)


def snap(cuts: Array, found: Array, d: int) -> Array:
    """Each cut moved to the first key of its group, which so stays whole; `found` of all ranks together."""
    small = found <= GROUP
    small[:, -1] = True
    return cells_of(cuts, d)[0][np.arange(len(cuts)), small.argmax(axis=1)]


@kernel
def essential(skip, count, cells, boxes, angle):
    """The nodes that a rank needs whose branches lie in boxes (., 6), how many of their rows, and which.

    A cell is closed if it is far from all boxes: then it is far from all groups within them, in floating point too, since
    rounding keeps the order of numbers.
    """
    nodes, counts = np.empty(len(skip), np.int64), np.empty(len(skip), np.int64)
    first, before = np.empty(len(skip), np.int64), np.int64(0)
    for i in range(len(skip)):
        first[i] = before
        before += count[i]
    made, taken, node = 0, 0, 0
    while node < len(skip) and len(boxes):
        opened = False
        for b in range(len(boxes)):
            r2 = 0.0
            for k in range(3):
                c = cells[node, CENTER + k]
                r = max(boxes[b, k] - c, c - boxes[b, 3 + k], 0.0)
                r2 += r * r
            opened = opened or not angle * angle * r2 > cells[node, RADIUS] * cells[node, RADIUS]
        nodes[made], counts[made] = node, count[node] if opened else 0
        taken += counts[made]
        made += 1
        node = node + 1 if opened else skip[node]
    rows = np.empty(taken, np.int64)
    taken = 0
    for i in range(made):
        for p in range(counts[i]):
            rows[taken] = first[nodes[i]] + p
            taken += 1
    return nodes[:made], counts[:made], rows


@kernel
def assemble(branch_level, branch_key, level, root, d):
    """The tree of all: (source, level, place of each branch), from the levels of the branches' nodes; each begins with a `root`.

    source: a node's place in `level`, or -1 for a cell that belongs to several ranks; those are put in.
    """
    deep = min(63 // d, DEEPEST)
    most = len(level) + len(branch_level) * deep
    source, new_level, place = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(len(branch_level), np.int64)
    made, node = 0, 0
    for b in range(len(branch_level)):
        shared = -1  # the deepest level at which this branch and the one before lie in one cell
        while b > 0 and shared + 1 < branch_level[b]:
            shift = d * (deep - shared - 1)
            if shift < 63 and branch_key[b] >> shift != branch_key[b - 1] >> shift:
                break
            shared += 1
        for above in range(shared + 1, branch_level[b]):
            source[made], new_level[made] = -1, above
            made += 1
        place[b] = made
        while node < len(level) and (made == place[b] or not root[node]):
            source[made], new_level[made] = node, level[node]
            made, node = made + 1, node + 1
    return source[:made], new_level[:made], place


@kernel
def fill(source, skip, cells, bounds):
    """The moments of the cells that belong to several ranks, in place."""
    for i in range(len(source) - 1, -1, -1):
        if source[i] < 0:
            of_parts(i, skip, cells, bounds)
