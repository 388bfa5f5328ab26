"""What happens to a row at each of its contacts, besides its velocity; and rows that have no room to move.

`RAPID_EVENTS` of a row counts contacts in which it got nowhere, those that follow one another, and quick ones (`rows`). A row
with many quick ones is one of a crowd, and waits for the drift to be done again. After a thousand contacts in which it got
nowhere, or thousands of quick ones where that has not helped, a row is squeezed: it is jammed from then on. It stands until the
end of the drift, in the way of others, which are jammed too when they come to it. Its velocity is kept times HARDLY, a power of
two, so that it moves nothing, and is exact again when `rows.end_drift` gives it back, if it does: see `Collapse`.
"""

from typing import NamedTuple

from particles_mpi.contacts.event_driven.rows import (
    EVENT_COUNT,
    FOLLOWING,
    HARDLY,
    JAMMED,
    LAST_CONTACT,
    LAST_PARTNER,
    MOST_FOLLOWING,
    RAPID_EVENTS,
    SQUEEZED,
    ZERO_TIME_EVENT,
)
from particles_mpi.contacts.event_driven.segments import move_to
from particles_mpi.kernels.jit import in_place, lean_inner
from particles_mpi.kernels.markers import RADIUS, START

QUICK = 0.01  # of a drift: a contact so soon after the last one is quick
STANDING = 1e-9  # of a drift: time that does not count as passed
RATTLING = 1e-5  # of a drift: nor does this between contacts that take no energy because they follow one another so soon
ROUND_OFF_WAY = 1e-14  # of a coordinate and a radius: a way that is round-off


class Collapse(NamedTuple):
    """Which contacts take no energy, so that inelastic collapse, ever more contacts in ever less time, does not stop the clock.

    Those within `duration` t_c of the last contact of either partner: the TC model (Luding and McNamara, Granular Matter 1, 113,
    1998). With `before` above 0 only after so many contacts of that partner, in this drift, that followed one another so soon,
    and if time has passed, or after `at_once` contacts at one moment: what touches several others, as in a corner or in Newton's
    cradle, loses energy at all of them.

    `stops`: does what has no room come to rest? Where forces press it onto a wall it would else win, from step to step, the
    speed of a fall that does not take place. `most`: after so many quick contacts in a drift a row has no room, though it moves
    by more than round-off from one to the next: spheres that fill a box from side to side would have millions.
    """

    duration: float
    before: int
    at_once: int
    stops: bool
    most: int


@lean_inner
def passes_by(jammed, rapid):
    """Does a row, `jammed` or not, take no notice of one with this number of RAPID_EVENTS?"""
    return rapid >= SQUEEZED and (jammed or rapid < JAMMED)


@in_place
def progress(d, segment, i, t, h, elastic):
    """Did row i get anywhere on its segment, which ends at time t? 1 if time has passed, or it moved by more than round-off;
    -1 if it moved by round-off only, or the contact is `elastic` by the TC model; 0 if it was at rest.

    A particle that is shut in without room meets its partners for ever, on ways that are less than round-off of its position.
    """
    passed = t - segment[i, 2 * d + START]
    if passed > (RATTLING if elastic else STANDING) * h:
        return 1
    moved = False
    at_rest = True
    for k in range(d):
        at_rest &= segment[i, d + k] == 0.0
        moved |= abs(segment[i, d + k]) * passed > ROUND_OFF_WAY * (abs(segment[i, k]) + segment[i, 2 * d + RADIUS])
    if at_rest:
        return 0
    return 1 if moved and not elastic else -1


@in_place
def takes_nothing(d, rows, i, t, clock, collapse):
    """Does a contact of row i at time t of a drift (`event_loop.Clock`) take no energy? See `Collapse`."""
    soon = abs(clock.moment + t - rows.reals[i, LAST_CONTACT]) < collapse.duration
    if collapse.before == 0:
        return soon
    rapid = rows.state[i, RAPID_EVENTS]
    follows = (
        rapid % ZERO_TIME_EVENT // FOLLOWING >= collapse.before and t - rows.segment[i, 2 * d + START] > STANDING * clock.length
    )
    return soon and (follows or rapid >= collapse.at_once * ZERO_TIME_EVENT)


@in_place
def note_contact(axes, rows, i, t, partner, clock, elastic, collapse, crowd_from, any_squeezed):
    """Row i is about to begin a new segment at time t of a drift: change its state.

    With `crowd_from` quick contacts it is one of a crowd, whose rows wait as squeezed ones do. `elastic`: the contact
    `takes_nothing`, because it follows others so soon.
    """
    state, reals = rows.state, rows.reals
    if t - rows.segment[i, 2 * len(axes) + START] > STANDING * clock.length:  # contacts at the same moment are as one
        following = state[i, RAPID_EVENTS] % ZERO_TIME_EVENT // FOLLOWING
        soon = abs(clock.moment + t - reals[i, LAST_CONTACT]) < collapse.duration
        state[i, RAPID_EVENTS] += ((min(following + 1, MOST_FOLLOWING) if soon else 0) - following) * FOLLOWING
    way = progress(len(axes), rows.segment, i, t, clock.length, elastic)
    if way < 0:
        state[i, RAPID_EVENTS] += ZERO_TIME_EVENT
    elif way > 0:
        state[i, RAPID_EVENTS] %= ZERO_TIME_EVENT
    state[i, RAPID_EVENTS] += abs(clock.moment + t - reals[i, LAST_CONTACT]) <= QUICK * clock.length
    if state[i, RAPID_EVENTS] % FOLLOWING >= min(crowd_from, collapse.most) and state[i, RAPID_EVENTS] < SQUEEZED:
        state[i, RAPID_EVENTS] += SQUEEZED
    any_squeezed[0] |= state[i, RAPID_EVENTS] >= SQUEEZED
    state[i, LAST_PARTNER] = partner
    state[i, EVENT_COUNT] += 1
    reals[i, LAST_CONTACT] = clock.moment + t


@in_place
def stop_squeezed(axes, rows, i, crowd_from):
    """Jam row i if it is SQUEEZED by contacts in which it got nowhere, and not because it is one of a crowd."""
    rapid = rows.state[i, RAPID_EVENTS]
    if SQUEEZED <= rapid < JAMMED and rapid % FOLLOWING < crowd_from:
        jam(axes, rows, i)


@lean_inner
def stop_at_jam(axes, rows, i, t):
    """Row i, one of two that touch at time t, stops there if it is the one that is not jammed yet."""
    if rows.state[i, RAPID_EVENTS] < JAMMED:
        move_to(axes, rows.segment, i, t)
        rows.state[i, EVENT_COUNT] += 1
        jam(axes, rows, i)


@lean_inner
def jam(axes, rows, i):
    """Row i is jammed from now on."""
    rows.state[i, RAPID_EVENTS] = JAMMED
    for k in range(len(axes)):
        rows.segment[i, len(axes) + k] *= HARDLY
