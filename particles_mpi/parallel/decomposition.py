"""Space is divided by recursive coordinate bisection: a binary tree of cuts assigns every point to one rank.

A point on a cut belongs to the upper side. The outermost domains extend to infinity, so that every finite position has an
owner, with or without a box. It is cut anew as soon as the time lost to imbalance exceeds what a cut costs.
"""

from __future__ import annotations

from math import inf
from time import perf_counter
from typing import NamedTuple

import numpy as np

from particles_mpi.kernels.jit import kernel
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import by_destination, send_rows
from particles_mpi.particles import Array, Particles
from particles_mpi.timers import Timers

BINS, ROUNDS = 64, 4  # of the search for a cut: each round divides the interval into so many bins and keeps one
LOOK_EVERY = 8  # searches for neighbours between two comparisons of the ranks' times
NOISE = 0.05  # of the mean time: differences between ranks with equal work on a shared machine
MOVING = 10.0  # cost of a new decomposition, in units of the time for the cuts: rows have to move too
WORK = ("search", "collide", "drift", "pairs")  # phases in which a rank works, and does not wait for others


class Decomposition(NamedTuple):
    """The cuts as a binary tree, node by node, and the domain of each rank."""

    axis: Array  # (nodes,) the axis that a node cuts
    cut: Array  # (nodes,) where
    below: Array  # (nodes,) the child on either side: a node, or -1 - rank if one rank owns that side
    above: Array
    lower: Array  # (ranks, d) corners of each rank's domain, a box
    upper: Array

    def owner(self, x: Array) -> Array:
        """The rank that owns each position of x (n, d); shape (n,)."""
        return owners(x, self.axis, self.cut, self.below, self.above)


def bisect(ranks: Communicator, x: Array, weight: float) -> Decomposition:
    """Cut space so that all ranks get equal work: each position of x (n, d) on this rank means `weight` units. Collective."""
    d = x.shape[1]
    nodes: list[tuple[int, float, int, int]] = []  # axis, cut, below, above
    lower, upper = np.full((ranks.size, d), -inf), np.full((ranks.size, d), inf)

    def split(first: int, last: int, rows: Array) -> int:
        """Divide the domain of the ranks first ... last - 1, with this rank's positions in it, among them; its node."""
        if last - first == 1:
            return -1 - first
        node, middle = len(nodes), (first + last) // 2
        k, at = best_cut(ranks, rows, weight, (middle - first) / (last - first))
        nodes.append((k, at, 0, 0))
        upper[first:middle, k] = at
        lower[middle:last, k] = at
        under = rows[:, k] < at
        nodes[node] = k, at, split(first, middle, rows[under]), split(middle, last, rows[~under])
        return node

    split(0, ranks.size, x)
    axis, cut, below, above = (np.array([node[c] for node in nodes], float if c == 1 else np.int64) for c in range(4))
    return Decomposition(axis, cut, below, above, lower, upper)


def best_cut(ranks: Communicator, x: Array, weight: float, share: float) -> tuple[int, float]:
    """(axis, position) of a cut of the longest axis, with `share` of the weight of all ranks' positions below it. Collective."""
    high, low = ranks.allreduce_max(np.array([x.max(axis=0, initial=-inf), -x.min(axis=0, initial=inf)]))
    low = -low
    if not np.all(high >= low):
        return 0, 0.0  # no positions at all: any cut will do
    k = int((high - low).argmax())
    left, right, passed, wanted = float(low[k]), float(np.nextafter(high[k], inf)), 0.0, None
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
    """The rank that owns each position of x (n, d), found by descending the tree."""
    owner = np.zeros(len(x), np.int64)
    for i in range(len(x)):
        node = 0 if len(axis) else -1
        while node >= 0:
            node = below[node] if x[i, axis[node]] < cut[node] else above[node]
        owner[i] = -1 - node
    return owner


def to_owners(ranks: Communicator, columns: dict[str, Array], parts: Decomposition) -> dict[str, Array]:
    """Rows to the ranks that own their positions; `columns` have a "position". Collective."""
    return send_rows(ranks, columns, *by_destination(parts.owner(columns["position"]), ranks.size))[0]


class LoadBalance:
    """Holds the domain decomposition. Which rank owns a particle never changes a result, so measured times may decide."""

    def __init__(self, ranks: Communicator, timers: Timers):
        self.ranks, self.timers = ranks, timers
        self.decomposition: Decomposition
        self.cuts = 0
        self.cost = self.lost = self.worked = 0.0

    def update(self, particles: Particles, searches: int) -> None:
        """Cut space for the first time, or again if that saves time; `searches`: for neighbours, so far. Collective."""
        if self.cuts == 0:
            self.cut(particles.position, 1.0)
        elif self.ranks.size > 1 and searches % LOOK_EVERY == 0:
            worked = sum(self.timers.seconds.get(phase, 0.0) for phase in WORK)
            mine, self.worked = worked - self.worked, worked
            times = np.array(self.ranks.allgather(mine))
            self.lost = max(self.lost + float(times.max() - (1.0 + NOISE) * times.mean()), 0.0)
            if self.lost > self.cost:
                each = mine / max(len(particles), 1)
                typical = float(times.sum()) / max(int(self.ranks.allreduce_sum(len(particles))[0]), 1)
                self.cut(particles.position, float(np.clip(each / typical, 0.5, 2.0)) if typical > 0.0 else 1.0)

    def cut(self, x: Array, weight: float) -> None:
        """A new decomposition, from this rank's positions x (n, d), each of which means `weight` units of work. Collective."""
        begin = perf_counter()
        self.decomposition = bisect(self.ranks, x, weight)
        self.cost = float(self.ranks.allreduce_max(perf_counter() - begin)[0]) * MOVING
        self.lost = 0.0
        self.cuts += 1
