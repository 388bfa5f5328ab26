"""The compiled loop of mode `event`: all contacts of a rank's rows, one after the other in exact order of time."""

from math import sqrt
from typing import NamedTuple

import numpy as np

from particles_mpi.contacts.event_driven.calendar_queue import (
    EMPTY,
    LIST_EXPIRY,
    NO_EVENT,
    PARTNER,
    PARTNER_COUNT,
    TIME,
    UNSORTED,
    Queue,
    advance,
    cancel,
    find_first,
    push,
)
from particles_mpi.contacts.event_driven.jams import STANDING, Collapse, note_contact, stop_at_jam, stop_squeezed, takes_nothing
from particles_mpi.contacts.event_driven.next_event import next_event, prefetch_next
from particles_mpi.contacts.event_driven.rows import (
    EVENT_COUNT,
    ID,
    JAMMED,
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
from particles_mpi.contacts.event_driven.segments import collide, move_to
from particles_mpi.contacts.law import Loss
from particles_mpi.contacts.rough import Rough
from particles_mpi.contacts.velocity_flow import Rates
from particles_mpi.contacts.walls import bounce, meet_wall
from particles_mpi.kernels.jit import in_place, lean, lean_inner
from particles_mpi.kernels.markers import RADIUS, START
from particles_mpi.kernels.planes import Planes
from particles_mpi.neighbours.verlet_kernels import INVERSE_MASS, SKIN, Lists, compare, find_nearby, relist, shortage
from particles_mpi.particles import Array

COLLISIONS, WALL_HITS, TC_ELASTIC, EXPIRIES = range(4)  # what `counts` counts
STOPS, LOWER, HIGHER = range(3)  # numbers in `stop`
LAST_PROGRESS, EVENTS_SINCE = range(2)  # numbers in `progress`
INTERRUPTED, STANDSTILL, FULL_BUCKET = -1, -2, -3  # what `run` returns
EVENTS_A_CALL = 100_000  # about a tenth of a second
MOST_STANDING = 2.0 * SQUEEZED / ZERO_TIME_EVENT  # events a row while no time passes: twice what SQUEEZED allows
SPARE_ROWS = 100  # added to the number of rows there, for few of them


class Work(NamedTuple):
    """What `run` writes besides rows, lists, queue and log. Counted is what own rows did, a pair by the row with the lower id."""

    stale: Array  # (2 n + 2,) int32: rows whose next event is not known; at a standstill, a row and its partner
    counts: Array  # (4,) COLLISIONS, WALL_HITS, those of them that were TC_ELASTIC, and list EXPIRIES of all rows
    tc_elastic: Array  # (m, 3) the first contacts that took no energy: time, id, id or -1 - wall
    stop: Array  # (3,) int64: STOPS: does it end after the first collision, then its LOWER and HIGHER id
    stopped: Array  # (1,) when the drift ends: at that collision, or else at its length
    progress: Array  # (2,) LAST_PROGRESS: when time last passed by more than STANDING of the drift; EVENTS_SINCE that
    any_squeezed: Array  # (1,) bool: is any row squeezed?
    place: Array  # (d,) scratch
    r: Array  # (d,) scratch
    u: Array  # (d,) scratch
    normal: Array  # (d,) scratch
    impulse: Array  # (d,) scratch


class Rules(NamedTuple):
    """What is the same for all contacts of a drift."""

    loss: Loss  # of a contact of two rows
    law: Array  # of rough spheres, see `Rough`
    collapse: Collapse
    crowd_from: int  # quick contacts that make a crowd
    planes: Planes
    rates: Rates


class Clock(NamedTuple):
    """What is known of the time: `length` of the drift, and the `moment` at which it began; events count from that moment."""

    length: float
    moment: float


@lean_inner
def note_tc_elastic(work, t, one, other):
    """Count a contact that took no energy; of the first ones, note time and partners."""
    counts, named = work.counts, work.tc_elastic
    if counts[TC_ELASTIC] < len(named):
        named[counts[TC_ELASTIC], 0], named[counts[TC_ELASTIC], 1], named[counts[TC_ELASTIC], 2] = t, one, other
    counts[TC_ELASTIC] += 1


@in_place
def renew_list(axes, rows, lists, work, log, i, now, ahead):
    """The list of row i has expired: it gets a new one, around a reference position `ahead` skins further on its way.

    Returns how many places the pool of the lists is short of; if there are any, nothing else has been done.
    """
    segment, reference, d = rows.segment, lists.reference, len(axes)
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
    work.counts[EXPIRIES] += 1
    if log.window[0] > 0 and rows.state[i, OWNERSHIP] >= OWN:
        note_move(i, log)
    return 0


@in_place
def hit_wall(axes, rows, lists, rules, rough, work, log, i, wall, t, clock):
    """Carry out the contact of row i with a wall at time t."""
    segment, state, planes, d = rows.segment, rows.state, rules.planes, len(axes)
    elastic = rules.collapse.of_walls[wall] and takes_nothing(d, rows, i, t, clock, rules.collapse)
    note_contact(axes, rows, i, t, -1 - wall, clock, elastic, rules.collapse, rules.crowd_from, work.any_squeezed)
    move_to(axes, segment, i, t)
    w = lists.reference[i, d + INVERSE_MASS]
    if elastic:
        bounce(axes, segment, np.int64(d), i, wall, planes.normal, 1.0, 1.0, w, t, rules.rates)
    else:
        loss = planes.restitution[wall], planes.velocity_factor[wall]
        meet_wall(axes, segment, np.int64(d), i, wall, segment[i, 2 * d + RADIUS], w, t, loss, planes.normal, rules.rates, rough)
    stop_squeezed(axes, rows, i, rules.crowd_from)
    own = state[i, OWNERSHIP] >= OWN
    if elastic and own:
        note_tc_elastic(work, clock.moment + t, state[i, ID], -1 - wall)
    work.counts[WALL_HITS] += own
    if log.window[0] > 0:
        note_segment(axes, rows, i, log)


@in_place
def hit_row(axes, rows, lists, rules, rough, work, log, i, j, t, clock):
    """Rows i and j meet at time t; row i has the lower id. Returns whether they collide, and do not stop at a jam."""
    state = rows.state
    collides = max(state[i, RAPID_EVENTS], state[j, RAPID_EVENTS]) < JAMMED
    if collides:
        collapse, any_squeezed = rules.collapse, work.any_squeezed
        elastic = collapse.of_pairs and (
            takes_nothing(len(axes), rows, i, t, clock, collapse) or takes_nothing(len(axes), rows, j, t, clock, collapse)
        )
        note_contact(axes, rows, i, t, state[j, ID], clock, elastic, collapse, rules.crowd_from, any_squeezed)
        note_contact(axes, rows, j, t, state[i, ID], clock, elastic, collapse, rules.crowd_from, any_squeezed)
        loss = (1.0, 1.0) if elastic else (rules.loss.restitution, rules.loss.velocity_factor)
        length = lists.box[2]
        rows.reals[i, VIRIAL] += collide(
            axes, rows.segment, lists.reference, i, j, t, loss, length, rules.rates, rough, elastic, work.r
        )
        stop_squeezed(axes, rows, i, rules.crowd_from)
        stop_squeezed(axes, rows, j, rules.crowd_from)
        own = state[i, OWNERSHIP] >= OWN
        if elastic and own:
            note_tc_elastic(work, clock.moment + t, state[i, ID], state[j, ID])
        work.counts[COLLISIONS] += own
    else:
        stop_at_jam(axes, rows, i, t)
        stop_at_jam(axes, rows, j, t)
    if log.window[0] > 0:
        note_segment(axes, rows, i, log)
        note_segment(axes, rows, j, log)
    return collides


@in_place
def time_stands_still(work, t, h, rows):
    """Count an event at time t of a drift over h. Have so many followed in no time that they will not end?"""
    progress = work.progress
    progress[EVENTS_SINCE] += 1.0
    if t > progress[LAST_PROGRESS] + STANDING * h:
        progress[LAST_PROGRESS], progress[EVENTS_SINCE] = t, 0.0
    return progress[EVENTS_SINCE] > MOST_STANDING * (rows + SPARE_ROWS)


@lean
def run(axes, rows, lists, queue, rules, interval, work, log, pending):
    """Carry out all events of an interval, in order. work.stale[:pending] are rows whose next event is not known.

    rules: see `Rules`. interval: the `Clock`, the beginning and the end of the interval, and how many skins ahead of a particle
    its new reference position lies. Returns 0, or a reason for which it must be called again: a number of places that the pool of
    the lists lacks (enlarge it first); INTERRUPTED, after so many events that a user may have pressed Ctrl-C; FULL_BUCKET (sort
    it first). STANDSTILL: events follow one another for ever but time does not pass. With stop[STOPS] the loop ends after the
    first collision.

    The functions that it calls are inlined: a call with so many arrays takes as long as the work in it. The bundles come as plain
    tuples, as in all kernels of this folder that Python calls: see `jit.plain`.
    """
    rows, lists, queue, work, log = Rows(*rows), Lists(*lists), Queue(*queue), Work(*work), Log(*log)
    loss, law, collapse, crowd_from, planes, rates = rules
    rules = Rules(Loss(*loss), law, Collapse(*collapse), crowd_from, Planes(*planes), rates)
    rough = Rough(rows.spin, rows.inverse_inertia, law, work.normal, work.impulse)
    clock, now, until, ahead = interval
    clock = Clock(*clock)
    state, node, times, stale = rows.state, queue.node, queue.times, work.stale
    events = 0
    while True:
        if pending > 0:
            pending -= 1
            i = np.int64(stale[pending])
            if state[i, OWNERSHIP] == NOT_HERE:
                continue
            cancel(queue, i)
            t, partner = next_event(axes, rows, lists, rules.planes, work, i, now, clock.length)
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
        t, j = times[i, TIME], np.int64(node[i, PARTNER])
        if time_stands_still(work, t, clock.length, len(state)):
            stale[0], stale[1] = i, j
            return STANDSTILL
        events += 1
        if events > EVENTS_A_CALL:
            return INTERRUPTED
        now = max(now, t)
        if log.window[0] > 0:
            save_once(axes, rows, i, log)
        stale[0] = i
        pending = 1
        if j == LIST_EXPIRY:
            short = renew_list(axes, rows, lists, work, log, i, now, ahead)
            if short > 0:
                return short
        elif j < 0:
            hit_wall(axes, rows, lists, rules, rough, work, log, i, -1 - j, t, clock)
        elif node[i, PARTNER_COUNT] == state[j, EVENT_COUNT]:
            if log.window[0] > 0:
                save_once(axes, rows, j, log)
            stale[1] = j
            pending = 2
            if state[j, ID] < state[i, ID]:
                i, j = j, i
            if hit_row(axes, rows, lists, rules, rough, work, log, i, j, t, clock) and work.stop[STOPS]:
                work.stop[LOWER], work.stop[HIGHER], work.stopped[0] = state[i, ID], state[j, ID], t
                return 0
