"""The contact of two spheres on straight paths: its time, and its impulse. Scalars and arrays only.

A particle's path within a drift of length h is made of *segments*: from (x, v) at the segment's `start`, straight on, until a
contact starts the next one. `axes` is a tuple with one entry an axis; only its length is used, which makes the dimension a
constant of the compiled loop. `length` holds the box length of periodic axes and 0 for the others. In every function i
is the partner with the lower id, so that all who compute a contact compute the same bits.
"""

from math import sqrt
from typing import NamedTuple

import numpy as np

from particles_mpi.contacts.rough import FRICTION, PAIRS, strike_pair
from particles_mpi.contacts.velocity_flow import change_of, row_of
from particles_mpi.kernels.geometry import nearest
from particles_mpi.kernels.jit import in_place, inner, lean_in_place, lean_inner
from particles_mpi.kernels.markers import NEVER
from particles_mpi.kernels.motion import move_to

TOGETHER2 = 1e-28  # of the squares of distance and speeds: that of their product where spheres move together but for round-off


class Loss(NamedTuple):
    """The losses of a contact: `restitution` e acts on the normal velocity, then `velocity_factor` on the whole velocity."""

    restitution: float
    velocity_factor: float


def loss(restitution: float | None, damping: float | None) -> Loss:
    """Return the loss of a contact by restitution e, or by the course's damping alpha, whose factor is sqrt(1-alpha)."""
    if damping is not None:
        return Loss(1.0, sqrt(1.0 - damping))
    return Loss(1.0 if restitution is None else restitution, 1.0)


@inner(inline="always")
def may_come_near(a, b, r2, diameter, h):
    """Return False for most pairs: those that move apart, or do not touch before h (by margins far above round-off).

    With r, v relative position and velocity: a = v.v, b = r.v, r2 = r.r. There is no branch, because most tests are coin tosses.
    """
    clear = r2 - (diameter * diameter + 1e-9 * r2)
    before = (-b > a * h) & (clear + h * (2.0 * b + a * h) <= 0.0)
    within = (-b <= a * h) & (a * clear <= b * b)
    return (b < 0.0) & (before | within)


@in_place
def separation(x, v, start, i, j, k, t, length):
    """Component k of x_i - x_j at time t, by the nearest periodic image."""
    return nearest((x[i, k] + v[i, k] * (t - start[i])) - (x[j, k] + v[j, k] * (t - start[j])), length[k])


@lean_in_place
def contact_time(axes, x, v, start, i, j, diameter, h, length):
    """Time in [max(start_i, start_j), h] at which the segments of i and j first touch, or NEVER.

    With r, v relative position and velocity, D = `diameter` = R_i + R_j: a = v.v, b = r.v, c = (|r|-D)(|r|+D) and
    disc = a D^2 - |r x v|^2 the time is c/(-b + sqrt(disc)), free of the cancellation of b^2 - a c, which misses grazing
    contacts of far partners. Overlapping and approaching partners touch at once. `segments.touch_time` finds the same root.
    """
    begin = max(start[i], start[j])
    a = 0.0
    b = 0.0
    r2 = 0.0
    for k in range(len(axes)):
        r = separation(x, v, start, i, j, k, begin, length)
        u = v[i, k] - v[j, k]
        a += u * u
        b += r * u
        r2 += r * r
    if not b < 0.0:
        return NEVER
    own = 0.0
    for k in range(len(axes)):
        own += v[i, k] * v[i, k] + v[j, k] * v[j, k]
    if b * b <= TOGETHER2 * r2 * own:  # together (e = 0) but for round-off is no approach
        return NEVER
    distance = sqrt(r2)
    gap = distance - diameter
    if gap <= 0.0:
        return begin
    disc = a * diameter * diameter
    for k in range(len(axes)):
        for m in range(k):
            cross = separation(x, v, start, i, j, k, begin, length) * (v[i, m] - v[j, m]) - separation(
                x, v, start, i, j, m, begin, length
            ) * (v[i, k] - v[j, k])
            disc -= cross * cross
    if disc < 0.0:
        return NEVER
    t = begin + gap * (distance + diameter) / (sqrt(disc) - b)
    return t if t <= h else NEVER


@lean_inner
def overlap(r2, one, other):
    """The overlap of two spheres, sqrt(r2) apart, divided by the smaller radius that is not 0; 0 if they do not overlap."""
    if not r2 < (one + other) ** 2:
        return 0.0
    return (one + other - sqrt(r2)) / (min(one, other) if one > 0.0 and other > 0.0 else max(one, other))


@inner(inline="always")
def apply_impulse(axes, v, column, r, i, j, w_i, w_j, t, restitution, velocity_factor, rates):
    """The law of a contact at time t: changes the velocities of rows i and j, which are r = x_i - x_j (d,) apart.

    The velocity of row i is v[i, column:], since the rows of mode event hold more than that. v_i -= (1+e) (w_i/(w_i+w_j))
    (n.u) n and the opposite for j, with n = r/|r|, u = v_i - v_j and w = 1/m, 0 where fixed; then the course's damping
    multiplies both velocities by `velocity_factor` = sqrt(1-alpha) (1 with the restitution rule). Returns (1+e) r.u with the u
    before the impulse: minus the change of r.u by it; 0 where there is no normal. `walls.bounce` is the same law for a wall.
    """
    approach = 0.0
    r2 = 0.0
    for k in range(len(axes)):
        r2 += r[k] * r[k]
        approach += r[k] * (v[i, column + k] - v[j, column + k])
    weight = r2 * (w_i + w_j)
    if weight == 0.0:  # spheres smaller than round-off of their places: there is no normal
        return 0.0
    if len(rates.a) > 0:
        change = apply_impulse_at_contact(v, column, r, r2, i, j, w_i, w_j, t - rates.t_mid, restitution, velocity_factor, rates)
        if change != 0.0:
            return change
    change = (1.0 + restitution) * approach
    impulse = change / weight
    for k in range(len(axes)):
        v[i, column + k] = velocity_factor * (v[i, column + k] - impulse * w_i * r[k])
        v[j, column + k] = velocity_factor * (v[j, column + k] + impulse * w_j * r[k])
    return change


@lean_inner
def apply_impulse_at_contact(v, column, r, r2, i, j, w_i, w_j, tau, restitution, velocity_factor, rates):
    """`apply_impulse` of the velocities at the moment of contact, a time tau after the middle of the step: see `velocity_flow`.

    An elastic contact under constant forces then changes no energy, wherever in the step it is: over the step the energy
    changes by the sum of m (V'-V).((V'+V)/2 + a tau) as the velocities of segments change from V to V'. Returns 0, and
    changes nothing, for partners so slow that they would have moved apart at the contact, or would approach after it.
    """
    a, at, to = rates.a, row_of(i, rates), row_of(j, rates)
    v2_i, v2_j = 0.0, 0.0
    for k in range(len(r)):
        v2_i += v[i, column + k] * v[i, column + k]
        v2_j += v[j, column + k] * v[j, column + k]
    decay_i, force_time_i = change_of(i, v2_i, w_i, tau, rates)
    decay_j, force_time_j = change_of(j, v2_j, w_j, tau, rates)
    approach, acceleration_offset = 0.0, 0.0
    for k in range(len(r)):
        approach += r[k] * (decay_i * v[i, column + k] - decay_j * v[j, column + k])
        acceleration_offset += (force_time_i * a[at, k] - force_time_j * a[to, k]) * r[k]
    approach += acceleration_offset
    if not approach < 0.0:
        return 0.0
    change = (1.0 + restitution) * approach
    impulse = change / (r2 * (w_i + w_j))
    v2_i, v2_j = 0.0, 0.0
    for k in range(len(r)):
        v2_i += (velocity_factor * (decay_i * v[i, column + k] + force_time_i * a[at, k] - impulse * w_i * r[k])) ** 2
        v2_j += (velocity_factor * (decay_j * v[j, column + k] + force_time_j * a[to, k] + impulse * w_j * r[k])) ** 2
    back_i, pull_i = change_of(i, v2_i, w_i, -tau, rates)
    back_j, pull_j = change_of(j, v2_j, w_j, -tau, rates)
    back_i, back_j = velocity_factor * back_i, velocity_factor * back_j
    left_i, left_j = back_i * force_time_i + pull_i, back_j * force_time_j + pull_j  # 0 without a loss
    leaving = 0.0
    for k in range(len(r)):
        after_i = back_i * decay_i * v[i, column + k] - back_i * (impulse * w_i * r[k]) + left_i * a[at, k]
        after_j = back_j * decay_j * v[j, column + k] + back_j * (impulse * w_j * r[k]) + left_j * a[to, k]
        leaving += r[k] * (after_i - after_j)
    if leaving < 0.0 and (acceleration_offset != 0.0 or decay_i != decay_j):  # else it is round-off
        return 0.0
    for k in range(len(r)):
        v[i, column + k] = back_i * decay_i * v[i, column + k] - back_i * (impulse * w_i * r[k]) + left_i * a[at, k]
        v[j, column + k] = back_j * decay_j * v[j, column + k] + back_j * (impulse * w_j * r[k]) + left_j * a[to, k]
    return change


@in_place
def collide_pair(axes, segments, spheres, i, j, t, loss, length, rates, rough, r):
    """Collide rows i and j at time t. In place on the segments, and on spins of rough spheres; r (d,) is overwritten.

    Returns the virial r.J, with r = x_i - x_j and J the impulse on i: positive, for J pushes i away from j. `segments.collide`
    is the same for the rows of mode event.
    """
    x, v, start, _ = segments
    radius, w, _, _ = spheres
    restitution, velocity_factor = loss
    move_to(axes, x, v, start, i, t)
    move_to(axes, x, v, start, j, t)
    for k in range(len(axes)):
        r[k] = separation(x, v, start, i, j, k, t, length)
    column = np.int64(0)
    if rough.law[PAIRS, FRICTION] > 0.0:
        both = w[i], w[j], radius[i], radius[j]
        change = strike_pair(axes, v, column, rough, r, i, j, both, t, restitution, rates)
    else:
        change = apply_impulse(axes, v, column, r, i, j, w[i], w[j], t, restitution, velocity_factor, rates)
    return -change / (w[i] + w[j])
