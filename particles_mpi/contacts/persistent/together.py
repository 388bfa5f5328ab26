"""Few contacts are solved for by each rank: exchanges between ranks would take longer than the iterations."""

import numpy as np

from particles_mpi.contacts.persistent.problem import Problem
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import allgather_rows
from particles_mpi.particles import Array, rows_of

FEW_HALF_EDGES = 2_000  # half-edges of all ranks: so many are solved for by each


class Together:
    """The contacts of all ranks on each of them.

    Each rank then computes the same bits for all rows that have some, in the order of ids; other rows keep their velocities and
    are not sent. `problem`, `w`, `v`: what `descent.Iteration` takes.
    """

    def __init__(self, ranks: Communicator, ids: Array, problem: Problem, w: Array, v: Array):
        n = len(problem.start) - 1
        ids_of = np.append(ids, -1)  # of a wall
        self.count = np.diff(problem.start)
        columns = {"row": np.repeat(ids[:n], self.count), "other": ids_of[problem.partner]}
        columns |= {name: getattr(problem, name) for name in ("table", "per_allowed", "per_round_off")}
        every = allgather_rows(ranks, columns)
        self.mine = np.flatnonzero(self.count)
        rows = allgather_rows(ranks, {"id": ids[self.mine], "v": v[self.mine], "w": w[self.mine]})
        order = np.argsort(rows["id"])
        known, every = rows["id"][order], rows_of(every, np.argsort(every["row"], kind="stable"))
        partner = np.searchsorted(known, every["other"])
        partner[every["other"] < 0] = len(known)
        start = np.searchsorted(every["row"], np.append(known, 2**62))
        self.problem = Problem(start, partner.astype(np.int32), every["table"], every["per_allowed"], every["per_round_off"])
        self.v = np.concatenate((rows["v"][order], np.zeros((1, v.shape[1]))))
        self.w = np.concatenate((rows["w"][order], np.zeros((1, *w.shape[1:]))))
        self.place = np.searchsorted(known, ids[self.mine])
        self.first = start[self.place]

    def ours(self, result: Array, v: Array, table: Array, impulse_columns: list[int]) -> Array:
        """Of the velocities `result` of all rows those of ours, which were v; to our table the impulses, its
        columns `impulse_columns`."""
        count = self.count[self.mine]
        within = np.arange(len(table)) - np.repeat(np.cumsum(count) - count, count)
        theirs = np.repeat(self.first, count) + within
        for column in impulse_columns:
            table[:, column] = self.problem.table[theirs, column]
        ours = v[: len(self.count)].copy()
        ours[self.mine] = result[self.place]
        return ours
