"""Velocities that let no contact close: the inelastic law of J. J. Moreau (Comput. Methods Appl. Mech. Eng. 177, 329 (1999)).

Of all velocities at which no contact closes faster than it may, those nearest to the present ones, in kinetic energy, are
sought. With p >= 0 the impulses of the contacts, N their normals, W = 1/m and c the speeds at which they may close, p is the
minimum of p A p/2 + p (N v + c) with A = N^T W N. It is found by accelerated projected gradients with restarts (Y. Nesterov; B.
O'Donoghue and E. Candes, Found. Comput. Math. 15, 715 (2015); for contacts H. Mazhar et al., ACM Trans. Graph. 34, 32 (2015)):

    p' = max(y - (N u + c)/D, 0),   u = v + W N y,   y' = p' + beta (p' - p).

D is diagonal: for each row i the largest eigenvalue of the sum of n n^T over its contacts is bounded by b_i, and
D = w_i b_i + w_j b_j makes D - A positive, so no step is too long. Instead of the impulse p of a contact its *taken* speed
p (w_i + w_j) is kept, the approach that it takes from its partners. A half-edge is computed by the owner of its row, from
velocities that ranks exchange in each iteration; all sums are in the order of half-edges (`graph`). So the bits are the same on
any number of ranks. To take a friction cone, the projection max(., 0) is what has to be replaced.
"""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt
from typing import NamedTuple

import numpy as np

from particles_mpi.kernels.jit import inner, kernel
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import allgather_rows
from particles_mpi.particles import Array, rows_of

CHECK = 5  # iterations between two looks at what is left
FINE, LARGE = 2.0**24, 2.0**14  # of whole numbers that stand for sums: units of 1, and the largest number
MOST = 5000  # iterations
OUTLIER = 20.0  # times the root mean square that is allowed may the largest error be
FEW = 10_000  # half-edges of all ranks: so many are solved for by each
EFFORT = 200_000  # half-edges times iterations that are always spent, as long as it is no waste: small piles are exact


class Edges(NamedTuple):
    """The contacts that are solved for, as half-edges: those of row i are start[i] ... start[i + 1] - 1.

    start (n + 1,); partner (m,): a row or ghost, or the row of zeros behind them that stands for walls; normal (m, d), towards
    the row; share (m,): the part of what a contact takes that the row gives; step (m,): length of a gradient step,
    (w_i + w_j)/D, and 0 for contacts that take nothing.
    """

    start: Array
    partner: Array
    normal: Array
    share: Array
    step: Array


class Targets(NamedTuple):
    """What is asked of each half-edge, (m,): it may close at `may_close`. An error in speed is allowed up to 1/`loose`, as root
    mean square; below 1/`tight` nothing is left but round-off."""

    may_close: Array
    loose: Array
    tight: Array


def edges_of(
    axes: tuple[int, ...], start: Array, partner: Array, normal: Array, w: Array, which: Array, exchange: Callable[[Array], None]
) -> Edges:  # fmt: skip
    """The contacts of rows with inverse masses w (size + 1,), of which those that `which` (m,) marks may take anything.

    `exchange` gives ghosts the numbers of their owners. Collective.
    """
    bound = np.zeros(len(w))
    bound_rows(axes, start, normal, w, which, bound)
    exchange(bound)
    return Edges(start, partner, normal, *step_lengths(start, partner, w, which, bound))


@kernel
def bound_rows(axes, start, normal, w, which, bound):
    """Of each row w b, where b bounds the largest eigenvalue of S = sum of n n^T: tr S |(S/tr S)^4|^(1/4)."""
    s, t = np.empty((len(axes), len(axes))), np.empty((len(axes), len(axes)))
    for i in range(len(start) - 1):
        trace = 0.0
        for e in range(start[i], start[i + 1]):
            trace += which[e]
        if trace <= 1.0:
            bound[i] = w[i] * trace
            continue
        s[:] = 0.0
        for e in range(np.uint64(start[i]), np.uint64(start[i + 1])):
            if not which[e]:
                continue
            for k in range(len(axes)):
                part = normal[e, np.uint64(k)] / trace
                for m in range(len(axes)):
                    s[k, m] += part * normal[e, np.uint64(m)]
        for _ in range(2):
            for k in range(len(axes)):
                for m in range(len(axes)):
                    total = 0.0
                    for q in range(len(axes)):
                        total += s[k, q] * s[m, q]
                    t[k, m] = total
            s, t = t, s
        size2 = 0.0
        for k in range(len(axes)):
            for m in range(len(axes)):
                size2 += s[k, m] * s[k, m]
        bound[i] = w[i] * trace * sqrt(sqrt(sqrt(size2)))


@kernel
def step_lengths(start, partner, w, which, bound):
    """(shares, lengths of a gradient step) of all half-edges."""
    share, step = np.empty(len(partner)), np.empty(len(partner))
    for i in range(len(start) - 1):
        for e in range(start[i], start[i + 1]):
            j = partner[e]
            both = w[i] + w[j]
            share[e] = w[i] / both
            step[e] = both / (bound[i] + bound[j]) if which[e] else 0.0
    return share, step


@kernel
def take(start, normal, share, v0, taken, v):
    """Velocities v of rows whose half-edges have taken so much from v0."""
    for i in range(len(start) - 1):
        for k in range(v.shape[1]):
            v[i, k] = v0[i, k]
        for e in range(start[i], start[i + 1]):
            given = share[e] * taken[e]
            for k in range(v.shape[1]):
                v[i, k] += given * normal[e, k]


@inner
def iterate(axes, first, last, problem, targets, state, v, after, beta, looks, sums):
    """An iteration of the rows first ... last - 1: `taken` and `ahead` of the `state` in place, velocities v to `after`.

    If it `looks`: returns the largest errors in v, in what is enough and in round-off. To sums[i] then the squares of the first,
    and the work of what changes against the momentum, which is positive past a minimum.
    """
    start, partner, normal, share, step = problem
    may_close, loose, tight = targets
    w, v0, taken, ahead = state
    one = np.uint64(1)
    rough, left = 0.0, 0.0
    for i in range(np.uint64(first), np.uint64(last)):  # unsigned: indices that may be negative take twice as long
        squares, work = 0.0, 0.0
        for k in range(len(axes)):
            after[i, np.uint64(k)] = v0[i, np.uint64(k)]
        for e in range(np.uint64(start[i]), np.uint64(start[i + one])):
            j, excess = np.uint64(partner[e]), may_close[e]
            for k in range(len(axes)):
                excess += (v[i, np.uint64(k)] - v[j, np.uint64(k)]) * normal[e, np.uint64(k)]
            new = ahead[e] - excess * step[e]
            new = new if new > 0.0 else 0.0
            change = new - taken[e]
            if looks and step[e] > 0.0:
                error = (ahead[e] - new) / step[e]
                part = abs(error) * loose[e]
                squares += part * part
                rough = part if part > rough else rough
                part = abs(error) * tight[e]
                left = part if part > left else left
                work += error * change * share[e]
            next_one = new + beta * change
            ahead[e], taken[e] = next_one, new
            given = share[e] * next_one
            for k in range(len(axes)):
                after[i, np.uint64(k)] += given * normal[e, np.uint64(k)]
        if looks:
            sums[i, np.uint64(0)], sums[i, np.uint64(1)] = squares, work / w[i] if w[i] > 0.0 else 0.0
    return rough, left


@inner
def momentum(theta):
    """(beta of this iteration, theta of the next one): Nesterov's sequence."""
    after = 0.5 * (sqrt(theta**4 + 4.0 * theta * theta) - theta * theta)
    return theta * (1.0 - theta) / (theta * theta + after), after


@kernel
def iterations(axes, count, problem, targets, state, v, other, theta, looks, sums):
    """So many iterations of all rows; v and `other` (size + 1, d) take turns. If it `looks`, one only.

    Returns theta of the next one, and of the last one the largest errors and the largest work of a row: see `iterate`.
    """
    rough, left, most = 0.0, 0.0, 0.0
    for _ in range(count):
        beta, theta = momentum(theta)
        rough, left = iterate(axes, 0, len(problem[0]) - 1, problem, targets, state, v, other, beta, looks, sums)
        v, other = other, v
    if looks:
        for i in range(len(sums)):
            most = max(most, abs(sums[i, 1]))
    return theta, rough, left, most


@kernel
def whole_numbers(sums, unit):
    """The columns of sums (n, 2) as sums of whole numbers, which any order and any number of ranks give alike."""
    squares, work = np.int64(0), np.int64(0)
    for i in range(len(sums)):
        squares += np.int64(min(sums[i, 0], LARGE) * FINE)
        work += np.int64(sums[i, 1] / unit * FINE)
    return squares, work


@kernel
def solve_each(axes, problem, w, targets, v, taken):
    """Velocities v (n, d) of rows that touch walls alone, in place, each by itself: a row's bits depend on no other."""
    start, _, normal, share, _ = problem
    n, d = len(start) - 1, v.shape[1]
    v0, other, ahead, sums = v.copy(), v.copy(), taken.copy(), np.empty((n, 2))
    state = w, v0, taken, ahead
    take(start, normal, share, v0, ahead, v)
    for i in range(n):
        theta, swapped = 1.0, False
        for _ in range(MOST):
            here, there = (other, v) if swapped else (v, other)
            beta, theta = momentum(theta)
            _, left = iterate(axes, i, i + 1, problem, targets, state, here, there, beta, True, sums)
            swapped = not swapped
            if left <= 1.0:
                break
            if sums[i, 1] > 0.0:
                theta = 1.0
                for k in range(d):
                    there[i, k] = v0[i, k]
                for e in range(start[i], start[i + 1]):
                    ahead[e] = taken[e]
                    for k in range(d):
                        there[i, k] += share[e] * taken[e] * normal[e, k]
    take(start, normal, share, v0, taken, v)


class Solver:
    """Solves for all ranks together, for velocities v (size + 1, d); `exchange(v)` refreshes those of ghosts.

    edges: of our rows; w (size + 1,): inverse masses. `iterations` counts those done.
    """

    def __init__(self, ranks: Communicator, dimension: int):
        self.ranks, self.axes = ranks, (0,) * dimension
        self.iterations = 0

    def solve(
        self, edges: Edges, w: Array, targets: Targets, v: Array, taken: Array, ids: Array, exchange: Callable[[Array], None],
        least: int,
    ) -> bool:  # fmt: skip
        """Velocities at which no contact closes faster than it may; v, and what each has `taken` (m,), in place.

        ids: of rows and ghosts. Ends when errors are allowed and `least` iterations are done, or nothing but round-off is left,
        or after MOST iterations; returns whether errors are allowed. Collective.
        """
        count, every = self.ranks.allreduce_sum(np.array([(edges.step > 0.0).sum(), len(taken)]))
        ranks, together = self.ranks, None
        if ranks.size > 1 and every <= FEW:
            together = Together(ranks, ids, edges, targets, w, v, taken)
            run, ranks = Run(self.axes, False, *together.all, unchanged), Communicator.alone()
        else:
            run = Run(self.axes, ranks.size > 1, tuple(edges), tuple(targets), w, v, taken, exchange)
        done = 1
        while True:
            worst = run.advance(1, looks=True)
            rough, left, most = ranks.allreduce_max(np.array(worst))
            squares, work = ranks.allreduce_sum(np.array(whole_numbers(run.sums, most if most > 0.0 else 1.0)))
            good = rough <= OUTLIER and squares <= max(count, 1) * FINE
            if left <= 1.0 or (good and done >= least) or done >= MOST:
                break
            if work > 0.0:
                run.restart()
            run.advance(CHECK - 1)
            done += CHECK
        run.finish()
        if together:
            together.give_back(v, taken)
        self.iterations += done + 1
        return bool(good or left <= 1.0)


class Run:
    """The iterations of one solution: see `Solver.solve`."""

    def __init__(
        self, axes: tuple[int, ...], parallel: bool, edges: tuple[Array, ...], targets: tuple[Array, ...], w: Array, v: Array,
        taken: Array, exchange: Callable[[Array], None],
    ):  # fmt: skip
        n = len(edges[0]) - 1
        self.axes, self.parallel, self.exchange = axes, parallel, exchange
        self.edges, self.targets, self.result = edges, targets, v
        self.v, self.other, self.sums = v.copy(), v.copy(), np.empty((n, 2))
        self.state = w, v[:n].copy(), taken, taken.copy()
        self.restart()

    def restart(self) -> None:
        """Begin with what is taken, without momentum."""
        start, _, normal, share, _ = self.edges
        _, v0, taken, ahead = self.state
        self.theta = 1.0
        ahead[:] = taken
        take(start, normal, share, v0, ahead, self.v)
        self.exchange(self.v)

    def advance(self, count: int, looks: bool = False) -> tuple[float, float, float]:
        """So many iterations, with an exchange of ghosts after each; what the last one saw, if it `looks`."""
        for part in [1] * count if self.parallel else [count]:
            self.theta, *seen = iterations(
                self.axes, part, self.edges, self.targets, self.state, self.v, self.other, self.theta, looks, self.sums
            )
            if part % 2:
                self.v, self.other = self.other, self.v
            self.exchange(self.v)
        return seen[0], seen[1], seen[2]

    def finish(self) -> None:
        """A last iteration without momentum; velocities are those that go with what is taken."""
        self.theta = 1.0
        self.advance(1)
        n = len(self.sums)
        self.result[:n] = self.v[:n]


class Together:
    """The contacts of all ranks on each of them, where they are so few that exchanges would take longer than the iterations.

    Each rank then computes the same bits for all rows that have some, in the order of ids; other rows keep their velocities and
    are not sent. `all`: what `Run` takes, but for the exchange.
    """

    def __init__(self, ranks: Communicator, ids: Array, edges: Edges, targets: Targets, w: Array, v: Array, taken: Array):
        n = len(edges.start) - 1
        names = np.append(ids, -1)  # of a wall
        columns = {"row": np.repeat(ids[:n], np.diff(edges.start)), "other": names[edges.partner], "taken": taken}
        columns |= {name: getattr(edges, name) for name in ("normal", "share", "step")} | targets._asdict()
        every = allgather_rows(ranks, columns)
        self.count = np.diff(edges.start)
        self.mine = np.flatnonzero(self.count)
        rows = allgather_rows(ranks, {"id": ids[self.mine], "v": v[self.mine], "w": w[self.mine]})
        order, by_row = np.argsort(rows["id"]), np.argsort(every["row"], kind="stable")
        known, every = rows["id"][order], rows_of(every, by_row)
        partner = np.searchsorted(known, every["other"])
        partner[every["other"] < 0] = len(known)
        start = np.searchsorted(every["row"], np.append(known, 2**62))
        both = Edges(start, partner.astype(np.int32), *(every[name] for name in Edges._fields[2:]))
        self.v = np.concatenate((rows["v"][order], np.zeros((1, v.shape[1]))))
        self.taken = every["taken"]
        wanted = tuple(every[name] for name in Targets._fields)
        self.all = tuple(both), wanted, np.append(rows["w"][order], 0.0), self.v, self.taken
        self.place = np.searchsorted(known, ids[self.mine])
        self.first = start[self.place]

    def give_back(self, v: Array, taken: Array) -> None:
        """The solution for our rows."""
        v[self.mine] = self.v[self.place]
        count = self.count[self.mine]
        within = np.arange(len(taken)) - np.repeat(np.cumsum(count) - count, count)
        taken[:] = self.taken[np.repeat(self.first, count) + within]


def unchanged(v: Array) -> None:
    """There are no ghosts."""
