"""The contact of two spheres on straight paths: its time, and its impulse. Scalars and arrays only.

A particle's path within a drift of length h is made of *legs*: from (x, v) at the leg's start s, straight on, until a
contact starts the next leg. `axes` is a tuple with one entry an axis; only its length is used, which makes the dimension a
constant of the compiled loop. `length` holds the box length of periodic axes and 0 for the others. In every function i
is the partner with the lower id, so that all who compute a contact compute the same bits.
"""

from math import inf, sqrt

import numpy as np
from numba import njit

NOBODY = -(2**62)  # "last met" before the first contact of a drift; partners are ids >= 0, walls -1, -2, ...
NEVER = inf
PRESSED, CROWD = 1, 2  # values of the field `supported`: pressed onto something by forces; one of many that collapse


def loss(restitution: float | None, damping: float | None) -> tuple[float, float]:
    """(e, keep) of the two kinds of loss: restitution e, or the course's damping alpha with keep = sqrt(1-alpha)."""
    if damping is not None:
        return 1.0, sqrt(1.0 - damping)
    return (1.0 if restitution is None else restitution), 1.0


@njit(cache=True)
def nearest(r, length):
    """The component r of a distance, by the nearest periodic image."""
    if length > 0.0:
        if r > 0.5 * length:
            r -= length
        elif r < -0.5 * length:
            r += length
    return r


@njit(cache=True)
def boxes_between(r, length):
    """What to take from the component r of a distance, to get the nearest periodic image however many boxes away."""
    return length * np.rint(r / length) if abs(r) > 0.5 * length > 0.0 else 0.0


@njit(cache=True, inline="always")
def may_come_near(a, b, r2, diameter, h):
    """False for most pairs: those that move apart, or are clear of each other until h (by margins far above round-off).

    With r, v relative position and velocity: a = v.v, b = r.v, r2 = r.r. Nothing branches: most tests are coin tosses.
    """
    clear = r2 - (diameter * diameter + 1e-9 * r2)
    before = (-b > a * h) & (clear + h * (2.0 * b + a * h) <= 0.0)
    within = (-b <= a * h) & (a * clear <= b * b)
    return (b < 0.0) & (before | within)


@njit(cache=True)
def separation(x, v, s, i, j, k, t, length):
    """Component k of x_i - x_j at time t, by the nearest periodic image."""
    return nearest((x[i, k] + v[i, k] * (t - s[i])) - (x[j, k] + v[j, k] * (t - s[j])), length[k])


@njit(cache=True)
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


@njit(cache=True)
def move_to(axes, x, v, s, i, t):
    """Bring row i along its leg to time t, where a new leg begins."""
    for k in range(len(axes)):
        x[i, k] += v[i, k] * (t - s[i])
    s[i] = t


@njit(cache=True)
def to_take(speed, lead, restitution):
    """What a contact takes from a leg's normal speed (negative: approaching): (1+e) times the speed at the moment of contact.

    On a leg the velocity is that of the middle of the step; at the contact a uniform acceleration g has added `lead` = g.n
    (t - h/2) to it. If that is what is reflected, an elastic contact with something fixed changes no energy, whenever it is:
    over the step the energy changes by (V'-V).((V'+V)/2 + g (t - h/2)) as the leg's velocity changes from V to V'. With the
    leg's own it would, by up to m g h V. A leg so slow that it would have come outwards then, or leave inwards, is reflected
    as it is.
    """
    real = speed + lead
    if lead != 0.0 and (real >= 0.0 or -restitution * real - lead < 0.0):
        real = speed
    return (1.0 + restitution) * real


@njit(cache=True)
def meet(axes, x, v, s, w, i, j, t, restitution, keep, length, g, later):
    """Collide rows i and j at time t; w = 1/m, 0 where fixed. In place on x, v, s; returns the virial -r.dp.

    v_i -= (1+e) (w_i/(w_i+w_j)) (k.v_r) k and the opposite for j, k the unit normal at the instant of contact; then the
    course's damping multiplies both velocities by `keep` = sqrt(1-alpha) (1 with the restitution rule).
    """
    move_to(axes, x, v, s, i, t)
    move_to(axes, x, v, s, j, t)
    falls = (1.0 if w[i] > 0.0 else 0.0) - (
        1.0 if w[j] > 0.0 else 0.0
    )  # only beside a fixed partner does an acceleration of all matter
    r2 = 0.0
    approach = 0.0
    lead = 0.0
    for k in range(len(axes)):
        r = separation(x, v, s, i, j, k, t, length)
        r2 += r * r
        approach += r * (v[i, k] - v[j, k])
        lead += later * falls * g[k] * r
    take = to_take(approach, lead, restitution)
    # coincident centres have no normal, and never get here: their approach r.v is not below zero
    impulse = take / (r2 * (w[i] + w[j]))
    for k in range(len(axes)):
        r = separation(x, v, s, i, j, k, t, length)
        v[i, k] = keep * (v[i, k] - impulse * w[i] * r)
        v[j, k] = keep * (v[j, k] + impulse * w[j] * r)
    return -take / (w[i] + w[j])
