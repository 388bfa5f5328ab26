"""Which way contacts are solved: by iterations, of all ranks or of each for all (`together`), or directly (`direct`).

Where iterations do not come to an end, few contacts are solved directly (`direct`): rough ones without friction, if iterations
that begin there do not lead to a solution with it, for they must bear what lies on them.
"""

from collections.abc import Callable

import numpy as np

from particles_mpi.contacts.persistent.descent import Iteration
from particles_mpi.contacts.persistent.direct import solve_directly
from particles_mpi.contacts.persistent.iterations import MOST_ITERATIONS, solve_each
from particles_mpi.contacts.persistent.problem import STEP, Problem
from particles_mpi.contacts.persistent.together import FEW_HALF_EDGES, Together
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Array

DIRECT = 2000  # half-edges: if so many of smooth spheres are not solved after TRIED iterations, they are solved directly
TRIED = 1000
DIFFERENT = 1e4  # times the least inverse mass of rough spheres: if the largest is more, friction is given up where need be
SOLUTION_EFFORT = 200_000  # half-edges times iterations that every solution gets: small piles are solved to round-off

Asleep = Callable[[Array], bool]  # are rows with these velocities, after the iterations, at rest?


class Solver:
    """Solves for all ranks together; `iterations` counts those done, but for those after a direct solution."""

    def __init__(self, ranks: Communicator, axes: tuple[float, ...]):
        self.ranks, self.axes = ranks, axes
        self.iterations = 0

    def solve(
        self, problem: Problem, w: Array, v: Array, ids: Array, exchange: Callable[[Array], None], least: int,
        pairs: bool = True, asleep: Asleep | None = None,
    ) -> tuple[Array, bool, bool]:  # fmt: skip
        """Velocities (n, d) at which no contact closes faster than it may, whether errors are allowed, and whether all is asleep;
        to the table, the impulses of contacts. Without `pairs` each row of rough spheres is solved for by itself.

        w (size + 1,): inverse masses; v (size + 1, d) and ids of rows and ghosts. For `least` and `asleep`, see
        `Iteration.until_good`.
        Collective.
        """
        if not pairs:
            result = v.copy()
            solve_each(self.axes, tuple(problem), w, result)
            return result[: len(problem.start) - 1], True, False
        ranks, smooth = self.ranks, w.ndim == 1
        count, every = ranks.total(int((problem.table[:, STEP] > 0.0).sum()), len(problem.partner))
        if not count:
            return v[: len(problem.start) - 1], True, False
        few = count <= DIRECT and every <= FEW_HALF_EDGES
        limit = MOST_ITERATIONS if not few else TRIED if smooth else 2 * MOST_ITERATIONS
        if ranks.size > 1 and every <= FEW_HALF_EDGES:
            result, good, done = self.by_each_rank(problem, w, v, ids, count, least, limit, asleep)
        else:
            run = Iteration(self.axes, problem, w, v, exchange if ranks.size > 1 else None)
            good, done = run.until_good(ranks, count, least, asleep, limit)
            result = run.result
        if few and (not good or (smooth and done >= limit)):
            result, good = self.directly(problem, w, v, ids, count, least, (result, good))
        self.iterations += done
        return result, good, done == 0

    def by_each_rank(
        self, problem: Problem, w: Array, v: Array, ids: Array, count: int, least: int, limit: int, asleep: Asleep | None
    ) -> tuple[Array, bool, int]:
        """Few contacts, by iterations of each rank for all; `count`, `least`, `limit`: see `Iteration.until_good`."""
        together = Together(self.ranks, ids, problem, w, v)
        run = Iteration(self.axes, together.problem, together.w, together.v, None)

        def ours(result: Array) -> Array:
            return together.ours(result, v, problem.table, run.impulse_columns)

        look = asleep and (lambda result: asleep(ours(result)))
        good, done = run.until_good(Communicator.alone(), count, least, look, limit)
        return ours(run.result), good, done

    def directly(
        self, problem: Problem, w: Array, v: Array, ids: Array, count: int, least: int, so_far: tuple[Array, bool]
    ) -> tuple[Array, bool]:
        """Few contacts that iterations do not solve, by each rank for all, in the order of ids: (velocities, is it a solution?).

        `count`, `least`: see `Iteration.until_good`; `so_far`: what is returned where nothing better is found.
        """
        together, (result, good) = Together(self.ranks, ids, problem, w, v), so_far
        run = Iteration(self.axes, together.problem, together.w, together.v, None)
        if without_friction(run):
            good = not run.rough or improve(run, count, least)
        elif not run.rough:  # then it takes as many iterations as it takes
            good, _ = run.until_good(Communicator.alone(), count, least, limit=MOST_ITERATIONS)
        else:
            return result, good
        return together.ours(run.result, v, problem.table, run.impulse_columns), good


def without_friction(run: Iteration) -> bool:
    """Impulses along the normals by `direct`, of smooth spheres, or of rough ones of very different masses, without friction.

    All rows are here, in the order of ids. Returns whether that was done.
    """
    w, table = (run.w[:, 0].copy(), run.table) if run.rough else (run.w, run.table)
    movable = w[w > 0.0]
    if run.rough and not movable.max(initial=0.0) > DIFFERENT * movable.min(initial=np.inf):
        return False
    before = table[:, run.impulse_columns]
    table[:, run.impulse_columns[1:]] = 0.0
    if not solve_directly(run.axes, run.problem, w, run.v0[:, : len(run.axes)].copy()):
        table[:, run.impulse_columns] = before
        return False
    run.restart()
    return True


def improve(run: Iteration, count: int, least: int) -> bool:
    """Iterate from the impulses of the table; if that leads to no errors that are allowed, go back. Returns whether it does."""
    before = run.table[:, run.impulse_columns]
    good, _ = run.until_good(Communicator.alone(), count, least, limit=TRIED)
    if not good:
        run.table[:, run.impulse_columns] = before
        run.restart()
    return good
