"""The check, every few steps, that all particles are there, finite, and inside the walls and the box. It costs very little."""

from itertools import chain

import numpy as np

from particles_mpi.errors import MOST_NAMED, StateError
from particles_mpi.initial.faults import listed_ids
from particles_mpi.kernels.planes import Planes
from particles_mpi.kernels.validity import find_invalid, id_checksum
from particles_mpi.parallel.agreement import require_finite
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import IdRange, by_range, own_range, send_rows
from particles_mpi.particles import Array, Particles


class Watchdog:
    """Remembers which particles there are, and knows the walls and the periodic box. Both methods are collective."""

    def __init__(self, ranks: Communicator, ids: Array, span: IdRange, planes: Planes, lower: Array, length: Array):
        """`ids` (n,): of this rank's particles; `span`: range of all ids; `planes`: the walls."""
        self.ranks, self.span, self.planes = ranks, span, tuple(planes)
        self.lower, self.length = lower, length
        self.id_checksum = ranks.allreduce_sum(np.array(id_checksum(ids)))

    def check(self, p: Particles, step: int) -> None:
        """Raise a StateError on all ranks, which names ids, step and rank, if something is wrong."""
        axes = (0,) * p.dimension
        numbers, astray, wall = find_invalid(axes, p.position, p.velocity, p.fixed, self.planes, self.lower, self.length)
        sums = self.ranks.allreduce_sum(np.array([*id_checksum(p.id), numbers >= 0, astray >= 0]))
        checksum, (not_finite, outside) = sums[:3], sums[3:]
        if (checksum != self.id_checksum).any():
            raise StateError(f"step {step}: {self.describe_loss(p)}")
        if not_finite:
            require_finite(self.ranks, p, np.nan, f"step {step}")
        if outside:
            mine = None
            if astray >= 0:
                where = f"beyond wall {wall}" if wall >= 0 else "outside the periodic box"
                place = ", ".join(f"{x:.6g}" for x in p.position[astray])
                mine = f"step {step}: particle {p.id[astray]} on rank {self.ranks.rank} is {where}, at ({place})"
            raise StateError(next(text for text in self.ranks.allgather(mine) if text))

    def describe_loss(self, p: Particles) -> str:
        """Return a text: which ids are missing or repeated. Collective; each rank looks at its range of ids."""
        ranks, span = self.ranks, self.span
        expected = (p.id >= span.first) & (p.id < span.end)
        if odd := listed_ids(ranks, p.id[~expected]):
            return f"unknown: {odd}"
        arrived, arriving = send_rows(ranks, {"id": p.id}, *by_range(p.id, span, ranks.size, ranks.size))
        sender = np.repeat(np.arange(ranks.size), arriving)
        ids, times = np.unique(arrived["id"], return_counts=True)
        lost = np.setdiff1d(np.arange(*own_range(ranks.rank, span, ranks.size)), ids)
        holders = [(i, np.unique(sender[arrived["id"] == i])) for i in ids[times > 1][:MOST_NAMED]]
        texts = [f"{i} on ranks {', '.join(map(str, ranks_of))}" for i, ranks_of in holders]
        twice = list(chain.from_iterable(ranks.allgather(texts)))[:MOST_NAMED]
        faults = []
        if span.total < span.end - span.first:  # some were removed; their ids are not known
            missing = ranks.total(len(lost))[0] - (span.end - span.first - span.total)
            faults += [f"lost: {missing} particle{'s' if missing > 1 else ''}"] if missing > 0 else []
        elif named := listed_ids(ranks, lost):
            faults.append(f"lost: {named}")
        faults += [f"present more than once: {'; '.join(twice)}"] if twice else []
        return "; ".join(faults) or "the particles are not the same as before"
