"""What a contact changes in the state of a row besides its velocity; and rows that have no room to move.

`RAPID_EVENTS` of a row counts three kinds of contacts: those in which it got nowhere, those that follow one another within t_c,
and quick ones (`rows`). A row with many quick contacts belongs to a crowd, and waits until the drift is done again. A row is
squeezed after a thousand contacts in which it got nowhere, or thousands of quick ones if crowds did not help. It is then jammed:
it stands until the end of the drift, and others that reach it are jammed too. Its velocity is multiplied by HARDLY, a power of
two, so that it moves nothing; `rows.end_drift` restores it exactly, or sets it to 0: see `Collapse`.
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
from particles_mpi.particles import Array

QUICK = 0.01  # of a drift: a contact so soon after the last one is quick
STANDING = 1e-9  # of a drift: time that does not count as passed
RATTLING = 1e-5  # of a drift: nor does this between contacts that take no energy because they follow one another so soon
ROUND_OFF_WAY = 1e-14  # of a coordinate and a radius: a way that is round-off


class Collapse(NamedTuple):
    """Which contacts take no energy, so that inelastic collapse, ever more contacts in ever less time, does not stop the clock.

    These are contacts within `duration` t_c of the last contact of either partner: the TC model (Luding and McNamara, Granular
    Matter 1, 113, 1998). If `before` is above 0, that partner must in this drift also have had so many contacts that followed one
    another within t_c, and time must have passed since the last one; or it must have had `at_once` contacts at one moment. So a
    particle that touches several others, as in a corner or in Newton's cradle, loses energy at all of them.

    `stops`: does a row without room come to rest? Where forces press it onto a wall, it would otherwise gain in each step the
    speed of a fall that does not take place. `most`: after so many quick contacts in a drift a row has no room, though it moves
    by more than round-off between them: spheres that fill a box from side to side would have millions.
    """

    duration: float
    before: int
    at_once: int
    stops: bool
    most: int
    of_pairs: bool  # do these rules concern contacts of pairs? Not if they take no energy anyway
    of_walls: Array  # (planes,) bool, the same of each plane


@lean_inner
def passes_by(jammed, rapid):
    """Does a row, `jammed` or not, ignore another one that has this number of RAPID_EVENTS?"""
    return rapid >= SQUEEZED and (jammed or rapid < JAMMED)


@in_place
def progress(d, segment, i, t, h, elastic):
    """Did row i get anywhere on its segment, which ends at time t? 1 if time has passed, or it moved by more than round-off; -1
    if it moved by round-off only, or the contact is `elastic` by the TC model; 0 if it was at rest.

    A particle that has no room meets its partners for ever, on paths that are shorter than the round-off of its position.
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
    """Change the state of row i, which begins a new segment at a contact at time t of a drift.

    With `crowd_from` quick contacts it belongs to a crowd, whose rows wait as squeezed ones do. `elastic`: the contact
    `takes_nothing`, because it follows others too soon.
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
    """Jam row i if it is SQUEEZED by contacts in which it got nowhere, but not if it belongs to a crowd."""
    rapid = rows.state[i, RAPID_EVENTS]
    if SQUEEZED <= rapid < JAMMED and rapid % FOLLOWING < crowd_from:
        jam(axes, rows, i)


@lean_inner
def stop_at_jam(axes, rows, i, t):
    """Jam row i, which touches another row at time t, if it is the one of the two that is not jammed yet."""
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
