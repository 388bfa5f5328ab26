"""Is every particle still there, a number, and where it may be? Asked every few steps: it costs next to nothing."""

from __future__ import annotations

import numpy as np

from particles_mpi.errors import StateError
from particles_mpi.kernels.jit import kernel
from particles_mpi.parallel.agreement import require_finite
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import IdRange
from particles_mpi.particles import Array, Particles

NAMED = 10  # ids in a message
ROUND_OFF = 1e-9


class Watchdog:
    """Knows which particles there are, the walls that hold them, and the periodic box. Made, and asked, on all ranks."""

    def __init__(self, ranks: Communicator, ids: Array, span: IdRange, planes: tuple[Array, Array], lower: Array, length: Array):
        """`ids` (n,): those of this rank's particles, all of which are there; `span`: where those of all ranks lie."""
        self.ranks, self.span, self.planes = ranks, span, planes
        self.lower, self.length = lower, length
        self.id_checksum = ranks.allreduce_sum(id_checksum(ids))

    def look(self, p: Particles, step: int) -> None:
        """Raises StateError on all ranks, with ids, step and rank, if something is wrong. Collective."""
        numbers, astray, wall = find_invalid(p.position, p.velocity, p.fixed, *self.planes, self.lower, self.length)
        sums = self.ranks.allreduce_sum(np.array([*id_checksum(p.id), numbers >= 0, astray >= 0]))
        if (sums[:3] != self.id_checksum).any():
            raise StateError(f"step {step}: {self.who_is_lost(p)}")
        if sums[3]:
            raise StateError(require_finite(self.ranks, p, f"step {step}"))
        if sums[4]:
            mine = None
            if astray >= 0:
                where = f"beyond wall {wall}" if wall >= 0 else "outside the periodic box"
                place = ", ".join(f"{x:.6g}" for x in p.position[astray])
                mine = f"step {step}: particle {p.id[astray]} on rank {self.ranks.rank} is {where}, at ({place})"
            raise StateError(next(text for text in self.ranks.allgather(mine) if text))

    def who_is_lost(self, p: Particles) -> str:
        """Which ids are missing, and which are there twice. Collective."""
        everyone = self.ranks.allgather(p.id.copy())
        ids, span = np.concatenate(everyone), self.span
        odd = ids[(ids < span.first) | (ids >= span.end)]
        if len(odd):
            return f"unknown ids {first_ids(odd)}"
        times = np.bincount(ids - span.first, minlength=span.end - span.first)
        twice = span.first + np.flatnonzero(times > 1)
        held = [f"{i} on ranks {', '.join(str(r) for r, of in enumerate(everyone) if i in of)}" for i in twice[:NAMED]]
        missing = span.total - len(np.unique(ids))
        told = []
        if missing > 0 and span.total == span.end - span.first:
            told.append(f"particles {first_ids(span.first + np.flatnonzero(times == 0))} are lost")
        elif missing > 0:  # some were removed, and nobody has kept which
            told.append(f"{missing} particles are lost")
        told += [f"there more than once: {'; '.join(held)}"] if len(twice) else []
        return "; ".join(told) or "other particles are there than before"


def first_ids(ids: Array) -> str:
    """The first ids as a text."""
    return ", ".join(map(str, ids[:NAMED])) + (f" and {len(ids) - NAMED} more" if len(ids) > NAMED else "")


def id_checksum(ids: Array) -> Array:
    """(3,) sums that tell a permutation of the ids from anything that happens by mistake; they may wrap around."""
    with np.errstate(over="ignore"):
        return np.array([len(ids), ids.sum(dtype=np.int64), (ids * ids).sum(dtype=np.int64)])


@kernel
def find_invalid(x, v, fixed, point, normal, lower, length):
    """(first row that is not finite, first row beyond a wall or a periodic face, which wall); -1 for none."""
    numbers, astray, at = -1, -1, -1
    for i in range(len(x)):
        sums, size = 0.0, 0.0
        for k in range(x.shape[1]):
            sums += x[i, k] * 0.0 + v[i, k] * 0.0
            size += abs(x[i, k])
            beyond = x[i, k] < lower[k] or x[i, k] > lower[k] + length[k]
            if length[k] > 0.0 and beyond and astray < 0:
                astray = i
        if sums != 0.0 and numbers < 0:
            numbers = i
        if fixed[i] or astray >= 0:
            continue
        for w in range(len(point)):
            distance, scale = 0.0, size
            for k in range(x.shape[1]):
                distance += (x[i, k] - point[w, k]) * normal[w, k]
                scale += abs(point[w, k])
            if distance < -ROUND_OFF * scale and astray < 0:
                astray, at = i, w
    return numbers, astray, at


WATCH_EVERY = 10  # steps
