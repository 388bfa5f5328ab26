"""Recursive coordinate bisection: a binary tree of cuts gives every point of space to one rank.

Half-open: a point on a cut belongs to the upper side. The outermost domains reach to infinity, so every finite position
has an owner, in a box or in open space.
"""

from __future__ import annotations

from math import inf

import numpy as np

from particles_mpi.kernels.jit import kernel
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Array

BINS = 64  # of a cut's search; each round narrows it 64-fold
ROUNDS = 4


class Decomposition:
    """The cuts, as arrays over the tree's nodes, and the box of each rank: `lower`, `upper` (size, d).

    Node k cuts `axis[k]` at `cut[k]`; `below[k]`, `above[k]` are its children, or -1 - rank.
    """

    def __init__(self, axis: Array, cut: Array, below: Array, above: Array, lower: Array, upper: Array):
        self.axis, self.cut, self.below, self.above = axis, cut, below, above
        self.lower, self.upper = lower, upper

    def owner(self, x: Array) -> Array:
        """The rank of each position of x (n, d), shape (n,)."""
        return owners(x, self.axis, self.cut, self.below, self.above)


def bisect(ranks: Communicator, x: Array, weight: float) -> Decomposition:
    """Cut space so that each rank gets an equal share of the work, `weight` a row of x (n, d) on this rank. Collective."""
    d = x.shape[1]
    axis: list[int] = []
    cut: list[float] = []
    below: list[int] = []
    above: list[int] = []
    lower, upper = np.full((ranks.size, d), -inf), np.full((ranks.size, d), inf)

    def split(first: int, last: int, rows: Array) -> int:
        if last - first == 1:
            return -1 - first
        node, middle = len(cut), (first + last) // 2
        k, at = best_cut(ranks, rows, weight, (middle - first) / (last - first))
        axis.append(k)
        cut.append(at)
        below.append(0)
        above.append(0)
        upper[first:middle, k] = at
        lower[middle:last, k] = at
        under = rows[:, k] < at
        below[node] = split(first, middle, rows[under])
        above[node] = split(middle, last, rows[~under])
        return node

    split(0, ranks.size, x)
    return Decomposition(
        np.array(axis, np.int64), np.array(cut, float), np.array(below, np.int64), np.array(above, np.int64), lower, upper
    )


def best_cut(ranks: Communicator, x: Array, weight: float, share: float) -> tuple[int, float]:
    """(axis, position) that leaves `share` of the weight of all ranks' rows below, across the longest axis. Collective."""
    d = x.shape[1]
    ends = np.full(2 * d, -inf)
    if len(x):
        ends = np.concatenate((x.max(axis=0), -x.min(axis=0)))
    ends = ranks.allreduce_max(ends)
    high, low = ends[:d], -ends[d:]
    if not np.all(high >= low):
        return 0, 0.0  # no rows at all: any cut will do
    k = int((high - low).argmax())
    left, right, passed = float(low[k]), float(np.nextafter(high[k], inf)), 0.0
    wanted = None
    for _ in range(ROUNDS):
        edges = np.linspace(left, right, BINS + 1)
        inside = x[(x[:, k] >= left) & (x[:, k] < right), k]
        sums = ranks.allreduce_sum(np.bincount(np.searchsorted(edges, inside, "right") - 1, minlength=BINS)[:BINS] * weight)
        if wanted is None:
            wanted = share * sums.sum()
        reached = passed + np.cumsum(sums)
        bin_ = min(int(np.searchsorted(reached, wanted)), BINS - 1)
        passed = passed if bin_ == 0 else float(reached[bin_ - 1])
        left, right = float(edges[bin_]), float(edges[bin_ + 1])
        if not left < 0.5 * (left + right) < right:
            break
    return k, right


@kernel
def owners(x, axis, cut, below, above):
    """The rank that holds each row, by descending the tree."""
    owner = np.zeros(len(x), np.int64)
    for i in range(len(x)):
        node = 0 if len(axis) else -1
        while node >= 0:
            node = below[node] if x[i, axis[node]] < cut[node] else above[node]
        owner[i] = -1 - node
    return owner
