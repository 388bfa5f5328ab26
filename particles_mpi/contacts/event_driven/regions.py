"""The regions of space that ranks own in mode `event`: which ranks must know a row, and which ghosts can affect own rows."""

from math import floor
from typing import NamedTuple

import numpy as np

from particles_mpi.contacts.event_driven.rows import OWN, OWNERSHIP, Log, record_width, spin_width
from particles_mpi.kernels.geometry import some_nearest
from particles_mpi.kernels.jit import in_place, inner, kernel, lean_inner, prefetch
from particles_mpi.kernels.markers import RADIUS, START
from particles_mpi.neighbours.verlet_cells import MARGIN, NEXT_ROW, first_in_cells
from particles_mpi.neighbours.verlet_kernels import SIZE
from particles_mpi.parallel.decomposition import owners
from particles_mpi.particles import Array


class Regions(NamedTuple):
    """The regions of all ranks, as one rank needs them."""

    low: Array  # (ranks, d) corner of each region, within the box where that is periodic
    high: Array  # (ranks, d)
    box: tuple[Array, ...]  # a `Box`, as a plain tuple
    rank: int  # this one
    known: Array  # the ranks that may have to know rows of this one, and itself as the last: bit k of a mask is rank known[k]
    reach: float  # own rows touch, in a window, only ghosts whose surface is within this of the region
    bound: float  # how far a row gets in a window, at most
    depth: float  # a rank must know each row whose skin is within this of its region: `reach`, and some ghosts more


class Moves(NamedTuple):
    """What follows for the m own rows that got new reference positions, in the order of the log."""

    holders: Array  # (m, masks) the ranks that must hold it from now on
    owner: Array  # (m,) the rank that owns it from now on


def distances2(low: Array, high: Array, rank: int, length: Array) -> Array:
    """Squares of the distances (ranks,) from one rank's region to the nearest image of each; the same bits from both sides.

    If only one of two ranks took the other for a neighbour, it would wait for a message for ever.
    """
    apart = np.full(low.shape, np.inf)
    for shift in (0.0, length, -length):
        apart = np.minimum(apart, np.maximum(np.maximum(low[rank] - high + shift, low - high[rank] - shift), 0.0))
    return np.asarray((apart**2).sum(axis=1))


@inner
def in_box(y, length, lower):
    """The coordinate y, in the box if its axis is periodic (length > 0)."""
    return y - floor((y - lower) / length) * length if length > 0.0 else y


@lean_inner
def distance2(regions, rank, x, i):
    """Square of the distance of position x[i] from a rank's region, or from its nearest periodic image."""
    low, high = regions.low, regions.high
    lower, _, length = regions.box
    total = 0.0
    for k in range(len(length)):
        y = in_box(x[i, k], length[k], lower[k])
        gap = max(low[rank, k] - y, y - high[rank, k], 0.0)
        if length[k] > 0.0:
            gap = min(gap, max(low[rank, k] - y - length[k], 0.0, y + length[k] - high[rank, k]))
            gap = min(gap, max(low[rank, k] - y + length[k], 0.0, y - length[k] - high[rank, k]))
        total += gap * gap
    return total


@kernel
def mark_holders(reference, rows, regions, masks):
    """masks[p] (p, masks): which of the known ranks must know row rows[p]: those whose region is within `depth` of its skin."""
    regions = Regions(*regions)
    d = regions.low.shape[1]
    for p in range(len(rows)):
        i = np.int64(rows[p])
        within = regions.depth + reference[i, d + SIZE]
        for b in range(masks.shape[1]):
            masks[p, b] = 0
        for k in range(len(regions.known)):
            if distance2(regions, regions.known[k], reference, i) <= within * within:
                masks[p, k >> 6] |= np.int64(1) << (k & 63)


@kernel
def plan_moves(reference, log, regions, tree, moves):
    """Fill in `moves` for the own rows that got new reference positions; `tree`: arguments of `owners`, which cut space."""
    plain_regions = regions
    log, regions, moves = Log(*log), Regions(*regions), Moves(*moves)
    low, high, me = regions.low, regions.high, regions.rank
    lower, _, length = regions.box
    d, here = len(length), len(regions.known) - 1
    place = np.empty((1, d))
    for m in range(log.moved_count[0]):
        prefetch(reference, log.moved[m])
    for m in range(log.moved_count[0]):
        i = np.int64(log.moved[m])
        moves.owner[m] = me
        within = regions.depth + reference[i, d + SIZE]
        deep = True
        for k in range(d):
            deep &= low[me, k] + within < reference[i, k] < high[me, k] - within
        if not deep:
            mark_holders(reference, log.moved[m : m + 1], plain_regions, moves.holders[m : m + 1])
            for k in range(d):
                place[0, k] = in_box(reference[i, k], length[k], lower[k])
            moves.owner[m] = owners(place, *tree)[0]
        moves.holders[m, here >> 6] |= np.int64(1) << (here & 63)  # it stays here for now, as a ghost if not as an own row


@in_place
def place_at_begin(rows, log, i, begin, place, p):
    """place[p] (d,): where row i was when the window began."""
    segment, saved = rows.segment, log.saved
    d = place.shape[1]
    changed = log.mark[i] >= log.stamp[0]
    at = (log.mark[i] - log.stamp[0]) * record_width(d, spin_width(rows))
    for k in range(d):
        if changed:
            place[p, k] = saved[at + k] + saved[at + d + k] * (begin - saved[at + 2 * d + START])
        else:
            place[p, k] = segment[i, k] + segment[i, d + k] * (begin - segment[i, 2 * d + START])


@in_place
def can_affect_owned(rows, lists, log, regions, i, begin, place):
    """May row i, wherever it went in the window that began at `begin`, have touched an own row? `place` (2, d) is scratch.

    It may if an own row was so near to it at that time that the two can have met. Most rows are too far from the region for that.
    """
    segment, links, nearby = rows.segment, lists.links, lists.nearby
    _, _, length = lists.box
    d = regions.low.shape[1]
    radius = segment[i, 2 * d + RADIUS]
    place_at_begin(rows, log, i, begin, place, 0)
    within = regions.reach + radius
    if distance2(regions, regions.rank, place, np.int64(0)) > within * within:
        return False
    # An own row was within its skin of its reference position, or has got a new one within its skin of where it came to.
    waiting = first_in_cells(length, lists, place, np.int64(0), radius + 3.0 * regions.bound)
    p = 0
    while p < waiting:
        j = np.int64(nearby[p])
        p += 1
        if links[j, 2 * d + NEXT_ROW] >= 0:
            nearby[waiting] = links[j, 2 * d + NEXT_ROW]
            waiting += 1
        if rows.state[j, OWNERSHIP] < OWN:
            continue
        place_at_begin(rows, log, j, begin, place, 1)
        r2 = 0.0
        for k in range(d):
            r = some_nearest(place[0, k] - place[1, k], length[k], lists.boxes_per_length[k])
            r2 += r * r
        within = (radius + segment[j, 2 * d + RADIUS] + 2.0 * regions.bound) * MARGIN
        if r2 <= within * within:
            return True
    return False
