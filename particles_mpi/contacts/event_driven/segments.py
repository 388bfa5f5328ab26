"""The contact of two rows on their straight segments: when they touch, and how their velocities change.

`touch_time` and `collide` are copies of `law.contact_time` and `law.collide_pair` for rows in which the whole path of a particle
lies together, so that one line of memory is read instead of four. `tests/unit/test_contact_law.py` checks that bits are the same.
"""

from math import sqrt
from typing import Any

import numpy as np

from particles_mpi.contacts.law import TOGETHER2, apply_impulse, may_come_near
from particles_mpi.contacts.rough import FRICTION, PAIRS, strike_pair
from particles_mpi.kernels.geometry import image_shift, some_nearest
from particles_mpi.kernels.jit import in_place, inner, lean_inner, screening
from particles_mpi.kernels.lanes import columns_of, eight
from particles_mpi.kernels.markers import NEVER, RADIUS, START
from particles_mpi.neighbours.verlet_kernels import INVERSE_MASS

ROUND_OFF = 64.0 * float(np.finfo(float).eps)  # of a coordinate, at most
columns_of_segments: Any = columns_of(lambda d: 2 * d + RADIUS + 1)


@screening
def may_touch(axes, segment, i, others, place, now, until, length, boxes_per_length):
    """Return bits: bit p is 0 if row i and row p of eight `others` move apart from now on, or do not touch before `until`.

    Margins are above round-off. `place` (d,): where row i is now; others: their `columns_of_segments`.
    """
    d = len(axes)
    a, b, r2 = eight(0.0), eight(0.0), eight(0.0)
    passed = now - others[2 * d + START]
    for k in range(d):
        r = some_nearest(place[k] - (others[k] + others[d + k] * passed), length[k], boxes_per_length[k])
        u = segment[i, d + k] - others[d + k]
        a += u * u
        b += r * u
        r2 += r * r
    likely = may_come_near(a, b, r2, segment[i, 2 * d + RADIUS] + others[2 * d + RADIUS], until - now)
    if d == 1:  # where points meet on a line, round-off decides whether they move apart, and whether that is before `until`
        together2 = 12.0 * ROUND_OFF**2 * (segment[i, 0] ** 2 + place[0] ** 2 + others[0] * others[0])
        ahead = until - now
        at_end2 = r2 + ahead * (2.0 * b + ahead * a)  # the square of the distance then, but for round-off of its parts
        likely = likely | (r2 <= together2) | (at_end2 <= together2 + 1e-14 * (r2 + ahead * ahead * a))
    return likely


@inner(inline="always")
def round_off(segment, i, j):
    """Return the round-off, at most, of the places of rows i and j on a line. Rows that touch at less than that are points."""
    return ROUND_OFF * (abs(segment[i, 0]) + abs(segment[j, 0]))


@inner(inline="always")
def touch_time(axes, segment, i, j, now, latest, h, length, r, u):
    """Time at which the segments of i and j first touch, up to `latest`, or NEVER: the root of `law.contact_time`.

    `now`, at or after both starts, only tells which periodic images are meant. Points that are nearer than round-off at h, where
    the drift ends, touch there: in the next drift nothing says which one is on which side. r, u (d,) are scratch: afterwards r is
    x_i - x_j at the later one of the two starts, and u is v_i - v_j.
    """
    d = len(axes)
    start = max(segment[i, 2 * d + START], segment[j, 2 * d + START])
    a = 0.0
    b = 0.0
    r2 = 0.0
    own = 0.0
    for k in range(d):
        u[k] = segment[i, d + k] - segment[j, d + k]
        r[k] = (segment[i, k] + segment[i, d + k] * (start - segment[i, 2 * d + START])) - (
            segment[j, k] + segment[j, d + k] * (start - segment[j, 2 * d + START])
        )
        r[k] -= image_shift(r[k] + u[k] * (now - start), length[k])
        a += u[k] * u[k]
        b += r[k] * u[k]
        r2 += r[k] * r[k]
        own += segment[i, d + k] * segment[i, d + k] + segment[j, d + k] * segment[j, d + k]
    if not b < 0.0 or b * b <= TOGETHER2 * r2 * own:  # together but for round-off is no approach
        return NEVER
    diameter = segment[i, 2 * d + RADIUS] + segment[j, 2 * d + RADIUS]
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
    if d == 1 and t > h and max(diameter, (t - h) * abs(u[0])) <= round_off(segment, i, j):
        t = h
    return t if t <= latest else NEVER


@lean_inner
def is_nearest_image(d, r, length):
    """Is r the nearest periodic image of a distance? Two rows whose last contact was with each other touched at that one."""
    nearest = True
    for k in range(d):
        nearest &= length[k] == 0.0 or abs(r[k]) <= 0.5 * length[k]
    return nearest


@lean_inner
def move_to(axes, segment, i, t):
    """Begin a new segment of row i at time t, where the old one gets then. The same as `kernels.motion.move_to`."""
    d = len(axes)
    for k in range(d):
        segment[i, k] += segment[i, d + k] * (t - segment[i, 2 * d + START])
    segment[i, 2 * d + START] = t


@in_place
def collide(axes, segment, reference, i, j, t, loss, length, rates, rough, smooth, r):
    """Collide rows i and j at time t: `law.collide_pair` on segments, with its virial; r (d,) is scratch.

    `smooth`: treat this contact as smooth, even if spheres are rough.

    On a line even points, which have no distance when they touch, have a normal: there, the impulse is that of r = 1. Points are
    at the same place then, to the bit: their order on the line must not be lost by round-off.
    """
    d = len(axes)
    restitution, velocity_factor = loss
    own, other = reference[i, d + INVERSE_MASS], reference[j, d + INVERSE_MASS]
    move_to(axes, segment, i, t)
    move_to(axes, segment, j, t)
    for k in range(d):
        r[k] = segment[i, k] - segment[j, k]
        r[k] -= image_shift(r[k], length[k])
    if d == 1:
        if segment[i, 2 * d + RADIUS] + segment[j, 2 * d + RADIUS] <= round_off(segment, i, j):
            shift = image_shift(segment[i, 0] - segment[j, 0], length[0])
            if other > 0.0:
                segment[j, 0] = segment[i, 0] - shift
            if own > 0.0:  # across a border the place that is further out is the coarser number
                segment[i, 0] = segment[j, 0] + shift
            r[0] = 0.0
        approach = r[0] * (segment[i, d] - segment[j, d])
        r[0] = 1.0 if segment[i, d] < segment[j, d] else -1.0
        nearing = r[0] * (segment[i, d] - segment[j, d])
        take = apply_impulse(axes, segment, np.int64(d), r, i, j, own, other, t, restitution, velocity_factor, rates)
        return -((1.0 + restitution if len(rates.a) == 0 else take / nearing) * approach) / (own + other)
    if rough.law[PAIRS, FRICTION] > 0.0 and not smooth:
        both = own, other, segment[i, 2 * d + RADIUS], segment[j, 2 * d + RADIUS]
        change = strike_pair(axes, segment, np.int64(d), rough, r, i, j, both, t, restitution, rates)
        return -change / (own + other)
    return -apply_impulse(axes, segment, np.int64(d), r, i, j, own, other, t, restitution, velocity_factor, rates) / (own + other)
