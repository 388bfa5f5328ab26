"""The next event of a row: its first contact with a row in its list or with a wall, or the time at which its list expires.

It also prefetches memory: most of the time of an event is spent waiting for rows that are not in the cache.
"""

from math import sqrt

import numpy as np

from particles_mpi.contacts.event_driven.calendar_queue import LIST_EXPIRY, NEXT, NO_EVENT, PARTNER, comes_before, repetitions
from particles_mpi.contacts.event_driven.jams import passes_by
from particles_mpi.contacts.event_driven.rows import ID, JAMMED, LAST_PARTNER, RAPID_EVENTS, SQUEEZED
from particles_mpi.contacts.event_driven.segments import columns_of_segments, is_nearest_image, may_touch, touch_time
from particles_mpi.contacts.walls import may_hit, wall_contact
from particles_mpi.kernels.jit import in_place, inner, lean_inner, prefetch, screening, trailing_zeros
from particles_mpi.kernels.lanes import LANE_COUNT
from particles_mpi.kernels.markers import NEVER, RADIUS, START
from particles_mpi.neighbours.verlet_kernels import BEGIN, COUNT, SKIN

MASK_BITS = 64  # of a mask
USED_SKIN = 1.0 - 1.0 / 512.0  # of a skin: two points that just are in no list of one another meet when all of it is used up
EARLY, SOON, NEXT_ONES = 6, 4, 2  # buckets ahead of the present one, for which memory is prefetched


@screening
def likely_partners(axes, segment, lists, i, first, count, place, now, until):
    """Which of the `count` <= MASK_BITS rows in the pool from place `first` on `may_touch` row i: bit p for place first + p."""
    _, _, length = lists.box
    likely, last = np.int64(0), first + count - 1
    for p in range(0, count, LANE_COUNT):
        others = columns_of_segments(axes, segment, lists.pool, first + p, last)
        likely |= may_touch(axes, segment, i, others, place, now, until, length, lists.boxes_per_length) << p
    return likely & ((np.int64(1) << count) - 1) if count < MASK_BITS else likely


@in_place
def have_just_met(d, segment, state, i, j):
    """Did rows i and j begin their segments at a contact with one another? False for jammed rows."""
    together = segment[i, 2 * d + START] == segment[j, 2 * d + START]
    with_each_other = state[i, LAST_PARTNER] == state[j, ID] and state[j, LAST_PARTNER] == state[i, ID]
    return together and with_each_other and max(state[i, RAPID_EVENTS], state[j, RAPID_EVENTS]) < JAMMED


@lean_inner
def is_first(i, j, k, state):
    """Does row i meet row j before row k, if it meets both at the same time?"""
    return comes_before(i, j, repetitions(i, j, state), i, k, repetitions(i, k, state), state)


@inner(inline="always")
def first_partner(axes, rows, lists, work, i, now, h):
    """(time, row) of the first contact of row i, up to h, with a row in its list; NO_EVENT if there is none.

    Of contacts at the same time that of the partner which `comes_before` the others.
    """
    segment, state, spans, pool, r = rows.segment, rows.state, lists.spans, lists.pool, work.r
    _, _, length = lists.box
    d = len(axes)
    first_time, partner = h, np.int64(NO_EVENT)
    jammed = state[i, RAPID_EVENTS] >= JAMMED
    for k in range(d):
        work.place[k] = segment[i, k] + segment[i, d + k] * (now - segment[i, 2 * d + START])
    end = np.int64(spans[i, BEGIN] + spans[i, COUNT])
    for first in range(np.int64(spans[i, BEGIN]), end, MASK_BITS):
        likely = likely_partners(axes, segment, lists, i, first, min(end - first, MASK_BITS), work.place, now, h)
        while likely != 0:
            j = np.int64(pool[first + trailing_zeros(likely)])
            likely &= likely - 1
            prefetch(state, j)
            t = touch_time(axes, segment, np.uint64(i), np.uint64(j), now, first_time, h, length, r, work.u)
            if (
                t != NEVER
                and (t < first_time or partner == NO_EVENT or is_first(i, j, partner, state))
                and not (work.any_squeezed[0] and passes_by(jammed, state[j, RAPID_EVENTS]))
                and not (have_just_met(d, segment, state, i, j) and is_nearest_image(d, r, length))
            ):
                first_time, partner = t, j
    return first_time, partner


@in_place
def list_expires(axes, segment, reference, i, now, until):
    """The time at which row i is nearly a skin away from its reference position, if that is before `until`, or else NEVER."""
    d = len(axes)
    a = 0.0
    b = 0.0
    skin = USED_SKIN * reference[i, d + SKIN]
    c = -skin * skin
    for k in range(d):
        away = segment[i, k] + segment[i, d + k] * (now - segment[i, 2 * d + START]) - reference[i, k]
        a += segment[i, d + k] * segment[i, d + k]
        b += away * segment[i, d + k]
        c += away * away
    ahead = until - now
    if not (c + ahead * (2.0 * b + a * ahead) > 0.0 and (a > 0.0 or c > 0.0)):  # most need no root
        return NEVER
    if c >= 0.0:
        return now
    root = sqrt(max(b * b - a * c, 0.0))
    return now + (-c / (b + root) if b > 0.0 else (root - b) / a)


@inner(inline="always")
def next_event(axes, rows, lists, planes, work, i, now, h):
    """(time, partner) of the next event of row i on the present segments: its first contact, or LIST_EXPIRY.

    (h, NO_EVENT) if none comes before h.
    """
    segment, state, d = rows.segment, rows.state, len(axes)
    time, partner = h, np.int64(NO_EVENT)
    jammed = state[i, RAPID_EVENTS] >= JAMMED
    if state[i, RAPID_EVENTS] < SQUEEZED or jammed:
        time, partner = first_partner(axes, rows, lists, work, i, now, h)
        start, radius = segment[i, 2 * d + START], segment[i, 2 * d + RADIUS]
        if not jammed and len(planes.point) and may_hit(axes, segment, segment, np.int64(d), start, i, radius, h, planes):
            t, wall = wall_contact(axes, segment, segment, np.int64(d), start, i, radius, state[i, LAST_PARTNER], h, planes)
            if wall >= 0 and (t < time or partner == NO_EVENT):
                time, partner = t, np.int64(-1 - wall)
    expiry = list_expires(axes, segment, lists.reference, i, now, time)
    if expiry != NEVER:
        time, partner = expiry, np.int64(LIST_EXPIRY)
    return time, partner


@in_place
def prefetch_row(rows, lists, queue, i):
    """Prefetch what an event of row i needs of it, if i is a row."""
    if i >= 0:
        prefetch(queue.node, i)
        prefetch(lists.spans, i)
        prefetch(rows.segment, i)
        prefetch(rows.state, i)
        prefetch(lists.reference, i)


@in_place
def prefetch_neighbours(rows, lists, i):
    """Prefetch the segments of the rows in the list of row i, if i is a row."""
    if i >= 0:
        for p in range(np.uint64(lists.spans[i, BEGIN]), np.uint64(lists.spans[i, BEGIN] + lists.spans[i, COUNT])):
            prefetch(rows.segment, lists.pool[p])


@lean_inner
def prefetch_next(rows, lists, queue):
    """Prefetch for later events, when a bucket is over: first their rows, then the lists of these, then their neighbours."""
    node, first, present = queue.node, queue.first, queue.present
    last = len(first) - 1
    prefetch_row(rows, lists, queue, np.int64(first[min(present[0] + EARLY, last)]))
    i = np.int64(first[min(present[0] + SOON, last)])
    if i >= 0:
        prefetch(node, node[i, NEXT])
        prefetch_row(rows, lists, queue, np.int64(node[i, PARTNER]))
    i = np.int64(first[min(present[0] + NEXT_ONES, last)])
    if i >= 0:
        prefetch_neighbours(rows, lists, i)
        prefetch_neighbours(rows, lists, np.int64(node[i, PARTNER]))
