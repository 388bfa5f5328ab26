"""Messages about the particles that other ranks hold as ghosts: selected partners in a pass, and new segments.

After a pass a message holds only the rows to which something happened. `Halo.exchange` sends what `pack_...` wrote into a buffer
of numbers, and `unpack_...` reads it; `words` is such a buffer seen as int64.
"""

from typing import NamedTuple

import numpy as np

from particles_mpi.kernels.jit import kernel
from particles_mpi.kernels.markers import NO_PARTNER
from particles_mpi.kernels.motion import Segments
from particles_mpi.neighbours.rank_boxes import index_of
from particles_mpi.parallel.halo import Halo
from particles_mpi.particles import Array, spin_components

# What hits are about: own rows that no other rank holds; own rows that others hold as ghosts; an own row and a ghost. Which
# partners were selected must be sent for the last only, new segments for the last two.
OWN_ONLY, SHARED_ROWS, ACROSS = 0, 1, 2


class Active(NamedTuple):
    """The rows whose contacts must be sought in the next pass."""

    flag: Array  # (n,) bool
    rows: Array  # (n,) of which the first number[0] are these
    number: Array


def message_width(dimension: int) -> int:
    """Numbers in the longest row of a message: place, last partner, start, x, v of a segment, and a spin."""
    return 3 + 2 * dimension + spin_components(dimension)


def exchange_selections(halo: Halo, selected: Array, first_rows: Array, second_rows: Array, marked: Array) -> None:
    """Send the selected partners of owned rows with hits to all ranks that hold these rows as ghosts.

    `marked` (n,) bool: scratch, False before and afterwards.
    """

    def pack(rows: Array, buffer: Array) -> int:
        return int(pack_selections(rows, selected, first_rows, second_rows, halo.owned, marked, buffer.view(np.int64)))

    for first, message in halo.exchange(pack):
        unpack_selections(first, message.view(np.int64), selected)


def exchange_segments(halo: Halo, active: Active, segments: Segments, spin: Array) -> None:
    """Send new segments of active owned rows, and spins (n, width) if there are any, to all ranks that hold them as ghosts.

    A ghost becomes active if its segment is new.
    """
    own = active.rows[: active.number[0]]  # at this moment
    all_ = tuple(segments)

    def pack(rows: Array, buffer: Array) -> int:
        return int(pack_segments(rows, own, all_, spin, buffer, buffer.view(np.int64)))

    for first, message in halo.exchange(pack):
        unpack_segments(first, message, message.view(np.int64), tuple(active), all_, spin)


@kernel
def rows_concerned(shared, owned, first, second):
    """Return ACROSS if one of the hits of rows (first, second) is with a ghost, SHARED_ROWS if `shared` marks a row, else
    OWN_ONLY.
    """
    concerned = OWN_ONLY
    for p in range(len(first)):
        i = first[p]
        j = second[p] if second[p] >= 0 else i  # below 0 it is a wall
        if i >= owned or j >= owned:
            return ACROSS
        if shared[i] or shared[j]:
            concerned = SHARED_ROWS
    return concerned


@kernel
def pack_selections(rows, selected, first_rows, second_rows, owned, marked, words):
    """Write to `words`, for each owned row of the hits that is among `rows` and selected a partner, its place there and the
    partner.

    rows: those that the receiver holds, ascending. Returns how many words there are.
    """
    size = 0
    for packing in (True, False):  # each row once, and all unmarked again
        for p in range(len(first_rows)):
            for i in (first_rows[p], second_rows[p]):
                if 0 <= i < owned and marked[i] != packing:
                    marked[i] = packing
                    place = index_of(i, rows) if packing and selected[i] != NO_PARTNER else -1
                    if place >= 0:
                        words[size] = place
                        words[size + 1] = selected[i]
                        size += 2
    return size


@kernel
def unpack_selections(first, words, selected):
    """Read what pack_selections wrote."""
    for m in range(0, len(words), 2):
        selected[first + words[m]] = words[m + 1]


@kernel
def pack_segments(rows, active_rows, segments, spin, out, words):
    """(place among rows, last partner, start, x, v, spin if there is one) of the active rows that are among them."""
    x, v, start, last_partner = segments
    d, s = x.shape[1], spin.shape[1] * (len(spin) > 0)
    size = 0
    for i in active_rows:
        place = index_of(i, rows)
        if place >= 0:
            words[size] = place
            words[size + 1] = last_partner[i]
            out[size + 2] = start[i]
            for k in range(d):
                out[size + 3 + k] = x[i, k]
                out[size + 3 + d + k] = v[i, k]
            for c in range(s):
                out[size + 3 + 2 * d + c] = spin[i, c]
            size += 3 + 2 * d + s
    return size


@kernel
def unpack_segments(first, message, words, active, segments, spin):
    """Read what pack_segments wrote; rows whose segment is new become active.

    Two spheres that overlap may meet again in no time, after one of them met another: then only the velocity shows a new segment.
    """
    x, v, start, last_partner = segments
    flag, active_rows, number = active
    d, s = x.shape[1], spin.shape[1] * (len(spin) > 0)
    count = number[0]
    for m in range(0, len(message), 3 + 2 * d + s):
        i = first + words[m]
        is_new = last_partner[i] != words[m + 1] or start[i] != message[m + 2]
        for k in range(d):
            is_new |= v[i, k] != message[m + 3 + d + k]
        if is_new and not flag[i]:
            flag[i] = True
            active_rows[count] = i
            count += 1
        last_partner[i] = words[m + 1]
        start[i] = message[m + 2]
        for k in range(d):
            x[i, k] = message[m + 3 + k]
            v[i, k] = message[m + 3 + d + k]
        for c in range(s):
            spin[i, c] = message[m + 3 + 2 * d + c]
    number[0] = count
