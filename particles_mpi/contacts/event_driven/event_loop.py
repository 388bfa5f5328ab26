"""The compiled loop of the operator `event`: contacts one after the other, in exact order of time.

A row of `leg` (n, 2d + 2) is (x, v, s, R): the straight path x + v (t - s) that the particle has been on since s, when its
last contact was. Positions are not brought to a common time between contacts; a contact's time is a function of the two legs
alone, so how neighbours are found, and when they are looked at, leaves no trace in the bits.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from particles_mpi.contacts.event_driven.calendar_queue import (
    LEAVING,
    NEXT,
    NOTHING,
    PARTNER,
    STAMP,
    WHEN,
    before_other,
    first,
    put,
    take,
)
from particles_mpi.contacts.event_driven.rollback import (
    HISTORY,
    ID,
    LAST,
    MET,
    MINE,
    NOT_HERE,
    OWN,
    STUCK,
    TURNS,
    VIRIAL,
    note_home,
    note_leg,
    remember,
)
from particles_mpi.contacts.law import exchange, may_come_near
from particles_mpi.contacts.walls import bounce, may_hit, wall_contact
from particles_mpi.kernels.geometry import image_shift
from particles_mpi.kernels.jit import inner, lean, lean_inner, prefetch
from particles_mpi.kernels.markers import CROWD, NEVER, NOBODY
from particles_mpi.neighbours.verlet_kernels import BEGIN, COUNT, move_in, move_out, neighbours, room_for

COLLISIONS, WALL_HITS, SPARED, HOMES = 0, 1, 2, 3  # what `counts` counts
NO_TIME = 2**32  # STUCK counts contacts in a row without time passing in units of this, and below it quick ones of the drift
PATIENCE = 1000 * NO_TIME  # past it a particle is squeezed, and waits for the next step
QUICK = 0.01  # of a drift: a contact so soon after the last one is quick
BREATH, STANDSTILL = -1, -2  # what `run` returns
PIECE = 100_000  # events, about a tenth of a second
STANDING = 1e-9  # of a drift: time that does not count as passed
MOST_STANDING, FEW = 2.0 * PATIENCE / NO_TIME, 100  # events a row while no time passes; more than PATIENCE ever allows
EARLY, SOON, NEXT_ONES = 6, 4, 2  # buckets
AHEAD = 0.8  # of the shell: a new home lies that far ahead where flights are longer than shells


@inner(inline="always")
def apart(leg, d, i, j, k, start, now, length, far):
    """Component k of x_i - x_j at `start`, for the periodic images of the two that are nearest at time `now`.

    Not `far`: at most one box lies between them. Conditional expressions, because these do not branch.
    """
    r = (leg[i, k] + leg[i, d + k] * (start - leg[i, 2 * d])) - (leg[j, k] + leg[j, d + k] * (start - leg[j, 2 * d]))
    at = r + (leg[i, d + k] - leg[j, d + k]) * (now - start)
    if far:
        return r - image_shift(at, length[k])
    return r - (length[k] if at > 0.5 * length[k] else (-length[k] if at < -0.5 * length[k] else 0.0))


@inner(inline="always")
def may_touch(axes, leg, i, j, now, best, length):
    """False for most: rows whose legs move apart, or are clear of each other until `best` (by margins above round-off)."""
    d = len(axes)
    start = leg[i, 2 * d] if leg[i, 2 * d] >= leg[j, 2 * d] else leg[j, 2 * d]
    a = 0.0
    b = 0.0
    r2 = 0.0
    for k in range(d):
        r = apart(leg, d, i, j, k, start, now, length, False)
        u = leg[i, d + k] - leg[j, d + k]
        a += u * u
        b += r * u
        r2 += r * r
    diameter = leg[i, 2 * d + 1] + leg[j, 2 * d + 1]
    return may_come_near(a, b, r2, diameter, best - start)


@inner(inline="always")
def may_touch_from(axes, leg, i, j, now, best, length):
    """`may_touch` for a row i whose leg begins now."""
    d = len(axes)
    a = 0.0
    b = 0.0
    r2 = 0.0
    for k in range(d):
        r = leg[i, k] - (leg[j, k] + leg[j, d + k] * (now - leg[j, 2 * d]))
        r -= length[k] * (np.float64(r > 0.5 * length[k]) - np.float64(r < -0.5 * length[k]))
        u = leg[i, d + k] - leg[j, d + k]
        a += u * u
        b += r * u
        r2 += r * r
    diameter = leg[i, 2 * d + 1] + leg[j, 2 * d + 1]
    return may_come_near(a, b, r2, diameter, best - now)


@inner(inline="always")
def touch_time(axes, leg, i, j, now, h, length, far, r, u):
    """Time at which the legs of i and j first touch, up to h, or NEVER: the root of `law.contact_time`.

    `now`, at or after both starts, only tells which periodic images are meant; r, u (d,) are for scribbling.
    """
    d = len(axes)
    start = leg[i, 2 * d] if leg[i, 2 * d] >= leg[j, 2 * d] else leg[j, 2 * d]
    a = 0.0
    b = 0.0
    r2 = 0.0
    own = 0.0
    for k in range(d):
        r[k] = apart(leg, d, i, j, k, start, now, length, far)
        u[k] = leg[i, d + k] - leg[j, d + k]
        a += u[k] * u[k]
        b += r[k] * u[k]
        r2 += r[k] * r[k]
        own += leg[i, d + k] * leg[i, d + k] + leg[j, d + k] * leg[j, d + k]
    if not b < 0.0 or b * b <= 1e-28 * r2 * own:  # together but for round-off is no approach
        return NEVER
    diameter = leg[i, 2 * d + 1] + leg[j, 2 * d + 1]
    if diameter == 0.0 and d > 1:  # points meet on a line only
        return NEVER
    distance = sqrt(r2)
    gap = distance - diameter
    if gap <= 0.0:
        return start
    disc = a * diameter * diameter
    for k in range(d):
        for m in range(k):
            cross = r[k] * u[m] - r[m] * u[k]
            disc -= cross * cross
    if disc < 0.0:
        return NEVER
    t = start + gap * (distance + diameter) / (sqrt(disc) - b)
    return t if t <= h else NEVER


@lean_inner
def move_leg(axes, leg, i, t):
    """A new leg of row i begins at time t, where the old one gets then."""
    d = len(axes)
    for k in range(d):
        leg[i, k] += leg[i, d + k] * (t - leg[i, 2 * d])
    leg[i, 2 * d] = t


@lean_inner
def collide(axes, leg, home, i, j, t, restitution, keep, length, rates, r):
    """The contact of rows i and j at time t: `law.meet` on legs. Returns its virial, -r.dp."""
    d = len(axes)
    own, other = home[i, d + 2], home[j, d + 2]  # inverse masses
    move_leg(axes, leg, i, t)
    move_leg(axes, leg, j, t)
    for k in range(d):
        r[k] = leg[i, k] - leg[j, k]
        r[k] -= image_shift(r[k], length[k])
    if d == 1:  # there is one normal, even for points, whose distance is none
        approach = r[0] * (leg[i, d] - leg[j, d])
        r[0] = 1.0 if leg[i, d] < leg[j, d] else -1.0
        nearing = r[0] * (leg[i, d] - leg[j, d])
        take = exchange(axes, leg, np.int64(d), r, i, j, own, other, t, restitution, keep, rates)
        return -((1.0 + restitution if len(rates.a) == 0 else take / nearing) * approach) / (own + other)
    return -exchange(axes, leg, np.int64(d), r, i, j, own, other, t, restitution, keep, rates) / (own + other)


@lean_inner
def nearest_image(d, r, length):
    """Is r the nearest periodic image of a distance? Of partners who last met each other it is the one that met."""
    nearest = True
    for k in range(d):
        nearest &= length[k] == 0.0 or abs(r[k]) <= 0.5 * length[k]
    return nearest


@inner(inline="always")
def next_event(
    axes, leg, state, i, now, h, length, pool, lists, home, point, normal, lower, upper, oblique, far, r, u, around,
):  # fmt: skip
    """(time, partner) of the next event of row i, on the legs of now: its first contact of all, or that it leaves its shell."""
    d = len(axes)
    best = h
    partner = np.int64(NOTHING)
    if state[i, STUCK] < PATIENCE:
        likely = 0
        warm = 0.0  # all at once to the cache: the loops below would ask for one after the other
        for p in range(np.uint64(lists[i, BEGIN]), np.uint64(lists[i, BEGIN] + lists[i, COUNT])):
            warm += leg[np.uint64(pool[p]), 0]
        r[0] = warm
        if leg[i, 2 * d] == now and not far[0]:  # it sets out now, and most others set out before: less to compute
            for p in range(np.uint64(lists[i, BEGIN]), np.uint64(lists[i, BEGIN] + lists[i, COUNT])):
                around[np.uint64(likely)] = pool[p]
                likely += may_touch_from(axes, leg, np.uint64(i), np.uint64(pool[p]), now, h, length)
        else:
            for p in range(np.uint64(lists[i, BEGIN]), np.uint64(lists[i, BEGIN] + lists[i, COUNT])):
                around[np.uint64(likely)] = pool[p]
                likely += far[0] | may_touch(axes, leg, np.uint64(i), np.uint64(pool[p]), now, h, length)
        for p in range(likely):
            j = np.int64(around[p])
            t = touch_time(axes, leg, np.uint64(i), np.uint64(j), now, best, length, far[0], r, u)
            if (
                t != NEVER
                and (t < best or partner == NOTHING or before_other(i, j, i, partner, state))
                and not (far[1] and state[j, STUCK] >= PATIENCE)
                and not (
                    leg[i, 2 * d] == leg[j, 2 * d]
                    and state[i, MET] == state[j, ID]
                    and state[j, MET] == state[i, ID]
                    and nearest_image(d, r, length)
                )
            ):
                best = t
                partner = j
        if len(point) and may_hit(axes, leg, leg, np.int64(d), leg[i, 2 * d], i, leg[i, 2 * d + 1], h, lower, upper, oblique):
            t, wall = wall_contact(
                axes, leg, leg, np.int64(d), leg[i, 2 * d], i, leg[i, 2 * d + 1], state[i, MET], h, point, normal
            )
            if wall >= 0 and (t < best or partner == NOTHING):
                best = t
                partner = np.int64(-1 - wall)
    a = 0.0
    b = 0.0
    c = -home[i, d + 1] * home[i, d + 1]
    for k in range(d):
        away = leg[i, k] + leg[i, d + k] * (now - leg[i, 2 * d]) - home[i, k]
        a += leg[i, d + k] * leg[i, d + k]
        b += away * leg[i, d + k]
        c += away * away
    # It leaves before `best` if it is out of its shell then: most do not, and need no root.
    until = best - now
    if c + until * (2.0 * b + a * until) > 0.0 and (a > 0.0 or c > 0.0):
        best = now
        if c < 0.0:
            root = sqrt(max(b * b - a * c, 0.0))
            best += -c / (b + root) if b > 0.0 else (root - b) / a
        partner = np.int64(LEAVING)
    return best, partner


@lean_inner
def turn(axes, leg, state, reals, i, t, partner, moment, quickly, crowded, far):
    """Row i is about to begin a new leg at time t: what must be remembered of it. Crowded rows wait as squeezed ones do."""
    if t != leg[i, 2 * len(axes)]:
        state[i, STUCK] %= NO_TIME
    else:
        state[i, STUCK] += NO_TIME
    state[i, STUCK] += abs(moment + t - reals[i, LAST]) <= quickly
    if state[i, STUCK] % NO_TIME >= crowded and state[i, STUCK] < PATIENCE:
        state[i, STUCK] += PATIENCE
    far[1] |= state[i, STUCK] >= PATIENCE
    state[i, MET] = partner
    state[i, TURNS] += 1
    reals[i, LAST] = moment + t


@lean_inner
def fetch(axes, leg, state, slot, lists, pool, home, heads, clock):
    """What the next events will need comes to the cache while this one is worked on: rows, then lists, then neighbours."""
    last = len(heads) - 1
    i = np.int64(heads[min(clock[0] + EARLY, last)])
    if i >= 0:
        prefetch(slot, i)
        prefetch(lists, i)
        prefetch(leg, i)
        prefetch(state, i)
        prefetch(home, i)
    i = np.int64(heads[min(clock[0] + SOON, last)])
    if i >= 0:
        prefetch(pool, lists[i, BEGIN])
        prefetch(slot, slot[i, NEXT])
        j = np.int64(slot[i, PARTNER])
        if j >= 0:
            prefetch(slot, j)
            prefetch(lists, j)
            prefetch(leg, j)
            prefetch(state, j)
            prefetch(home, j)
    i = np.int64(heads[min(clock[0] + NEXT_ONES, last)])
    if i >= 0:
        for p in range(np.uint64(lists[i, BEGIN]), np.uint64(lists[i, BEGIN] + lists[i, COUNT])):
            prefetch(leg, pool[p])
        j = np.int64(slot[i, PARTNER])
        if j >= 0:
            for p in range(np.uint64(lists[j, BEGIN]), np.uint64(lists[j, BEGIN] + lists[j, COUNT])):
                prefetch(leg, pool[p])


@lean
def run(
    axes, leg, leg_words, state, reals, h, now, until, moment, length, pool, lists, top, home, links, level, head, grid,
    walls, wall_restitution, wall_keep, rates, restitution, keep, soft, queue, counts, spared, ahead, box_low, around,
    todo, pending, stop, stopped, crowded, reached, log,
):  # fmt: skip
    """All events from `now` to `until`, in order, of a drift over h that began at `moment`. `soft`: duration t_c of a contact.

    Rows with `crowded` quick contacts have no more in this drift.
    With stop[0] it ends after the first collision, whose time goes to `stopped` and ids to stop[1:].
    Returns 0; or how many places the pool is short of: then call again with a larger one; or BREATH after so many events that
    a user may have pressed Ctrl-C: then call again; or STANDSTILL, where events follow one another for ever but time does not
    pass: todo[0] is then a row, todo[1] its partner. `reached` (2,): the last time that is further on than the one before by
    a part STANDING of the drift, and how many events there have been since.

    A contact within t_c of the last one of either partner takes no energy: the TC model (Luding and McNamara, Granular
    Matter 1, 113, 1998), which keeps inelastic collapse from stopping the clock. `spared` lists the first of them.
    What is counted is what own rows did, a pair by its lower id. todo[:pending]: rows whose next event is not known.

    One kernel with everything in it: a call with so many arrays costs as much as the look it would be for.
    """
    d = len(axes)
    slot, when, heads, per_time, clock, far, r, u = queue
    low, per, cells, corners, caps = grid
    point, normal, lower, upper, oblique = walls
    logging = log[0][0] > 0
    events = 0
    while True:
        if pending > 0:
            pending -= 1
            i = np.int64(todo[pending])
            if state[i, MINE] == NOT_HERE:
                continue
            take(slot, heads, i)
            t, partner = next_event(
                axes, leg, state, i, now, h, length, pool, lists, home, point, normal, lower, upper, oblique, far, r, u,
                around,
            )  # fmt: skip
            if partner != NOTHING:
                put(slot, when, heads, per_time, clock, i, t, partner, state[partner, TURNS] if partner >= 0 else 0)
            continue
        fetch(axes, leg, state, slot, lists, pool, home, heads, clock)
        i = first(slot, when, heads, clock, state)
        if i < 0 or when[i, WHEN] >= until:
            return 0
        t = when[i, WHEN]
        j = np.int64(slot[i, PARTNER])
        reached[1] += 1.0
        if t > reached[0] + STANDING * h:
            reached[0], reached[1] = t, 0.0
        elif reached[1] > MOST_STANDING * (len(leg) + FEW):
            todo[0], todo[1] = i, j
            return STANDSTILL
        events += 1
        if events > PIECE:
            return BREATH
        now = max(now, t)
        if logging:
            remember(axes, leg, state, i, log)
        todo[0] = i
        pending = 1
        if j == LEAVING:
            speed = 0.0
            for k in range(d):
                speed += leg[i, d + k] * leg[i, d + k]
            lead = ahead * home[i, d + 1] / sqrt(speed) if speed > 0.0 else 0.0
            for k in range(d):
                home[i, k] = leg[i, k] + leg[i, d + k] * (now - leg[i, 2 * d] + lead)
                far[0] |= length[k] > 0.0 and not -0.25 * length[k] < home[i, k] - box_low[k] < 1.25 * length[k]
            found = neighbours(axes, i, home, links, head, low, per, cells, corners, caps, length, far[0], around)
            short = top[0] + room_for(i, around, found, lists) - len(pool)
            if short > 0:
                return short
            move_out(axes, i, links, pool, lists, head)
            move_in(axes, i, home, links, level, around, found, pool, lists, top, head, low, per, cells, corners, length)
            counts[HOMES] += 1
            if logging and state[i, MINE] >= OWN:
                note_home(i, log)
        elif j < 0:
            wall = -1 - j
            lossy = wall_restitution[wall] * wall_keep[wall] < 1.0
            easy = lossy and abs(moment + t - reals[i, LAST]) < soft
            turn(axes, leg, state, reals, i, t, j, moment, QUICK * h, crowded, far)
            move_leg(axes, leg, i, t)
            mine = state[i, MINE] >= OWN
            e, kept = (1.0, 1.0) if easy else (wall_restitution[wall], wall_keep[wall])
            bounce(axes, leg, np.int64(d), i, wall, normal, e, kept, home[i, d + 2], t, rates)
            if easy and mine:
                note(spared, counts, moment + t, state[i, ID], j)
            counts[WALL_HITS] += mine
            if logging:
                note_leg(axes, leg, leg_words, state, i, log)
        elif slot[i, STAMP] == state[j, TURNS]:
            if logging:
                remember(axes, leg, state, j, log)
            todo[1] = j
            pending = 2
            if state[j, ID] < state[i, ID]:
                i, j = j, i
            easy = restitution * keep < 1.0 and abs(moment + t - max(reals[i, LAST], reals[j, LAST])) < soft
            turn(axes, leg, state, reals, i, t, state[j, ID], moment, QUICK * h, crowded, far)
            turn(axes, leg, state, reals, j, t, state[i, ID], moment, QUICK * h, crowded, far)
            mine = state[i, MINE] >= OWN
            e, kept = (1.0, 1.0) if easy else (restitution, keep)
            reals[i, VIRIAL] += collide(axes, leg, home, i, j, t, e, kept, length, rates, r)
            if easy and mine:
                note(spared, counts, moment + t, state[i, ID], state[j, ID])
            counts[COLLISIONS] += mine
            if logging:
                note_leg(axes, leg, leg_words, state, i, log)
                note_leg(axes, leg, leg_words, state, j, log)
            if stop[0]:
                stop[1], stop[2], stopped[0] = state[i, ID], state[j, ID], t
                return 0


@lean_inner
def note(spared, counts, t, one, other):
    """One more contact that took no energy; the first ones by name."""
    if counts[SPARED] < len(spared):
        spared[counts[SPARED], 0], spared[counts[SPARED], 1], spared[counts[SPARED], 2] = t, one, other
    counts[SPARED] += 1


@lean
def set_out(axes, leg, state, reals, acceleration, x, v, radius, contacted, virial, a, seat):
    """Own rows on legs from (x, v) at time 0, with accelerations a where these differ; particle r is row seat[r].

    Returns (moved, speed): did anyone change a position or radius since `arrive`, and the largest speed, inf if
    anything is not finite.
    """
    d = len(axes)
    moved = False
    fastest = 0.0
    for r in range(len(x)):
        i = seat[r]
        speed = 0.0
        for k in range(d):
            moved |= leg[i, k] != x[r, k]
            leg[i, k] = x[r, k]
            leg[i, d + k] = v[r, k]
            speed += v[r, k] * v[r, k] + 0.0 * x[r, k]
        moved |= leg[i, 2 * d + 1] != radius[r]
        fastest = max(fastest, speed) if speed < np.inf else np.inf
        leg[i, 2 * d] = 0.0
        state[i, MET], state[i, STUCK], state[i, HISTORY] = NOBODY, 0, 0
        reals[i, LAST] = contacted[r]
        reals[i, VIRIAL] = virial[r] if len(virial) else 0.0
        if len(a) > 0:
            for k in range(d):
                acceleration[i, k] = a[r, k]
    return moved, sqrt(fastest)


@lean
def arrive(axes, leg, state, h, home, length, lower):
    """All rows to time h, back in a periodic box with their homes. Returns how many own ones were squeezed."""
    d = len(axes)
    squeezed = 0
    for i in range(len(leg)):
        if state[i, MINE] == NOT_HERE:
            continue
        if state[i, STUCK] >= PATIENCE:
            squeezed += state[i, MINE] >= OWN
            leg[i, 2 * d] = h  # it stays where its last contact was
        for k in range(d):
            at = leg[i, k] + leg[i, d + k] * (h - leg[i, 2 * d])
            if length[k] > 0.0 and not lower[k] <= at < lower[k] + length[k]:
                inside = lower[k] + (at - lower[k]) % length[k]
                inside = inside if inside < lower[k] + length[k] else lower[k]
                home[i, k] += inside - at
                at = inside
            leg[i, k] = at
        leg[i, 2 * d] = 0.0
    return squeezed


@lean
def hand_over(axes, leg, state, reals, x, v, contacted, virial, supported, crowded, seat):
    """Particles as their rows are."""
    d = len(axes)
    for r in range(len(x)):
        i = seat[r]
        for k in range(d):
            x[r, k] = leg[i, k]
            v[r, k] = leg[i, d + k]
        contacted[r] = reals[i, LAST]
        if len(virial):
            virial[r] = reals[i, VIRIAL]
        if len(supported) and state[i, STUCK] % NO_TIME >= crowded:
            supported[r] = CROWD
