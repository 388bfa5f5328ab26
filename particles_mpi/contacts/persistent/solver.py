"""Chooses how to solve for contacts: iterations on all ranks, iterations on each rank for all (`Together`), or `direct`.

Few contacts for which iterations do not end are solved directly: smooth ones, or rough ones without friction. If iterations with
friction that begin there find no solution, the one without friction stays: something must bear the load.
"""

from collections.abc import Callable

import numpy as np

from particles_mpi.contacts.persistent.descent import Iteration
from particles_mpi.contacts.persistent.direct import solve_directly
from particles_mpi.contacts.persistent.iterations import MOST_ITERATIONS, solve_each
from particles_mpi.contacts.persistent.problem import STEP, Problem
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import allgather_rows
from particles_mpi.particles import Array, rows_of

FEW_HALF_EDGES = 2_000  # half-edges of all ranks: so many are solved for by each
DIRECT = 2000  # half-edges: if so many of smooth spheres are not solved after TRIED iterations, they are solved directly
TRIED = 1000
DIFFERENT = 1e4  # times the least inverse mass of rough spheres: if the largest is more, friction is given up where need be
SOLUTION_EFFORT = 200_000  # half-edges times iterations that every solution gets: small piles are solved to round-off

Asleep = Callable[[Array], bool]  # are rows with these velocities, after the iterations, at rest?


class Solver:
    """Solves for all ranks together; `iterations` counts those done, without those after a direct solution."""

    def __init__(self, ranks: Communicator, axes: tuple[float, ...]):
        self.ranks, self.axes = ranks, axes
        self.iterations = 0

    def solve(
        self, problem: Problem, w: Array, v: Array, ids: Array, exchange: Callable[[Array], None], least: int,
        pairs: bool = True, asleep: Asleep | None = None,
    ) -> tuple[Array, bool, bool]:  # fmt: skip
        """Return velocities (n, d) at which no contact closes faster than it may, whether errors are allowed, and whether all is
        asleep. Writes the impulses of contacts to the table. Without `pairs` each row of rough spheres is solved by itself.

        w (size + 1,): inverse masses; v (size + 1, d) and ids of rows and ghosts. For `least` and `asleep`, see
        `Iteration.until_good`. Collective.
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
            together = Together(ranks, self.axes, problem, w, v, ids)
            look = asleep and (lambda _: asleep(together.ours()))
            good, done = together.run.until_good(count, least, look, limit)
            result = together.ours()
        else:
            run = Iteration(self.axes, problem, w, v, ranks, exchange if ranks.size > 1 else None)
            good, done = run.until_good(count, least, asleep, limit)
            result = run.result
        if few and (not good or (smooth and done >= limit)):
            together = Together(ranks, self.axes, problem, w, v, ids)
            solved = directly(together.run, count, least)
            if solved is not None:  # else what iterations came to is as good
                result, good = together.ours(), solved
        self.iterations += done
        return result, good, done == 0


class Together:
    """The contacts of all ranks, on each of them: for few, exchanges between ranks would take longer than the iterations.

    Each rank then computes the same bits for all rows that have contacts, in the order of ids; other rows keep their velocities
    and are not sent. `run`: the iterations of all rows. Collective.
    """

    def __init__(self, ranks: Communicator, axes: tuple[float, ...], problem: Problem, w: Array, v: Array, ids: Array):
        self.table, self.before = problem.table, v[: len(problem.start) - 1]
        self.count = np.diff(problem.start)
        ids_of = np.append(ids, -1)  # of a wall
        columns = {"row": np.repeat(ids[: len(self.count)], self.count), "other": ids_of[problem.partner]}
        columns |= {name: getattr(problem, name) for name in ("table", "per_allowed", "per_round_off")}
        every = allgather_rows(ranks, columns)
        self.mine = np.flatnonzero(self.count)
        rows = allgather_rows(ranks, {"id": ids[self.mine], "v": v[self.mine], "w": w[self.mine]})
        order = np.argsort(rows["id"])
        known, every = rows["id"][order], rows_of(every, np.argsort(every["row"], kind="stable"))
        partner = np.searchsorted(known, every["other"])
        partner[every["other"] < 0] = len(known)
        start = np.searchsorted(every["row"], np.append(known, 2**62))
        of_all = Problem(start, partner.astype(np.int32), every["table"], every["per_allowed"], every["per_round_off"])
        all_v = np.concatenate((rows["v"][order], np.zeros((1, v.shape[1]))))
        all_w = np.concatenate((rows["w"][order], np.zeros((1, *w.shape[1:]))))
        self.run = Iteration(axes, of_all, all_w, all_v)
        self.place = np.searchsorted(known, ids[self.mine])
        self.first = start[self.place]

    def ours(self) -> Array:
        """Return the present velocities of our rows, and write the impulses of their contacts to our table."""
        count = self.count[self.mine]
        within = np.arange(len(self.table)) - np.repeat(np.cumsum(count) - count, count)
        theirs = np.repeat(self.first, count) + within
        for column in self.run.impulse_columns:
            self.table[:, column] = self.run.table[theirs, column]
        ours = self.before.copy()
        ours[self.mine] = self.run.result[self.place]
        return ours


def directly(run: Iteration, count: int, least: int) -> bool | None:
    """Solve few contacts for which iterations do not end. Returns whether errors are allowed now; None if nothing can be done.

    All rows are here, in the order of ids. `count`, `least`: see `Iteration.until_good`.
    """
    if without_friction(run):
        return not run.rough or improve(run, count, least)
    if run.rough:
        return None
    good, _ = run.until_good(count, least)  # it takes as many iterations as it takes
    return good


def without_friction(run: Iteration) -> bool:
    """Find impulses along the normals by `direct`: for smooth spheres, or rough ones of very different masses.

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
    """Iterate from the impulses of the table, and go back to them if errors do not become allowed. Returns whether they do."""
    before = run.table[:, run.impulse_columns]
    good, _ = run.until_good(count, least, limit=TRIED)
    if not good:
        run.table[:, run.impulse_columns] = before
        run.restart()
    return good
