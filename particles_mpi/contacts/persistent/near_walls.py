"""Rows near walls, whose contacts with these may last."""

from math import inf, sqrt

import numpy as np

from particles_mpi.contacts.persistent.detection import SLOW
from particles_mpi.kernels.jit import in_place, kernel


@in_place
def wall_push(x, v, push, radius, i, w, point, normal):
    """Of row i, which has the given push, at wall w: (push onto it, approach, gap)."""
    pressed, closing, distance = 0.0, 0.0, 0.0
    for k in range(x.shape[1]):
        pressed -= push[k] * normal[w, k]
        closing -= v[i, k] * normal[w, k]
        distance += (x[i, k] - point[w, k]) * normal[w, k]
    return pressed, closing, distance - radius[i]


@in_place
def has_slow_wall(x, v, a, radius, i, h, push, point, normal):
    """Has row i a slow contact with a wall, which forces press? push (d,): room for its push."""
    slow = False
    for k in range(x.shape[1]):
        push[k] = SLOW * h * a[i, k]
    for wall in range(len(point)):
        pressed, closing, gap = wall_push(x, v, push, radius, i, wall, point, normal)
        slow |= pressed > 0.0 and gap <= pressed * h and abs(closing) <= pressed
    return slow


@kernel
def near_walls(x, v, a, radius, fixed, supported, h, lower, upper, oblique, point, normal):
    """Rows that are fixed or supported, or have a slow contact with a wall.

    `lower`, `upper`: faces beyond which the first walls are.
    """
    d = x.shape[1]
    rows, found = np.empty(len(x), np.int64), 0
    push, low, high = np.empty(d), np.empty(d), np.empty(d)
    most = 0.0
    for i in range(len(x)):
        a2 = 0.0
        for k in range(d):
            a2 += a[i, k] * a[i, k]
        most = max(most, a2)
    for k in range(d):  # within these no sphere is near a face, whatever its push: most rows need no closer look
        far = 1.000001 * SLOW * h * h * sqrt(most)
        low[k] = lower[k] + far + 1e-12 * max(lower[k], -lower[k]) if lower[k] > -inf else -inf
        high[k] = upper[k] - far - 1e-12 * max(upper[k], -upper[k]) if upper[k] < inf else inf
    for i in range(len(x)):
        here = (supported[i] != 0) | (fixed[i] != 0)
        inside = not oblique
        for k in range(d):
            inside &= (x[i, k] >= low[k] + radius[i]) & (x[i, k] <= high[k] - radius[i])
        if inside & (not here):
            continue
        if here or has_slow_wall(x, v, a, radius, i, h, push, point, normal):
            rows[found] = i
            found += 1
    return rows[:found]


@kernel
def near_walls_among(rows, x, v, a, radius, supported, h, point, normal):
    """Those of `rows` that are supported, or have a slow contact with a wall."""
    chosen, found, push = np.empty(len(rows), np.int64), 0, np.empty(x.shape[1])
    for i in rows:
        chosen[found] = i
        found += supported[i] != 0 or has_slow_wall(x, v, a, radius, i, h, push, point, normal)
    return chosen[:found]
