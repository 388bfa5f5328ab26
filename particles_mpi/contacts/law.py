"""The contact of two spheres on straight paths: its time, and its impulse. Scalars and arrays only.

A particle's path within a drift of length h is made of *legs*: from (x, v) at the leg's start s, straight on, until a
contact starts the next leg. `axes` is a tuple with one entry an axis; only its length is used, which makes the dimension a
constant of the compiled loop. `length` holds the box length of periodic axes and 0 for the others. In every function i
is the partner with the lower id, so that all who compute a contact compute the same bits.
"""

from math import sqrt

import numpy as np

from particles_mpi.contacts.velocity_flow import change_of, row_of
from particles_mpi.kernels.geometry import nearest
from particles_mpi.kernels.jit import inner, lean, lean_inner
from particles_mpi.kernels.markers import NEVER
from particles_mpi.kernels.motion import move_to


def loss(restitution: float | None, damping: float | None) -> tuple[float, float]:
    """(e, keep) of the two kinds of loss: restitution e, or the course's damping alpha with keep = sqrt(1-alpha)."""
    if damping is not None:
        return 1.0, sqrt(1.0 - damping)
    return (1.0 if restitution is None else restitution), 1.0


@inner(inline="always")
def may_come_near(a, b, r2, diameter, h):
    """False for most pairs: those that move apart, or are clear of each other until h (by margins far above round-off).

    With r, v relative position and velocity: a = v.v, b = r.v, r2 = r.r. Nothing branches: most tests are coin tosses.
    """
    clear = r2 - (diameter * diameter + 1e-9 * r2)
    before = (-b > a * h) & (clear + h * (2.0 * b + a * h) <= 0.0)
    within = (-b <= a * h) & (a * clear <= b * b)
    return (b < 0.0) & (before | within)


@lean_inner
def separation(x, v, s, i, j, k, t, length):
    """Component k of x_i - x_j at time t, by the nearest periodic image."""
    return nearest((x[i, k] + v[i, k] * (t - s[i])) - (x[j, k] + v[j, k] * (t - s[j])), length[k])


@lean
def contact_time(axes, x, v, s, i, j, diameter, h, length):
    """Time in [max(s_i, s_j), h] at which the legs of i and j first touch, or NEVER.

    With r, v relative position and velocity, D = `diameter` = R_i + R_j: a = v.v, b = r.v, c = (|r|-D)(|r|+D) and
    disc = a D^2 - |r x v|^2 the time is c/(-b + sqrt(disc)), free of the cancellation of b^2 - a c, which misses grazing
    contacts of far partners. Overlapping and approaching partners touch at once.
    """
    start = max(s[i], s[j])
    a = 0.0
    b = 0.0
    r2 = 0.0
    for k in range(len(axes)):
        r = separation(x, v, s, i, j, k, start, length)
        u = v[i, k] - v[j, k]
        a += u * u
        b += r * u
        r2 += r * r
    if not b < 0.0:
        return NEVER
    # Partners that already move together (e = 0) differ by round-off: that is no approach.
    own = 0.0
    for k in range(len(axes)):
        own += v[i, k] * v[i, k] + v[j, k] * v[j, k]
    if b * b <= 1e-28 * r2 * own:
        return NEVER
    distance = sqrt(r2)
    gap = distance - diameter
    if gap <= 0.0:
        return start
    disc = a * diameter * diameter
    for k in range(len(axes)):
        for m in range(k):
            cross = separation(x, v, s, i, j, k, start, length) * (v[i, m] - v[j, m]) - separation(
                x, v, s, i, j, m, start, length
            ) * (v[i, k] - v[j, k])
            disc -= cross * cross
    if disc < 0.0:
        return NEVER
    t = start + gap * (distance + diameter) / (sqrt(disc) - b)
    return t if t <= h else NEVER


@inner(inline="always")
def exchange(axes, v, column, r, i, j, own, other, t, restitution, keep, rates):
    """The law of a contact at time t: changes the velocities, in v from `column` on, of rows i and j, r = x_i - x_j (d,) apart.

    v_i -= (1+e) (w_i/(w_i+w_j)) (k.v_r) k and the opposite for j, k = r/|r|, w = 1/m = `own` and `other`, 0 where fixed; then
    the course's damping multiplies both velocities by `keep` = sqrt(1-alpha) (1 with the restitution rule). Returns the
    part of r.(v_i - v_j) that the contact took. `walls.bounce` is the same law for a wall.
    """
    approach = 0.0
    r2 = 0.0
    for k in range(len(axes)):
        r2 += r[k] * r[k]
        approach += r[k] * (v[i, column + k] - v[j, column + k])
    if len(rates.a) > 0:
        take = exchange_at_contact(v, column, r, r2, i, j, own, other, t - rates.middle, restitution, keep, rates)
        if take != 0.0:
            return take
    take = (1.0 + restitution) * approach
    impulse = take / (r2 * (own + other))  # coincident centres have no normal, and never get here: they do not approach
    for k in range(len(axes)):
        v[i, column + k] = keep * (v[i, column + k] - impulse * own * r[k])
        v[j, column + k] = keep * (v[j, column + k] + impulse * other * r[k])
    return take


@lean_inner
def exchange_at_contact(v, column, r, r2, i, j, own, other, tau, restitution, keep, rates):
    """`exchange` of the velocities at the moment of contact, a time tau after the middle of the step: see `velocity_flow`.

    An elastic contact under constant forces then changes no energy, wherever in the step it is: over the step the energy
    changes by the sum of m (V'-V).((V'+V)/2 + a tau) as legs' velocities change from V to V'. Returns 0, and changes
    nothing, for legs so slow that they would have come outwards at the contact, or would leave it inwards.
    """
    a, at, to = rates.a, row_of(i, rates), row_of(j, rates)
    v2_i, v2_j = 0.0, 0.0
    for k in range(len(r)):
        v2_i += v[i, column + k] * v[i, column + k]
        v2_j += v[j, column + k] * v[j, column + k]
    decay_i, push_i = change_of(i, v2_i, own, tau, rates)
    decay_j, push_j = change_of(j, v2_j, other, tau, rates)
    real, lead = 0.0, 0.0
    for k in range(len(r)):
        real += r[k] * (decay_i * v[i, column + k] - decay_j * v[j, column + k])
        lead += (push_i * a[at, k] - push_j * a[to, k]) * r[k]
    real += lead
    if not real < 0.0:
        return 0.0
    take = (1.0 + restitution) * real
    impulse = take / (r2 * (own + other))
    v2_i, v2_j = 0.0, 0.0
    for k in range(len(r)):
        v2_i += (keep * (decay_i * v[i, column + k] + push_i * a[at, k] - impulse * own * r[k])) ** 2
        v2_j += (keep * (decay_j * v[j, column + k] + push_j * a[to, k] + impulse * other * r[k])) ** 2
    back_i, pull_i = change_of(i, v2_i, own, -tau, rates)
    back_j, pull_j = change_of(j, v2_j, other, -tau, rates)
    back_i, back_j = keep * back_i, keep * back_j
    left_i, left_j = back_i * push_i + pull_i, back_j * push_j + pull_j  # 0 without a loss
    leaving = 0.0
    for k in range(len(r)):
        after_i = back_i * decay_i * v[i, column + k] - back_i * (impulse * own * r[k]) + left_i * a[at, k]
        after_j = back_j * decay_j * v[j, column + k] + back_j * (impulse * other * r[k]) + left_j * a[to, k]
        leaving += r[k] * (after_i - after_j)
    if leaving < 0.0 and lead != 0.0:
        return 0.0
    for k in range(len(r)):
        v[i, column + k] = back_i * decay_i * v[i, column + k] - back_i * (impulse * own * r[k]) + left_i * a[at, k]
        v[j, column + k] = back_j * decay_j * v[j, column + k] + back_j * (impulse * other * r[k]) + left_j * a[to, k]
    return take


@lean_inner
def meet(axes, x, v, s, w, i, j, t, restitution, keep, length, rates, r):
    """Collide rows i and j at time t; w = 1/m, 0 where fixed. In place on x, v, s; r (d,) is for scribbling.

    Returns the virial -r.dp. `event_loop.collide` is the same for the rows of mode event.
    """
    move_to(axes, x, v, s, i, t)
    move_to(axes, x, v, s, j, t)
    for k in range(len(axes)):
        r[k] = separation(x, v, s, i, j, k, t, length)
    return -exchange(axes, v, np.int64(0), r, i, j, w[i], w[j], t, restitution, keep, rates) / (w[i] + w[j])
