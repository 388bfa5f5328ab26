"""Space is divided by recursive coordinate bisection: a binary tree of cuts assigns every point to one rank.

A point on a cut belongs to the upper side. The outermost domains extend to infinity, so that every finite position has an owner,
with or without a box. Space is divided again as soon as the time lost to imbalance exceeds the cost of that.
"""

from math import inf
from time import perf_counter
from typing import NamedTuple

import numpy as np

from particles_mpi.kernels.jit import kernel
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import by_destination, send_rows
from particles_mpi.particles import Array, Particles
from particles_mpi.timers import Timers

BINS, ROUNDS = 128, 4  # of the search for a cut: each round divides an interval into so many bins
FINE_ENOUGH = 0.02  # of the work of a part: with less in it, a bin is not divided once more
COMPARE_EVERY = 8  # searches for neighbours between two comparisons of the ranks' times
NOISE = 0.05  # of the mean time: differences between ranks with equal work on a shared machine
MOVING = 10.0  # cost of a new decomposition, in units of the time for the cuts: rows have to move too
WORKING = ("search", "collide", "drift", "pairs")  # phases in which a rank works, and does not wait for others


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


class Part(NamedTuple):
    """A box that is to be divided among the ranks first ... last - 1."""

    first: int
    last: int
    rows: Array  # (n, d) positions of this rank in it
    low: Array  # (d,) corners of a box around the positions of all ranks; they lie below `high`
    high: Array


def bisect(ranks: Communicator, x: Array, weight: float) -> Decomposition:
    """Cut space so that all ranks get equal work: each position of x (n, d) on this rank means `weight` units. Collective.

    All boxes of a level of the tree are cut together, so that there is one reduction a level, and more only where the positions
    of one box are crowded in a small part of it.
    """
    d = x.shape[1]
    axis, cut, children = [], [], []
    lower, upper = np.full((ranks.size, d), -inf), np.full((ranks.size, d), inf)
    level = [Part(0, ranks.size, x, *extent(ranks, x))] if ranks.size > 1 else []
    numbers = iter(range(1, ranks.size))  # of the nodes, level by level; the first one is 0
    while level:
        below_and_above: list[Part] = []
        for part, (k, at) in zip(level, best_cuts(ranks, level, weight), strict=True):
            middle, under = (part.first + part.last) // 2, part.rows[:, k] < at
            upper[part.first : middle, k] = lower[middle : part.last, k] = at
            across = np.arange(d) == k
            sides = (
                (part.first, middle, under, part.low, np.where(across, at, part.high)),
                (middle, part.last, ~under, np.where(across, at, part.low), part.high),
            )
            axis.append(k)
            cut.append(at)
            children.append([next(numbers) if last - first > 1 else -1 - first for first, last, *_ in sides])
            below_and_above += [Part(a, b, part.rows[inside], *box) for a, b, inside, *box in sides if b - a > 1]
        level = below_and_above
    below, above = np.array(children, np.int64).reshape(-1, 2).T.copy()
    return Decomposition(np.array(axis, np.int64), np.array(cut, float), below, above, lower, upper)


def extent(ranks: Communicator, x: Array) -> tuple[Array, Array]:
    """Corners (d,) of the least box low <= x < high with the positions (n, d) of all ranks; zeros without any. Collective."""
    ends = ranks.allreduce_max(np.array([x.max(axis=0, initial=-inf), -x.min(axis=0, initial=inf)]))
    low, high = -ends[1], np.nextafter(ends[0], inf)
    return (low, high) if np.all(high > low) and np.isfinite(ends).all() else (np.zeros(len(low)), np.zeros(len(low)))


def best_cuts(ranks: Communicator, parts: list[Part], weight: float) -> list[tuple[int, float]]:
    """For each part the (axis, position) of a cut across its longest axis: each side gets the work of the ranks there.

    An interval is divided into BINS, and the cut lies in one of them, as if the work in it were spread evenly; a bin with more
    than FINE_ENOUGH of the part's work is divided in turn. Collective.
    """
    d = parts[0].rows.shape[1]
    sums = ranks.allreduce_sum([[work_in_bins(p.rows[:, k], p.low[k], p.high[k]) * weight for k in range(d)] for p in parts])
    axes = [longest_axis(part, in_part) for part, in_part in zip(parts, sums)]
    lines = [(float(part.low[k]), float(part.high[k])) for part, k in zip(parts, axes)]
    sums = sums[np.arange(len(parts)), axes]
    total = sums.sum(axis=1)
    wanted = total * [((p.first + p.last) // 2 - p.first) / (p.last - p.first) for p in parts]
    passed, cuts = np.zeros(len(parts)), np.zeros(len(parts))
    searched = list(range(len(parts)))  # the parts whose cut is not good enough
    for _ in range(ROUNDS):
        left = []
        for i, in_line in zip(searched, sums):
            edges = np.linspace(*lines[i], BINS + 1)
            reached = passed[i] + np.concatenate(([0.0], np.cumsum(in_line)))
            beyond = min(max(int(np.searchsorted(reached, wanted[i])), 1), BINS)  # the edge at which the wanted share is reached
            before = beyond - 1
            lines[i], passed[i] = (float(edges[before]), float(edges[beyond])), reached[before]
            cuts[i] = np.interp(wanted[i], reached[before : beyond + 1], edges[before : beyond + 1])
            fine, (low, high) = in_line[before] <= FINE_ENOUGH * total[i], lines[i]
            left += [] if fine or not low < 0.5 * (low + high) < high else [i]
        if not left:
            break
        searched = left
        sums = ranks.allreduce_sum([work_in_bins(parts[i].rows[:, axes[i]], *lines[i]) * weight for i in searched])
    return list(zip(axes, cuts.tolist()))


def work_in_bins(x: Array, low: float, high: float) -> Array:
    """How many of the numbers x (n,) lie in each of the BINS into which low <= x < high is divided."""
    bins = np.searchsorted(np.linspace(low, high, BINS + 1), x, "right")
    return np.bincount(bins, minlength=BINS + 2)[1 : BINS + 1]


def longest_axis(part: Part, sums: Array) -> int:
    """The axis along which the positions of a part extend furthest; `sums` (d, BINS): the work in the bins of each axis."""
    some = sums > 0.0
    bins = np.where(some.any(axis=1), BINS - some.argmax(axis=1) - some[:, ::-1].argmax(axis=1), BINS)
    return int((bins * (part.high - part.low)).argmax())


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
    """Send rows to the ranks that own their positions; `columns` have a "position". Collective."""
    return send_rows(ranks, columns, *by_destination(parts.owner(columns["position"]), ranks.size))[0]


class LoadBalance:
    """Holds the decomposition. It may depend on measured times, because which rank owns a particle never changes a result."""

    def __init__(self, ranks: Communicator, timers: Timers):
        self.ranks, self.timers = ranks, timers
        self.decomposition: Decomposition
        self.cuts = 0
        self.cost = self.lost = self.worked = 0.0

    def update(self, particles: Particles, searches: int) -> None:
        """Divide space for the first time, or again if that saves time; `searches`: for neighbours, so far. Collective."""
        if self.cuts and (self.ranks.size == 1 or searches % COMPARE_EVERY):
            return
        worked = sum(self.timers.seconds.get(phase, 0.0) for phase in WORKING)
        mine, self.worked = worked - self.worked, worked
        weight = 1.0
        if self.cuts:
            longest, (total, count) = self.ranks.largest(mine)[0], self.ranks.allreduce_sum([mine, float(len(particles))])
            self.lost = max(self.lost + float(longest - (1.0 + NOISE) * total / self.ranks.size), 0.0)
            if self.lost <= self.cost:
                return
            each, typical = mine / max(len(particles), 1), float(total) / max(count, 1.0)
            weight = float(np.clip(each / typical, 0.5, 2.0)) if typical > 0.0 else 1.0
        begin = perf_counter()
        self.decomposition = bisect(self.ranks, particles.position, weight)
        self.cost = self.ranks.largest(perf_counter() - begin)[0] * MOVING
        self.lost = 0.0
        self.cuts += 1
