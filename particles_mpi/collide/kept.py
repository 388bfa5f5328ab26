"""Which contacts are slow, so that they are kept, and who has one: see `rest`. Plain arrays.

`push` (d,) of a row is the speed that forces give it in a step, times SLOW. A contact is slow below the speed at which
pushes press the partners together, or HELD times the larger of them if one of the partners is held by somebody else.
"""

from math import sqrt

import numpy as np
from numba import njit

from particles_mpi.collide.contact import CROWD, nearest
from particles_mpi.collide.planes import wall_distance

SLOW = 2.0  # times what forces do in a step: a bounce that is over in about two steps
HELD = 5.0  # times as fast may it be among those that are held, who would rattle between one another
MARGIN = 1e-3  # of the widest slow gap: closer nothing gets, so that round-off makes no contact


@njit(cache=True)
def slow_speed(pressed, widest, held, closing, fastest, gap, h):
    """The speed below which a contact is slow, 0 if this one is not kept.

    `widest`: the larger push, `pressed`: along the normal; `fastest`: the sum of the partners' speeds.
    """
    speed = HELD * widest if held else max(pressed, 0.0)
    if held == CROWD:
        return speed if gap <= max(speed, fastest) * h else 0.0
    return speed if gap <= speed * h and abs(closing) <= speed else 0.0


@njit(cache=True)
def slow_wall(axes, x, v, push, radius, held, i, h, w, point, normal):
    """(slow speed, gap) of row i, which has the given push, at wall w; a speed of 0 if it is no slow contact."""
    pressed, all_, closing, fast2 = 0.0, 0.0, 0.0, 0.0
    for k in range(len(axes)):
        fast2 += v[i, k] * v[i, k]
        pressed -= push[k] * normal[w, k]
        all_ += push[k] * push[k]
        closing -= v[i, k] * normal[w, k]
    gap = wall_distance(axes, x, i, w, point, normal) - radius[i]
    return slow_speed(pressed, sqrt(all_), held, closing, sqrt(fast2), gap, h), gap


@njit(cache=True)
def near_walls(axes, x, v, a, radius, fixed, supported, h, lower, upper, oblique, point, normal):
    """Rows that are fixed or supported, or have a slow contact with a wall.

    `lower`, `upper`: faces beyond which the first walls are.
    """
    rows, found = np.empty(len(x), np.int64), 0
    push = np.empty(len(axes))
    for i in range(len(x)):
        here = supported[i] != 0 or fixed[i] != 0
        if not here and not fixed[i] and len(point):
            fast2, clear = 0.0, not oblique
            for k in range(len(axes)):
                push[k] = SLOW * h * a[i, k]
                fast2 += push[k] * push[k]
            gap = radius[i] + sqrt(fast2) * h
            for k in range(len(axes)):
                clear &= (x[i, k] >= lower[k] + gap) & (x[i, k] <= upper[k] - gap)
            if not clear:
                for wall in range(len(point)):
                    speed, _ = slow_wall(axes, x, v, push, radius, 0, i, h, wall, point, normal)
                    here |= speed > 0.0
        if here:
            rows[found] = i
            found += 1
    return rows[:found]


@njit(cache=True)
def within(axes, x, radius, a, h, low, high, known):
    """Rows whose spheres, with their widest slow gap, touch the box [low, high], but for the `known` (ascending)."""
    rows, found, passed = np.empty(len(x), np.int64), 0, 0
    for i in range(len(x)):
        if passed < len(known) and known[passed] == i:
            passed += 1
            continue
        a2, inside = 0.0, True
        for k in range(len(axes)):
            a2 += a[i, k] * a[i, k]
        wide = radius[i] + HELD * SLOW * h * h * sqrt(a2)
        for k in range(len(axes)):
            inside &= (x[i, k] + wide >= low[k]) & (x[i, k] - wide <= high[k])
        if inside:
            rows[found] = i
            found += 1
    return rows[:found]


@njit(cache=True)
def close_by_test(x, wide, w, length):
    """Pairs (first < second) of few rows that come nearer than their widths, not both with w = 0."""
    most = len(x) * (len(x) - 1) // 2
    first, second = np.empty(most, np.int32), np.empty(most, np.int32)
    found = 0
    for j in range(len(x)):
        for i in range(j):
            r2 = 0.0
            for k in range(x.shape[1]):
                r2 += nearest(x[i, k] - x[j, k], length[k]) ** 2
            if r2 <= (wide[i] + wide[j]) ** 2 and w[i] + w[j] > 0.0:
                first[found], second[found] = i, j
                found += 1
    return first[:found], second[:found]


@njit(cache=True)
def contacts(axes, x, v, push, radius, w, held, first, second, h, length, point, normal):
    """All slow contacts: rows a, b (or -1 - wall), normals towards a, how fast gaps may close, shares of a and b, and so on."""
    d = len(axes)
    most = len(first) + len(x) * len(point)
    a, b = np.empty(most, np.int64), np.empty(most, np.int64)
    n, may_close, share, speeds = np.empty((most, d)), np.empty(most), np.empty((most, 2)), np.empty(most)
    inertia = np.empty(most)
    made = 0
    for i in range(len(x)):
        for wall in range(len(point)):
            speed, gap = slow_wall(axes, x, v, push[i], radius, held[i], i, h, wall, point, normal)
            if speed > 0.0 and w[i] > 0.0:
                a[made], b[made], speeds[made] = i, -1 - wall, speed
                n[made] = normal[wall]
                may_close[made] = max(gap - MARGIN * speed * h, 0.0) / h
                share[made, 0], share[made, 1], inertia[made] = 1.0, 0.0, 1.0 / w[i]
                made += 1
    for p in range(len(first)):
        i, j = first[p], second[p]
        r2, of_i, of_j = 0.0, 0.0, 0.0
        for k in range(d):
            n[made, k] = nearest(x[i, k] - x[j, k], length[k])
            r2 += n[made, k] * n[made, k]
            of_i += push[i, k] * push[i, k]
            of_j += push[j, k] * push[j, k]
        distance = sqrt(r2)
        if not distance > 0.0 or w[i] + w[j] == 0.0:
            continue
        pressed, closing, fast_i, fast_j = 0.0, 0.0, 0.0, 0.0
        for k in range(d):
            n[made, k] /= distance
            pressed -= (push[i, k] - push[j, k]) * n[made, k]
            closing -= (v[i, k] - v[j, k]) * n[made, k]
            fast_i += v[i, k] * v[i, k]
            fast_j += v[j, k] * v[j, k]
        gap = distance - radius[i] - radius[j]
        speed = slow_speed(pressed, sqrt(max(of_i, of_j)), max(held[i], held[j]), closing, sqrt(fast_i) + sqrt(fast_j), gap, h)
        if speed > 0.0:
            a[made], b[made], speeds[made] = i, j, speed
            may_close[made] = max(gap - MARGIN * speed * h, 0.0) / h
            inertia[made] = 1.0 / (w[i] + w[j])
            share[made, 0], share[made, 1] = w[i] * inertia[made], w[j] * inertia[made]
            made += 1
    return a[:made], b[:made], n[:made], may_close[:made], share[:made], inertia[:made], speeds[:made]


@njit(cache=True)
def spread(axes, x, wide, first, second, length, supported):
    """Who touches one of a crowd, widths taken together, belongs to it. `first`, `second`: pairs of rows that may touch."""
    touch = np.empty(len(first), np.bool_)
    for p in range(len(first)):
        r2 = 0.0
        for k in range(len(axes)):
            r2 += nearest(x[first[p], k] - x[second[p], k], length[k]) ** 2
        touch[p] = r2 <= (wide[first[p]] + wide[second[p]]) ** 2
    more = True
    while more:
        more = False
        for p in range(len(first)):
            i, j = first[p], second[p]
            if touch[p] and (supported[i] == CROWD) != (supported[j] == CROWD):
                supported[i] = supported[j] = CROWD
                more = True
