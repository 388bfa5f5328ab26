"""Planes that reflect spheres: contact at (x-p).n = R with v.n < 0, then v -= (1+e)(v.n) n. Scalars and arrays only.

The velocity of row i stands in `v[i, column:]`, because rows of mode event hold place, velocity and more in one array.
"""

from typing import NamedTuple

import numpy as np

from particles_mpi.contacts.law import TOGETHER2
from particles_mpi.contacts.rough import FRICTION, strike_wall
from particles_mpi.contacts.velocity_flow import change_of, row_of
from particles_mpi.kernels.jit import lean, lean_inner
from particles_mpi.kernels.markers import NO_PARTNER
from particles_mpi.kernels.motion import move_to
from particles_mpi.particles import Array

# Where so many bounces of one particle take less than that part of a step, it has no room, or bounces in a wedge without end.
BOUNCES, LEAST_TIME = 1000, 1e-4


class WallNotes(NamedTuple):
    """What `drift_with_walls` notes of rows; of hits only if there is room. Kernels take it as a plain tuple."""

    start: Array  # (n,): when the last segment of each row near a wall begins
    row: Array  # with hits
    wall: Array  # the last wall of each of these, as -1 - wall
    time: Array  # of that hit


@lean_inner
def may_hit(axes, x, v, column, start, i, radius, h, planes):
    """False only if the segment of row i, from `start` to h, meets no wall: quick to compute, and never wrongly False."""
    _, _, _, _, lower, upper, oblique = planes
    inside = not oblique
    for k in range(len(axes)):
        end = x[i, k] + v[i, column + k] * (h - start)
        inside &= (end >= lower[k] + radius) & (end <= upper[k] - radius)
    return not inside


@lean_inner
def wall_contact(axes, x, v, column, start, i, radius, last_partner, h, planes):
    """(time, wall) of the earliest wall contact of row i's segment in [start, h], lowest wall first; wall -1 if none.

    The wall that this segment started from (`last_partner` = -1 - wall) is left out: round-off must not hit it twice.
    """
    point, normal, _, _, _, _, _ = planes
    first = h
    which = -1
    for wall in range(point.shape[0]):
        speed = 0.0
        for k in range(len(axes)):
            speed += v[i, column + k] * normal[wall, k]
        if not speed < 0.0 or last_partner == -1 - wall:
            continue
        v2 = 0.0
        for k in range(len(axes)):
            v2 += v[i, column + k] * v[i, column + k]
        if speed * speed <= TOGETHER2 * v2:  # along the wall but for round-off, as after e = 0
            continue
        distance = 0.0
        for k in range(len(axes)):
            distance += (x[i, k] - point[wall, k]) * normal[wall, k]
        gap = distance - radius
        t = start - gap / speed if gap > 0.0 else start
        if t < first or (t == first and which < 0):
            first = t
            which = wall
    return first, which


@lean_inner
def bounce(axes, v, column, i, wall, normal, restitution, velocity_factor, inverse_mass, t, rates):
    """Apply the law of a contact with a wall at time t: v -= (1+e)(v.n) n, then v times `velocity_factor`.

    `law.apply_impulse` is the law of a pair.
    """
    speed = 0.0
    for k in range(len(axes)):
        speed += v[i, column + k] * normal[wall, k]
    if len(rates.a) > 0 and bounce_at_contact(
        v, column, i, wall, normal, speed, restitution, velocity_factor, inverse_mass, t - rates.t_mid, rates
    ):
        return
    after = speed - (1.0 + restitution) * speed
    for k in range(len(axes)):
        v[i, column + k] = velocity_factor * ((v[i, column + k] - speed * normal[wall, k]) + after * normal[wall, k])


@lean_inner
def bounce_at_contact(v, column, i, wall, normal, speed, restitution, velocity_factor, inverse_mass, tau, rates):
    """`bounce` of the velocity at the moment of contact, a time tau after the middle of the step: see `velocity_flow`.

    `speed`: v.n of the segment. Returns False, and changes nothing, for a particle so slow that it would have moved off the
    wall at the contact, or would move into it afterwards.
    """
    a, at = rates.a, row_of(i, rates)
    v2 = 0.0
    for k in range(normal.shape[1]):
        v2 += v[i, column + k] * v[i, column + k]
    decay, force_time = change_of(i, v2, inverse_mass, tau, rates)
    acceleration_offset = 0.0
    for k in range(normal.shape[1]):
        acceleration_offset += force_time * a[at, k] * normal[wall, k]
    approach = decay * speed + acceleration_offset
    if not approach < 0.0:
        return False
    change = (1.0 + restitution) * approach
    v2, along = 0.0, 0.0
    for k in range(normal.shape[1]):
        v2 += (velocity_factor * (decay * v[i, column + k] + force_time * a[at, k] - change * normal[wall, k])) ** 2
        along += a[at, k] * normal[wall, k]
    back, pull = change_of(i, v2, inverse_mass, -tau, rates)
    back *= velocity_factor
    if back * (approach - change) + pull * along < 0.0 and acceleration_offset != 0.0:
        return False
    after = speed - change / decay
    left = back * force_time + pull  # 0 without a loss
    for k in range(normal.shape[1]):
        along_wall = v[i, column + k] - speed * normal[wall, k]
        v[i, column + k] = back * decay * (along_wall + after * normal[wall, k]) + left * a[at, k]
    return True


@lean_inner
def meet_wall(axes, v, column, i, wall, radius, inverse_mass, t, loss, normal, rates, rough):
    """The contact of row i with a wall at time t, smooth or rough; `loss`: (restitution, velocity factor) of this contact."""
    restitution, velocity_factor = loss
    if rough.law[1 + wall, FRICTION] > 0.0:
        strike_wall(axes, v, column, rough, i, wall, normal, inverse_mass, radius, t, restitution, rates)
    else:
        bounce(axes, v, column, i, wall, normal, restitution, velocity_factor, inverse_mass, t, rates)


@lean_inner
def bounce_until(axes, x, v, start, last_partner, i, radius, inverse_mass, h, planes, rates, rough):
    """Take row i through all its wall contacts up to time h.

    Returns (number of contacts, stuck, last partner). stuck: 1 if the row gets nowhere, and then it stays at its last contact
    until h; else 0.
    """
    _, normal, restitution, velocity_factor, _, _, _ = planes
    hits, before = 0, start[i]
    while True:
        t, wall = wall_contact(axes, x, v, np.int64(0), start[i], i, radius, last_partner, h, planes)
        if wall < 0:
            return hits, 0, last_partner
        hits += 1
        if hits % BOUNCES == 0:
            if t - before < LEAST_TIME * h:
                start[i] = h
                return hits, 1, last_partner
            before = t
        move_to(axes, x, v, start, i, t)
        loss = restitution[wall], velocity_factor[wall]
        meet_wall(axes, v, np.int64(0), i, wall, radius, inverse_mass, t, loss, normal, rates, rough)
        last_partner = -1 - wall


@lean
def drift_with_walls(axes, x, v, radius, inverse_mass, notes, h, planes, rates, rough, reach, near):
    """Do x += v h with reflections by walls. In place on x, v (n, d).

    Returns (number of hits, number of rows that got nowhere, number of rows in `near`, number of rows in `notes`, a `WallNotes`).
    `inverse_mass` (n,), or no row where nothing depends on it. `near` (n,), if it has room, lists the rows that may be within
    `reach` of a wall at the end.
    """
    start, last_row, last_wall, last_time = notes
    hits, missed, found, noted = 0, 0, 0, 0
    for i in range(len(x)):
        if not may_hit(axes, x, v, np.int64(0), 0.0, i, radius[i] + reach, h, planes):  # far from all walls, as most are
            for k in range(len(axes)):
                x[i, k] += v[i, k] * h
            continue
        start[i] = 0.0
        if may_hit(axes, x, v, np.int64(0), 0.0, i, radius[i], h, planes):
            w = inverse_mass[i] if len(inverse_mass) > 0 else 1.0
            more, stuck, wall = bounce_until(axes, x, v, start, np.int64(NO_PARTNER), i, radius[i], w, h, planes, rates, rough)
            hits, missed = hits + more, missed + stuck
            if more > 0 and len(last_row) > 0:
                last_row[noted], last_wall[noted], last_time[noted] = i, wall, start[i]
                noted += 1
        for k in range(len(axes)):
            x[i, k] += v[i, k] * (h - start[i])
        if len(near) > 0:
            near[found] = i
            found += 1
    return hits, missed, found, noted


@lean
def finish_bounces(v, before, after, row, wall, time, number, h, normal, restitution):
    """Apply `closing_kick` to the first `number` of rows, whose last contact in a drift over h was with a wall.

    before, after (n, d): accelerations at the start of the drift, and at its end; wall: as -1 - wall. In place on v (n, d).
    """
    for p in range(number):
        i, w = row[p], -1 - wall[p]
        lacking = 0.0
        for k in range(v.shape[1]):
            lacking += (after[i, k] - before[i, k]) * normal[w, k]
        lacking *= (1.0 + restitution[w]) * (0.5 * time[p] ** 2 / h)
        for k in range(v.shape[1]):
            v[i, k] -= lacking * normal[w, k]
