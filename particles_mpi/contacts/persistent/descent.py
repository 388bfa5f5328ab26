"""Velocities at which no contact closes: the inelastic law of J. J. Moreau (Comput. Methods Appl. Mech. Eng. 177, 329 (1999)).

Of all velocities at which no contact closes faster than it may, those are sought that are nearest to the present ones in kinetic
energy. With the impulses p >= 0 of the contacts, their normals N, W = 1/m and the speeds c at which they may close, p is the
minimum of p A p/2 + p (N v + c) with A = N^T W N. It is found by accelerated projected gradients with restarts (Y. Nesterov; B.
O'Donoghue and E. Candes, Found. Comput. Math. 15, 715 (2015); for contacts H. Mazhar et al., ACM Trans. Graph. 34, 32 (2015)):

    p' = max(y - (N u + c)/D, 0),   u = v + W N y,   y' = p' + beta (p' - p).

D is diagonal. For each row i, b_i is a bound of the largest eigenvalue of the sum of n n^T over its contacts.
D = w_i b_i + w_j b_j makes D - A positive, so no step is too long. The impulse p of a contact is kept as a speed, p (w_i + w_j),
by which it changes the approach of its partners. A half-edge is computed by the owner of its row, from velocities that ranks
exchange in each iteration; all sums are in the order of half-edges (`graph`). So the bits are the same on any number of ranks.
For rough spheres, max(., 0) is followed by a cut of the tangential impulses: `rough_iterations`.

Large piles are solved only to a tolerance. Before and after the iterations p is multiplied by the factor at which
p A p/2 + p (N v + c) is least: errors then do no work in sum over all contacts. Rough piles whose errors are far below the
tolerance (CALM) are not multiplied, because the rounding of the factor itself would move them.

With friction the problem is not to find a minimum, and the work of errors means less. Momentum is given up where errors do work,
and, in the first half of the iterations, where they are more than GROWN times the least so far. If the errors do not become
small enough, impulses are multiplied by the factor above, if it is less than 1: so no energy is added.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from particles_mpi.contacts.persistent.iterations import (
    CHECK,
    FIRST_THETA,
    MOST_ITERATIONS,
    Rules,
    begin,
    iterate_to_end,
    iterations,
    unit_of_squares,
    verdict,
    whole_numbers,
    works,
)
from particles_mpi.contacts.persistent.problem import MAY_CLOSE, Problem
from particles_mpi.contacts.persistent.rough_table import impulse_columns
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Array

LITTLE_CHANGE = 0.2  # `balance` before the iterations is done only if its factor is within this of 1: else contacts have changed
# Where at least so many iterations are to be done, errors are reduced to round-off, not to a tolerance: of rough spheres
# more, for what fewer leave of errors is hit after hit where contacts keep no gap.
EXACT, ROUGH_EXACT = 100, 400
# Iterations, after which contacts need no longer go back to the gap that they keep: it seems that there is no room, as
# in a box that is full from side to side; and those that are done then, for contacts without a gap.
CLOSING, WITHOUT_GAP = 500, 1500


class Seen(NamedTuple):
    """What an iteration that looks sees on all ranks; errors are divided by those allowed. See `verdict`.

    worst: the largest error; over_round_off: the largest one, divided by round-off instead; squares: the sum of the squares of
    errors, times SUM_UNITS; work: of the last change against the momentum, of which only the sign counts.
    """

    worst: float
    over_round_off: float
    squares: float
    work: float

    @property
    def round_off(self) -> bool:
        """Is nothing else left?"""
        return self.over_round_off <= 1.0


def exact_from(rough: bool) -> int:
    """How many iterations a pile must be given at least (`until_good`) to be solved to round-off, and not to a tolerance."""
    return ROUGH_EXACT if rough else EXACT


class Iteration:
    """The iterations of one solution for velocities v (size + 1, d), which stay as they are; `result` (n, d) has the last ones.

    w (size + 1,): inverse masses. Of rough spheres v has spins beside velocities, w the inverse moments of inertia, and the table
    of the problem more columns; see `rough_table`. `ranks`: those that compute it together, which is collective; without any this
    one has all rows. `exchange` refreshes the velocities of ghosts, if there are any.
    """

    def __init__(
        self, axes: tuple[float, ...], problem: Problem, w: Array, v: Array,
        ranks: Communicator | None = None, exchange: Callable[[Array], None] | None = None,
    ):  # fmt: skip
        self.axes, self.problem, self.table, self.w, self.v0 = axes, tuple(problem), problem.table, w, v
        self.ranks, self.exchange = ranks or Communicator.alone(), exchange
        self.rough = w.ndim > 1
        self.impulse_columns = impulse_columns(len(axes), self.rough)
        self.v, self.other, self.sums = v.copy(), v.copy(), np.empty((len(problem.start) - 1, 2))
        self.restart()

    @property
    def result(self) -> Array:
        """The velocities of the rows after the last iteration."""
        return self.v[: len(self.sums)]

    def restart(self) -> None:
        """Begin with the impulses of the table, and without momentum."""
        self.theta = FIRST_THETA
        begin(self.axes, 0, len(self.sums), self.problem, self.w, self.v0, self.v)
        if self.exchange:
            self.exchange(self.v)

    def advance(self, count: int, looks: bool = False) -> tuple[float, float, float]:
        """Do so many iterations, with an exchange of ghosts after each. Returns the errors of the last one, if it `looks`."""
        for to_go in range(count - 1, -1, -1):
            self.theta, *seen = iterations(
                self.axes, 1, self.problem, self.w, self.v0, self.v, self.other, self.theta, looks and not to_go, self.sums
            )
            self.v, self.other = self.other, self.v
            if self.exchange:
                self.exchange(self.v)
        return seen[0], seen[1], seen[2]

    def seen(self, errors: tuple[float, float, float]) -> Seen:
        """Return what the last iteration, with these `errors` on this rank, saw on all ranks."""
        worst, over_round_off, most = self.ranks.largest(*errors)
        unit = unit_of_squares(worst)
        squares, work = self.ranks.total(*whole_numbers(self.sums, (unit, most if most > 0.0 else 1.0)))
        return Seen(worst, over_round_off, squares * unit, float(work))

    def until(self, rules: Rules, done: int, best: float) -> tuple[Seen, int, bool, bool]:
        """Iterate until the `verdict` allows an end. Returns what was seen last, the iterations done, good, calm.

        `done` and `best`: iterations, and the least sum of squares of errors, so far. Where no ghosts are exchanged, one kernel
        does all: for a small pile, the calls would take longer than the iterations.
        """
        while True:
            if self.exchange:
                errors, done = self.advance(CHECK, looks=True), done + CHECK
            else:
                before = done
                self.theta, done, best, *errors = iterate_to_end(
                    self.axes, self.problem, self.w, self.v0, self.v, self.other, self.theta, tuple(rules), done, best, self.sums
                )
                if (done - before) % 2:
                    self.v, self.other = self.other, self.v
            seen = self.seen((errors[0], errors[1], errors[2]))
            good, calm, ends, anew = verdict(seen, rules, done, best)
            if ends:
                return seen, done, good, calm
            if anew:
                self.restart()
            best = min(best, seen.squares)

    def factor(self) -> float:
        """Return the factor of all impulses at which p A p/2 + p (N v + c) is least: errors then do no work in sum."""
        (largest,) = self.ranks.largest(works(self.axes, self.problem, self.w, self.v0, self.v, self.sums))
        if not largest > 0.0:
            return 1.0
        linear, quadratic = self.ranks.total(*whole_numbers(self.sums, (largest, largest)))
        return -linear / quadratic if quadratic > 0 else 1.0

    def multiply(self, factor: float) -> None:
        """Multiply all impulses by a factor."""
        self.table[:, self.impulse_columns] *= factor
        self.restart()

    def balance(self, least: float, most: float) -> None:
        """Multiply all impulses by `factor`, if it lies between `least` and `most`."""
        factor = self.factor()
        if least < factor < most:
            self.multiply(factor)

    def until_good(
        self, count: int, least: int, asleep: Callable[[Array], bool] | None = None, limit: int = MOST_ITERATIONS
    ) -> tuple[bool, int]:
        """Iterate until errors are allowed and `least` iterations are done, or only round-off is left, or `limit` are done.

        `count`: half-edges of all ranks that may have an impulse. `asleep`: if given, it is called when a pile begins with errors
        that are allowed, or, of smooth spheres, with round-off, and says whether the pile is at rest; if it is, nothing is
        changed. Returns whether errors are allowed, and the iterations done, 0 for a pile that is asleep.
        """
        exact, near_one = least >= exact_from(self.rough), (1.0 - LITTLE_CHANGE, 1.0 + LITTLE_CHANGE)
        rules = Rules(count, least, limit if exact else min(limit, CLOSING), limit, self.rough)
        if not exact and not self.rough:
            self.balance(*near_one)
        seen, done = self.seen(self.advance(1, looks=True)), 1
        good, calm, ends, anew = verdict(seen, rules, done, np.inf)
        if asleep and (seen.round_off or (self.rough and good)):
            self.restart()
            if asleep(self.result):
                return True, 0
        elif self.rough and not (exact or calm or ends):
            self.balance(*near_one)
        elif anew and not ends:
            self.restart()
        if not ends:
            seen, done, good, calm = self.until(rules, done, seen.squares)
        if not (good or seen.round_off) and done < limit:
            may_close = self.table[:, MAY_CLOSE]
            np.maximum(may_close, 0.0, out=may_close)
            self.restart()
            rules = Rules(count, WITHOUT_GAP, limit, limit, self.rough)
            seen, done, good, calm = self.until(rules, done, seen.squares)
        self.restart()  # errors that were looked at are of the impulses: extrapolated ones may be far past them already
        good = good or seen.round_off
        if self.rough and not good:
            self.multiply(min(max(self.factor(), 0.0), 1.0))
        elif not exact and not calm:  # errors of one sign, however small, would lift a bed, or let it sink
            self.balance(0.5, 1.0 if self.rough else 2.0)
        return bool(good), done
