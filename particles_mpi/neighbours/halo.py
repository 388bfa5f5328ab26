"""What ranks tell one another of the particles that others hold as ghosts: states, selected partners in a pass, new segments.

After a pass a message holds only the rows to which something happened, each with its place among those that the rank holds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from particles_mpi.kernels.markers import NOBODY
from particles_mpi.kernels.motion import Segments
from particles_mpi.parallel.exchange import Halo
from particles_mpi.particles import Array


class Active(NamedTuple):
    """The rows whose contacts must be sought in the next pass."""

    flag: Array  # (n,) bool
    rows: Array  # (n,) of which the first number[0] are these
    number: Array


def message_width(dimension: int) -> int:
    """Numbers in the longest row of a message: place, last partner, start, x, v of a segment; or x, v, acceleration."""
    return max(3 + 2 * dimension, 3 * dimension)


def refresh(halo: Halo, columns: Sequence[Array]) -> None:
    """Ghost rows of all columns (n, d) as their owners have them: a message has one after the other."""
    number, d = len(columns), columns[0].shape[1]

    def pack(rows: Array, buffer: Array) -> int:
        parts = buffer[: number * len(rows) * d].reshape(number, len(rows), d)
        for column, part in zip(columns, parts, strict=True):
            column.take(rows, axis=0, out=part, mode="clip")
        return parts.size

    for first, message in halo.exchange(pack):
        for column, part in zip(columns, message.reshape(number, -1, d), strict=True):
            column[first : first + len(part)] = part


def places(rows: Array, of: Array) -> tuple[Array, Array]:
    """(those rows `of` that are among `rows`, which ascend; their places there)."""
    place = np.searchsorted(rows, of)
    among = rows.take(place, mode="clip") == of
    return of[among], place[among]


def exchange_selections(halo: Halo, selected: Array, first_rows: Array, second_rows: Array) -> None:
    """The selected partners of owned rows with hits, to all who hold them as ghosts."""
    hit = np.unique(np.concatenate((first_rows, second_rows)))
    hit = hit[(hit >= 0) & (hit < halo.owned)]
    hit = hit[selected[hit] != NOBODY]

    def pack(rows: Array, buffer: Array) -> int:
        mine, place = places(rows, hit)
        words = buffer[: 2 * len(mine)].view(np.int64).reshape(-1, 2)
        words[:, 0], words[:, 1] = place, selected[mine]
        return words.size

    for first, message in halo.exchange(pack):
        words = message.view(np.int64).reshape(-1, 2)
        selected[first + words[:, 0]] = words[:, 1]


def exchange_segments(halo: Halo, active: Active, segments: Segments) -> None:
    """New segments of active owned rows to all who hold them as ghosts; they are active there too if the segment is new.

    Two who overlap may meet again in no time, after one of them met another: then only the velocity tells the segments apart.
    """
    x, v, start, last_partner = segments
    d, turned = x.shape[1], active.rows[: active.number[0]]  # at this moment
    width = 3 + 2 * d

    def pack(rows: Array, buffer: Array) -> int:
        mine, place = places(rows, turned)
        table = buffer[: width * len(mine)].reshape(-1, width)
        words = table.view(np.int64)
        words[:, 0], words[:, 1], table[:, 2] = place, last_partner[mine], start[mine]
        table[:, 3 : 3 + d], table[:, 3 + d :] = x[mine], v[mine]
        return table.size

    for first, message in halo.exchange(pack):
        table = message.reshape(-1, width)
        words = table.view(np.int64)
        rows = first + words[:, 0]
        is_new = (last_partner[rows] != words[:, 1]) | (start[rows] != table[:, 2]) | (v[rows] != table[:, 3 + d :]).any(axis=1)
        awakened = rows[is_new & ~active.flag[rows]]
        count = active.number[0]
        active.flag[awakened], active.rows[count : count + len(awakened)] = True, awakened
        active.number[0] += len(awakened)
        last_partner[rows], start[rows] = words[:, 1], table[:, 2]
        x[rows], v[rows] = table[:, 3 : 3 + d], table[:, 3 + d :]
