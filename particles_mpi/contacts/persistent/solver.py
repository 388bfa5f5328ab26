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
any number of ranks. For rough spheres, max(., 0) is followed by a cut of what is taken across the normal: `rough_iterations`.

Where masses are very different, iterations do not come to an end; few contacts are solved directly then (`direct`): rough ones
without friction, if iterations that begin there do not lead to a solution with it, for they must bear what lies on them. With
friction the problem is no minimum, and work past one says less: there, momentum is given up where errors grow, and in solutions
that end at round-off where errors do work, or are more than GROWN times the least so far. What does not get to errors that are
allowed is multiplied by the factor below, if that is less than 1: so it adds no energy.

Large piles are solved to a tolerance only. There p is multiplied by the factor that makes p A p/2 + p (N v + c) least, before the
iterations and after them: then errors do no work in sum over all contacts. Rough piles whose errors are far below that (CALM)
are not multiplied: the factor itself is rounded, and would be what moves them.
"""

from collections.abc import Callable

import numpy as np

from particles_mpi.contacts.persistent.direct import solve_directly
from particles_mpi.contacts.persistent.iterations import FINE, MOST, begin, iterations, solve_each, whole_numbers, works
from particles_mpi.contacts.persistent.problem import NORMAL, STEP, TAKEN, Problem
from particles_mpi.contacts.persistent.rough_iterations import SLID
from particles_mpi.contacts.persistent.together import FEW, Together
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Array

CHECK = 5  # iterations between two looks at what is left
FIRST_THETA = 0.25  # where the sequence of momenta begins: not at 1, for solutions begin near the last one
OUTLIER = 20.0  # times the root mean square that is allowed may the largest error be
NEAR = 0.2  # `balance` before the iterations is done only if its factor is within this of 1: else contacts have changed
QUIET = 1e-3  # of the allowed errors: a rough pile in which nothing is faster is asleep
CALM = 1e-3  # of the allowed errors, root mean square: below it at least MORE iterations are done
MORE = 150  # iterations in such a pile: fewer do not show what else has to fall
GROWN = 3.0  # mean square errors
EXACT = 100  # iterations: a solution that always gets so many ends at round-off
DIRECT = 1000  # half-edges: if so many of smooth spheres are not solved after TRIED iterations, they are solved directly
TRIED = 1000
DIFFERENT = 1e4  # times the least inverse mass of rough spheres: if the largest is more, friction is given up where need be
EFFORT = 200_000  # half-edges times iterations that are always spent, as long as it is no waste: small piles are exact


def taken_columns(d: int, rough: bool) -> list[int]:
    """The columns of a table that say what contacts have taken: along the normal, and, if rough, across it and as a couple."""
    first = NORMAL + d + SLID
    return [TAKEN, *(range(first, first + d)), *(range(first + 2 * d, first + 2 * d + d * (d - 1) // 2))] if rough else [TAKEN]


class Iteration:
    """The iterations of one solution for velocities v (size + 1, d), which stay as they are; `result` (n, d) has the last ones.

    w (size + 1,): inverse masses. Of rough spheres v has spins beside velocities, w the inverse moments of inertia, and the table
    of the problem more columns; see `rough_iterations`. `exchange` refreshes the velocities of ghosts, if there are any.
    """

    def __init__(self, axes: tuple[float, ...], problem: Problem, w: Array, v: Array, exchange: Callable[[Array], None] | None):
        self.axes, self.problem, self.exchange, self.w, self.v0 = axes, tuple(problem), exchange, w, v
        self.rough = w.ndim > 1
        self.taken = taken_columns(len(axes), self.rough)
        self.v, self.other, self.sums = v.copy(), v.copy(), np.empty((len(problem.start) - 1, 2))
        self.restart()

    @property
    def result(self) -> Array:
        """Velocities of the rows."""
        return self.v[: len(self.sums)]

    def restart(self) -> None:
        """Begin with what is taken, without momentum."""
        self.theta = FIRST_THETA
        begin(self.axes, 0, len(self.sums), self.problem, self.w, self.v0, self.v)
        if self.exchange:
            self.exchange(self.v)

    def advance(self, count: int, looks: bool = False) -> tuple[float, float, float]:
        """So many iterations, with an exchange of ghosts after each; what the last one saw, if it `looks`."""
        calls, count = (count, 1) if self.exchange else (1, count)
        for left in range(calls - 1, -1, -1):
            self.theta, *seen = iterations(
                self.axes, count, self.problem, self.w, self.v0, self.v, self.other, self.theta, looks and not left, self.sums
            )
            if count % 2:
                self.v, self.other = self.other, self.v
            if self.exchange:
                self.exchange(self.v)
        return seen[0], seen[1], seen[2]

    def factor(self, ranks: Communicator) -> float:
        """Times what p A p/2 + p (N v + c) is least: in sum over all contacts errors do no work then. Collective."""
        (largest,) = ranks.largest(works(self.axes, self.problem, self.w, self.v0, self.v, self.sums))
        if not largest > 0.0:
            return 1.0
        asked, did = ranks.total(*whole_numbers(self.sums, (largest, largest)))
        return -asked / did if did > 0 else 1.0

    def multiply(self, factor: float) -> None:
        """All that is taken."""
        self.problem[2][:, self.taken] *= factor
        self.restart()

    def balance(self, ranks: Communicator, least: float, most: float) -> None:
        """All that is taken times `factor`, if that is from `least` to `most`. Collective."""
        factor = self.factor(ranks)
        if least < factor < most:
            self.multiply(factor)

    def until_good(
        self, ranks: Communicator, count: int, least: int, asleep: Callable[[Array], bool] | None = None, limit: int = MOST
    ) -> tuple[bool, int]:  # fmt: skip
        """Iterate until errors are allowed and `least` iterations are done, or only round-off is left, or `limit` are done.

        `count`: half-edges of all ranks that may take something; `asleep`: if given, asked whether a pile moves at all that
        begins with errors that are allowed, or, of smooth spheres, with round-off; if not, it is left like that. Returns whether
        errors are allowed, and the iterations done, 0 for a pile that is asleep. Collective.
        """
        done, exact, before, best = 1, least >= EXACT, np.inf, np.inf
        if not exact and not self.rough:
            self.balance(ranks, 1.0 - NEAR, 1.0 + NEAR)
        errors = self.advance(1, looks=True)
        while True:
            worst, left, most = ranks.largest(*errors)
            squares, work = ranks.total(*whole_numbers(self.sums, (1.0, most if most > 0.0 else 1.0)))
            good, calm = worst <= OUTLIER and squares <= count * FINE, self.rough and squares <= count * FINE * CALM**2
            enough = done >= (max(MORE, least) if calm else least)
            looked = asleep is not None and done == 1 and (left <= 1.0 or (self.rough and good))
            if asleep and looked:
                self.restart()
                if asleep(self.result):
                    return True, 0
            if left <= 1.0 or (good and enough) or done >= limit:
                break
            if self.rough and done == 1 and not (exact or calm or looked):
                self.balance(ranks, 1.0 - NEAR, 1.0 + NEAR)
            elif not looked:
                grown = self.rough and squares > (GROWN * best if exact else before)
                if grown or (work > 0.0 and (exact or not self.rough)):
                    self.restart()
            before, best = squares, min(best, squares)
            errors = self.advance(CHECK, looks=True)
            done += CHECK
        self.restart()  # errors that were looked at are of what is taken: what is ahead may be far past it already
        good = good or left <= 1.0
        if self.rough and not good:
            self.multiply(min(max(self.factor(ranks), 0.0), 1.0))
        elif not exact and not calm:  # errors of one sign, however small, would lift a bed, or let it sink
            self.balance(ranks, 0.5, 1.0 if self.rough else 2.0)
        return bool(good), done

    def solve_directly(self) -> bool:
        """Impulses along the normals by `direct`, of smooth spheres, or of rough ones of very different masses, without friction.

        All rows are here, in the order of ids. Returns whether that was done.
        """
        w, table = (self.w[:, 0].copy(), self.problem[2]) if self.rough else (self.w, self.problem[2])
        movable = w[w > 0.0]
        if self.rough and not movable.max(initial=0.0) > DIFFERENT * movable.min(initial=np.inf):
            return False
        before = table[:, self.taken]
        table[:, self.taken] = 0.0
        if not solve_directly(self.axes, self.problem, w, self.v0[:, : len(self.axes)].copy()):
            table[:, self.taken] = before
            return False
        self.restart()
        return True

    def improve(self, count: int, least: int) -> bool:
        """Iterate from what is taken; if that leads to no errors that are allowed, go back. Returns whether it does."""
        before = self.problem[2][:, self.taken]
        good, _ = self.until_good(Communicator.alone(), count, least, limit=TRIED)
        if not good:
            self.problem[2][:, self.taken] = before
            self.restart()
        return good


class Solver:
    """Solves for all ranks together; `iterations` counts those done."""

    def __init__(self, ranks: Communicator, axes: tuple[float, ...]):
        self.ranks, self.axes = ranks, axes
        self.iterations = 0

    def solve(
        self, problem: Problem, w: Array, v: Array, ids: Array, exchange: Callable[[Array], None], least: int,
        pairs: bool = True, asleep: Callable[[Array], bool] | None = None,
    ) -> tuple[Array, bool, bool]:  # fmt: skip
        """Velocities (n, d) at which no contact closes faster than it may, whether errors are allowed, and whether all is asleep;
        to the table, what contacts have taken. Without `pairs` each row of rough spheres is solved for by itself.

        w (size + 1,): inverse masses; v (size + 1, d) and ids of rows and ghosts. For `least` and `asleep`, see
        `Iteration.until_good`.
        Collective.
        """
        ranks = self.ranks
        if not pairs:
            result = v.copy()
            solve_each(self.axes, tuple(problem), w, result)
            return result[: len(problem.start) - 1], True, False
        count, every = ranks.total(int((problem.table[:, STEP] > 0.0).sum()), len(problem.partner))
        if not count:
            return v[: len(problem.start) - 1], True, False
        few = count <= DIRECT and every <= FEW
        limit = TRIED if few and w.ndim == 1 else MOST
        if ranks.size > 1 and every <= FEW:
            together = Together(ranks, ids, problem, w, v)
            run = Iteration(self.axes, together.problem, together.w, together.v, None)

            def ours_asleep(result: Array) -> bool:
                return asleep is not None and asleep(together.ours(result, v, problem.table, run.taken))

            good, done = run.until_good(Communicator.alone(), count, least, asleep and ours_asleep, limit)
            result = together.ours(run.result, v, problem.table, run.taken)
        else:
            run = Iteration(self.axes, problem, w, v, exchange if ranks.size > 1 else None)
            good, done = run.until_good(ranks, count, least, asleep, limit)
            result = run.result
        if few and (not good or (w.ndim == 1 and done >= limit)):
            together = Together(ranks, ids, problem, w, v)  # of one rank alone, too: in the order of ids
            run = Iteration(self.axes, together.problem, together.w, together.v, None)
            if run.solve_directly():
                good = not run.rough or run.improve(count, least)
                result = together.ours(run.result, v, problem.table, run.taken)
            elif not run.rough:  # then it takes as many iterations as it takes
                good, _ = run.until_good(Communicator.alone(), count, least, limit=MOST)
                result = together.ours(run.result, v, problem.table, run.taken)
        self.iterations += done
        return result, good, done == 0
