"""How far ranks must look into one another's space, and where their particles may go until the next search.

Each rank has a box around everything that the straight paths of its rows may cover. Until the horizon its rows stay within
`slack` of this box, whatever turns them, and rows that it does not hold stay outside: so no row can meet one that its rank does
not know. A rank gets as ghosts all rows whose paths come within `clearance` of this space; rows further away would have to be
turned to get there. A row that would break this rule brings the horizon nearer (`trajectories.renew_paths`). The fastest row near
a border stretches the box, so a row that was turned rarely leaves it, and the slack can be smaller than the clearance.
"""

from typing import NamedTuple

import numpy as np

from particles_mpi.neighbours.rank_boxes import rows_near_box, swept_box
from particles_mpi.neighbours.trajectories import Horizon
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import send_rows, starts
from particles_mpi.particles import Array


class Margins(NamedTuple):
    """Margins around the boxes of ranks, until the horizon.

    slack: how far rows may get out of their rank's box; clearance: how near to that space rows come which the rank does not hold.
    """

    slack: float
    clearance: float


AT_THE_BORDER = Margins(0.0, 0.0)


class HaloRegion(NamedTuple):
    """Where rows may go without meeting one that their rank does not know.

    own (2, d): the rank's box with its slack, in which owned rows stay. others (m, 2, d): those of the ranks that are within the
    clearance; rank p of them holds our rows known[sent[p] : sent[p + 1]], ascending, as ghosts, and no other one enters there.
    """

    own: Array
    others: Array
    sent: Array
    known: Array


def everywhere(dimension: int) -> HaloRegion:
    """The region of a single rank."""
    own = np.array([[-np.inf] * dimension, [np.inf] * dimension])
    return HaloRegion(own, np.empty((0, 2, dimension)), np.zeros(1, np.int32), np.empty(0, np.int32))


def fetch_near_rows(
    ranks: Communicator,
    arrays: dict[str, Array],
    state: tuple[Array, Array, Array],
    horizon: Horizon,
    length: Array,
    margins: Margins = AT_THE_BORDER,
) -> tuple[HaloRegion, Array, Array, dict[str, Array], Array]:
    """(region, our rows that others need, how many each, theirs that we need, how many of each rank). Collective.

    `arrays`: what is sent of a row; `state` = (x, v, radius) of the owned rows, which start now.
    """
    boxes = ranks.allgather_array(swept_box(*state, horizon))
    region, rows, counts = build(boxes, ranks.rank, state, horizon, length, margins)
    return region, rows, counts, *send_rows(ranks, arrays, rows, counts)


def build(
    boxes: Array, rank: int, state: tuple[Array, Array, Array], horizon: Horizon, length: Array, margins: Margins = AT_THE_BORDER
) -> tuple[HaloRegion, Array, Array]:
    """(region, rows to send sorted by rank, how many to each rank) from the boxes (ranks, 2, d) that all ranks' rows may cover.

    `state` = (x, v, radius) of the owned rows; boxes of ranks without rows are (inf, -inf), and overlap nothing.
    """
    d = boxes.shape[2]
    outwards = np.array([[-1.0] * d, [1.0] * d])
    wide = boxes + margins.slack * outwards
    outer = wide + margins.clearance * outwards
    overlap = np.zeros((len(boxes), d), bool)  # with this rank's, or an image of it, axis by axis
    for shift in (0.0, length, -length):
        overlap |= (wide[rank, 0] + shift <= outer[:, 1]) & (wide[rank, 1] + shift >= outer[:, 0])
    others = np.asarray(overlap.all(axis=1))
    others[rank] = False
    places = np.flatnonzero(others)
    sent = [rows_near_box(*state, horizon, outer[p, 0], outer[p, 1], length) for p in places]
    rows = np.concatenate([*sent, np.empty(0, np.int32)])
    counts = np.zeros(len(boxes), np.int32)
    counts[places] = [len(s) for s in sent]
    return HaloRegion(wide[rank], wide[others], starts(np.array([*map(len, sent), 0], np.int32)), rows), rows, counts
