"""The compiled loop of mode `event`: all contacts of a rank's rows, one after the other in exact order of time."""

from math import sqrt
from typing import NamedTuple

import numpy as np

from particles_mpi.contacts.event_driven.calendar_queue import (
    EMPTY,
    LIST_EXPIRY,
    NEXT,
    NO_EVENT,
    PARTNER,
    PARTNER_COUNT,
    TIME,
    UNSORTED,
    Queue,
    advance,
    cancel,
    comes_before,
    find_first,
    push,
)
from particles_mpi.contacts.event_driven.jams import (
    STANDING,
    Collapse,
    note_contact,
    passes_by,
    stop_at_jam,
    stop_squeezed,
    takes_nothing,
)
from particles_mpi.contacts.event_driven.rows import (
    EVENT_COUNT,
    ID,
    JAMMED,
    LAST_PARTNER,
    NOT_HERE,
    OWN,
    OWNERSHIP,
    RAPID_EVENTS,
    SQUEEZED,
    VIRIAL,
    ZERO_TIME_EVENT,
    Log,
    Rows,
    note_move,
    note_segment,
    save_once,
)
from particles_mpi.contacts.event_driven.segments import (
    collide,
    columns_of_segments,
    is_nearest_image,
    may_touch,
    move_to,
    touch_time,
)
from particles_mpi.contacts.rough import Rough
from particles_mpi.contacts.walls import bounce, may_hit, meet_wall, wall_contact
from particles_mpi.kernels.jit import in_place, inner, lean, lean_inner, prefetch, screening, trailing_zeros
from particles_mpi.kernels.lanes import LANE_COUNT
from particles_mpi.kernels.markers import NEVER, RADIUS, START
from particles_mpi.kernels.planes import Planes
from particles_mpi.neighbours.verlet_kernels import (
    BEGIN,
    COUNT,
    INVERSE_MASS,
    SKIN,
    Lists,
    compare,
    find_nearby,
    relist,
    shortage,
)
from particles_mpi.particles import Array

COLLISIONS, WALL_HITS, TC_ELASTIC, EXPIRIES = range(4)  # what `counts` counts
ASKED, LOWER, HIGHER = range(3)  # columns of `stop`
LAST_PROGRESS, EVENTS_SINCE = range(2)  # columns of `progress`
INTERRUPTED, STANDSTILL, FULL_BUCKET = -1, -2, -3  # what `run` returns
BITS = 64  # of a mask
PIECE = 100_000  # events, about a tenth of a second
MOST_STANDING, FEW = 2.0 * SQUEEZED / ZERO_TIME_EVENT, 100  # events a row while no time passes: more than SQUEEZED ever allows
EARLY, SOON, NEXT_ONES = 6, 4, 2  # buckets ahead of the present one, for which memory is prefetched


class Work(NamedTuple):
    """What `run` writes besides rows, lists, queue and log. Counted is what own rows did, a pair by the row with the lower id."""

    stale: Array  # (2 n + 2,) int32: rows whose next event is not known; at a standstill, a row and its partner
    counts: Array  # (4,) COLLISIONS, WALL_HITS, those of them that were TC_ELASTIC, and list EXPIRIES of all rows
    tc_elastic: Array  # (m, 3) the first contacts that took no energy: time, id, id or -1 - wall
    stop: Array  # (3,) int64: is it ASKED to end after the first collision, then its LOWER and HIGHER id
    stopped: Array  # (1,) time of that collision
    progress: Array  # (2,) LAST_PROGRESS: a time later than that before by more than STANDING; EVENTS_SINCE then
    any_squeezed: Array  # (1,) bool: is any row squeezed?
    place: Array  # (d,) scratch
    r: Array  # (d,) scratch
    u: Array  # (d,) scratch
    normal: Array  # (d,) scratch
    impulse: Array  # (d,) scratch


@screening
def likely_partners(axes, segment, lists, i, first, count, place, now, until):
    """Which of the `count` <= BITS rows in the pool from place `first` on `may_touch` row i: bit p for place first + p."""
    _, _, length = lists.box
    likely, last = np.int64(0), first + count - 1
    for p in range(0, count, LANE_COUNT):
        others = columns_of_segments(axes, segment, lists.pool, first + p, last)
        likely |= may_touch(axes, segment, i, others, place, now, until, length, lists.boxes_per_length) << p
    return likely & ((np.int64(1) << count) - 1) if count < BITS else likely


@inner(inline="always")
def next_event(axes, rows, lists, planes, work, i, now, h):
    """(time, partner) of the next event of row i on the present segments: its first contact, or LIST_EXPIRY."""
    segment, state, reference, spans, pool = rows.segment, rows.state, lists.reference, lists.spans, lists.pool
    r = work.r
    _, _, length = lists.box
    d = len(axes)
    best = h
    partner = np.int64(NO_EVENT)
    jammed = state[i, RAPID_EVENTS] >= JAMMED
    if state[i, RAPID_EVENTS] < SQUEEZED or jammed:
        for k in range(d):
            work.place[k] = segment[i, k] + segment[i, d + k] * (now - segment[i, 2 * d + START])
        end = np.int64(spans[i, BEGIN] + spans[i, COUNT])
        for first in range(np.int64(spans[i, BEGIN]), end, BITS):
            likely = likely_partners(axes, segment, lists, i, first, min(end - first, BITS), work.place, now, h)
            while likely != 0:
                j = np.int64(pool[first + trailing_zeros(likely)])
                likely &= likely - 1
                prefetch(state, j)
                t = touch_time(axes, segment, np.uint64(i), np.uint64(j), now, best, length, r, work.u)
                if (
                    t != NEVER
                    and (t < best or partner == NO_EVENT or comes_before(i, j, i, partner, state))
                    and not (work.any_squeezed[0] and passes_by(jammed, state[j, RAPID_EVENTS]))
                    and not (
                        segment[i, 2 * d + START] == segment[j, 2 * d + START]
                        and state[i, LAST_PARTNER] == state[j, ID]
                        and state[j, LAST_PARTNER] == state[i, ID]
                        and not jammed
                        and state[j, RAPID_EVENTS] < JAMMED
                        and is_nearest_image(d, r, length)
                    )
                ):
                    best = t
                    partner = j
        start, radius = segment[i, 2 * d + START], segment[i, 2 * d + RADIUS]
        if not jammed and len(planes.point) and may_hit(axes, segment, segment, np.int64(d), start, i, radius, h, planes):
            t, wall = wall_contact(axes, segment, segment, np.int64(d), start, i, radius, state[i, LAST_PARTNER], h, planes)
            if wall >= 0 and (t < best or partner == NO_EVENT):
                best = t
                partner = np.int64(-1 - wall)
    a = 0.0
    b = 0.0
    c = -reference[i, d + SKIN] * reference[i, d + SKIN]
    for k in range(d):
        away = segment[i, k] + segment[i, d + k] * (now - segment[i, 2 * d + START]) - reference[i, k]
        a += segment[i, d + k] * segment[i, d + k]
        b += away * segment[i, d + k]
        c += away * away
    # Its list expires before `best` if it is further than its skin from its reference position then. Most need no root.
    until = best - now
    if c + until * (2.0 * b + a * until) > 0.0 and (a > 0.0 or c > 0.0):
        best = now
        if c < 0.0:
            root = sqrt(max(b * b - a * c, 0.0))
            best += -c / (b + root) if b > 0.0 else (root - b) / a
        partner = np.int64(LIST_EXPIRY)
    return best, partner


@lean_inner
def note_tc_elastic(work, t, one, other):
    """One more contact that took no energy; the first ones by name."""
    counts, named = work.counts, work.tc_elastic
    if counts[TC_ELASTIC] < len(named):
        named[counts[TC_ELASTIC], 0], named[counts[TC_ELASTIC], 1], named[counts[TC_ELASTIC], 2] = t, one, other
    counts[TC_ELASTIC] += 1


@in_place
def prefetch_row(rows, lists, queue, i):
    """What an event of row i needs of it comes to the cache, if i is a row."""
    if i >= 0:
        prefetch(queue.node, i)
        prefetch(lists.spans, i)
        prefetch(rows.segment, i)
        prefetch(rows.state, i)
        prefetch(lists.reference, i)


@in_place
def prefetch_neighbours(rows, lists, i):
    """The segments of the rows in the list of row i come to the cache, if i is a row."""
    if i >= 0:
        for p in range(np.uint64(lists.spans[i, BEGIN]), np.uint64(lists.spans[i, BEGIN] + lists.spans[i, COUNT])):
            prefetch(rows.segment, lists.pool[p])


@lean_inner
def prefetch_next(rows, lists, queue):
    """A bucket is over: what the next events need comes to the cache while others are worked on; rows, lists, then neighbours."""
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


@lean
def run(axes, rows, lists, queue, rules, interval, work, log, pending):
    """All events of an interval, in order. work.stale[:pending] are rows whose next event is not known.

    rules: loss of a pair, the law of rough spheres (see `Rough`), `Collapse`, how many quick contacts make a crowd,
    `Planes`, `Rates`. interval: length of the drift and when it began, from when until when in it, and how many skins before a
    particle its new reference position lies.
    Returns 0; or how many places the pool of the lists is short of: then call again with a larger one; or INTERRUPTED after so
    many events that a user may have pressed Ctrl-C: then call again; or FULL_BUCKET: sort it, and call again; or STANDSTILL,
    where events follow one another for ever but time does not pass. With stop[ASKED] the loop ends after the first collision.

    One kernel with everything in it: a call with so many arrays costs as much as the look it would be for. The bundles come as
    plain tuples, as in all kernels of this folder that Python calls: see `jit.plain`.
    """
    rows, lists, queue, work, log = Rows(*rows), Lists(*lists), Queue(*queue), Work(*work), Log(*log)
    segment, state, reals, reference = rows.segment, rows.state, rows.reals, lists.reference
    _, _, length = lists.box
    (restitution, velocity_factor), law, collapse, crowded, planes, rates = rules
    planes, collapse = Planes(*planes), Collapse(*collapse)
    rough = Rough(rows.spin, rows.inverse_inertia, law, work.normal, work.impulse)
    h, moment, now, until, ahead = interval
    stale, counts, progress, node, times = work.stale, work.counts, work.progress, queue.node, queue.times
    d = len(axes)
    logging = log.window[0] > 0
    events = 0
    while True:
        if pending > 0:
            pending -= 1
            i = np.int64(stale[pending])
            if state[i, OWNERSHIP] == NOT_HERE:
                continue
            cancel(queue, i)
            t, partner = next_event(axes, rows, lists, planes, work, i, now, h)
            if partner != NO_EVENT:
                push(queue, state, i, t, partner, state[partner, EVENT_COUNT] if partner >= 0 else 0)
            continue
        i = find_first(queue, state)
        if i == EMPTY and advance(queue):
            prefetch_next(rows, lists, queue)
            continue
        if i == UNSORTED:
            return FULL_BUCKET
        if i == EMPTY or times[i, TIME] >= until:
            return 0
        t = times[i, TIME]
        j = np.int64(node[i, PARTNER])
        progress[EVENTS_SINCE] += 1.0
        if t > progress[LAST_PROGRESS] + STANDING * h:
            progress[LAST_PROGRESS], progress[EVENTS_SINCE] = t, 0.0
        elif progress[EVENTS_SINCE] > MOST_STANDING * (len(segment) + FEW):
            stale[0], stale[1] = i, j
            return STANDSTILL
        events += 1
        if events > PIECE:
            return INTERRUPTED
        now = max(now, t)
        if logging:
            save_once(axes, rows, i, log)
        stale[0] = i
        pending = 1
        if j == LIST_EXPIRY:
            speed2 = 0.0
            for k in range(d):
                speed2 += segment[i, d + k] * segment[i, d + k]
            lead = ahead * reference[i, d + SKIN] / sqrt(speed2) if speed2 > 0.0 else 0.0
            for k in range(d):
                reference[i, k] = segment[i, k] + segment[i, d + k] * (now - segment[i, 2 * d + START] + lead)
            found = find_nearby(axes, lists, i)
            kept, new = compare(lists, i, found)
            short = shortage(lists, i, kept, new)
            if short > 0:
                return short
            relist(axes, lists, i, kept, new)
            counts[EXPIRIES] += 1
            if logging and state[i, OWNERSHIP] >= OWN:
                note_move(i, log)
        elif j < 0:
            wall = -1 - j
            lossy = planes.restitution[wall] * planes.velocity_factor[wall] < 1.0
            elastic = lossy and takes_nothing(d, rows, i, t, moment, h, collapse)
            note_contact(axes, rows, i, t, j, moment, h, elastic, collapse, crowded, work.any_squeezed)
            move_to(axes, segment, i, t)
            own = state[i, OWNERSHIP] >= OWN
            e, factor = (1.0, 1.0) if elastic else (planes.restitution[wall], planes.velocity_factor[wall])
            radius, w, taken = segment[i, 2 * d + RADIUS], reference[i, d + INVERSE_MASS], (e, factor)
            if elastic:
                bounce(axes, segment, np.int64(d), i, wall, planes.normal, e, factor, w, t, rates)
            else:
                meet_wall(axes, segment, np.int64(d), i, wall, radius, w, t, taken, planes.normal, rates, rough)
            stop_squeezed(axes, rows, i, crowded)
            if elastic and own:
                note_tc_elastic(work, moment + t, state[i, ID], j)
            counts[WALL_HITS] += own
            if logging:
                note_segment(axes, rows, i, log)
        elif node[i, PARTNER_COUNT] == state[j, EVENT_COUNT]:
            if logging:
                save_once(axes, rows, j, log)
            stale[1] = j
            pending = 2
            if state[j, ID] < state[i, ID]:
                i, j = j, i
            if max(state[i, RAPID_EVENTS], state[j, RAPID_EVENTS]) >= JAMMED:
                stop_at_jam(axes, rows, i, t)
                stop_at_jam(axes, rows, j, t)
                if logging:
                    note_segment(axes, rows, i, log)
                    note_segment(axes, rows, j, log)
                continue
            elastic = restitution * velocity_factor < 1.0 and (
                takes_nothing(d, rows, i, t, moment, h, collapse) or takes_nothing(d, rows, j, t, moment, h, collapse)
            )
            note_contact(axes, rows, i, t, state[j, ID], moment, h, elastic, collapse, crowded, work.any_squeezed)
            note_contact(axes, rows, j, t, state[i, ID], moment, h, elastic, collapse, crowded, work.any_squeezed)
            own = state[i, OWNERSHIP] >= OWN
            loss = (1.0, 1.0) if elastic else (restitution, velocity_factor)
            reals[i, VIRIAL] += collide(axes, segment, reference, i, j, t, loss, length, rates, rough, elastic, work.r)
            stop_squeezed(axes, rows, i, crowded)
            stop_squeezed(axes, rows, j, crowded)
            if elastic and own:
                note_tc_elastic(work, moment + t, state[i, ID], state[j, ID])
            counts[COLLISIONS] += own
            if logging:
                note_segment(axes, rows, i, log)
                note_segment(axes, rows, j, log)
            if work.stop[ASKED]:
                work.stop[LOWER], work.stop[HIGHER], work.stopped[0] = state[i, ID], state[j, ID], t
                return 0
