"""How far ranks must look into one another's space, and where their particles may go until the next search.

Each rank has a box around the tubes of its own rows. It gets as ghosts all rows whose tubes come within 2 `slack` of that
box. Until the horizon its rows stay within `slack` of it, whatever turns them, and rows that it does not hold stay out of
there: so no row can meet one that its rank does not know. A row that would get over this fence brings the horizon nearer.
The boxes are those of straight paths, which only rows near the border stretch; the slack is for those that are turned there.
"""

from __future__ import annotations

import numpy as np

from particles_mpi.neighbours.trajectories import tubes_box, tubes_near
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import send_rows, starts
from particles_mpi.particles import Array

# own box with its slack (2, d); those of other ranks that it overlaps (m, 2, d); the rows that they hold as ghosts
# of ours, rows[sent[p] : sent[p + 1]] ascending for the p-th of them.
Fence = tuple[Array, Array, Array, Array]


def nowhere(dimension: int) -> Fence:
    """The fence of a single rank: none."""
    own = np.array([[-np.inf] * dimension, [np.inf] * dimension])
    return own, np.empty((0, 2, dimension)), np.zeros(1, np.int32), np.empty(0, np.int32)


def overlap(one: Array, boxes: Array, length: Array) -> Array:
    """Which of the boxes (m, 2, d) overlap the box `one` (2, d), or an image of it; (m,)."""
    meet = np.zeros(boxes.shape[::2], bool)
    for shift in (0.0, length, -length):
        meet |= (one[0] + shift <= boxes[:, 1]) & (one[1] + shift >= boxes[:, 0])
    return np.asarray(meet.all(axis=1))


def share(
    ranks: Communicator,
    arrays: dict[str, Array],
    state: tuple[Array, Array, Array],
    slack: float,
    end: float,
    half: float,
    length: Array,
) -> tuple[Fence, Array, Array, dict[str, Array], Array]:
    """(fence, our rows that others need, how many each, theirs that we need, how many of each rank). Collective.

    `arrays`: what is sent of a row; `state` = (x, v, radius) of the owned rows, tubes as in `trajectories`.
    """
    boxes = ranks.allgather_array(tubes_box(*state, end, half))
    fence, rows, counts = build(boxes, ranks.rank, slack, state, end, half, length)
    return fence, rows, counts, *send_rows(ranks, arrays, rows, counts)


def build(
    boxes: Array, rank: int, slack: float, state: tuple[Array, Array, Array], end: float, half: float, length: Array
) -> tuple[Fence, Array, Array]:
    """(fence, rows to send sorted by rank, how many to each rank) from the boxes (ranks, 2, d) of all ranks' tubes.

    `state` = (x, v, radius) of the owned rows; boxes of ranks without rows are (inf, -inf), and overlap nothing.
    """
    d = boxes.shape[2]
    wide = boxes + slack * np.array([[-1.0] * d, [1.0] * d])
    others = overlap(wide[rank], wide, length)
    others[rank] = False
    places = np.flatnonzero(others)
    outer = wide + slack * np.array([[-1.0] * d, [1.0] * d])
    sent = [tubes_near(*state, end, half, outer[p, 0], outer[p, 1], length) for p in places]
    rows = np.concatenate([*sent, np.empty(0, np.int32)])
    counts = np.zeros(len(boxes), np.int32)
    counts[places] = [len(s) for s in sent]
    return (wide[rank], wide[others], starts(np.array([*map(len, sent), 0], np.int32)), rows), rows, counts
