"""Which contacts are slow, so that they are kept: see `operator`. Plain arrays.

`push` (d,) of a row is the speed that forces give it in a step, times SLOW. What *presses* a contact is a speed of the same
kind, and belongs to the direction of its normal n: forces and all other contacts together, if they press it; and the part of
what contacts of its partners bear that lies along n. That of a partner is n S n with its stress S, the sum of borne n' n'
over its contacts n'. A contact is slow below the speed that presses it, or HELD times that between those who are held. So a
ball that rolls along a floor meets another one, or a wall, at any speed: the floor does not bear along that normal.
"""

from math import inf, sqrt

import numpy as np

from particles_mpi.contacts.persistent.solver import give, relative, sweep
from particles_mpi.kernels.geometry import nearest
from particles_mpi.kernels.jit import kernel, lean_inner
from particles_mpi.kernels.markers import CROWD

SLOW = 2.0  # times what forces do in a step: a bounce that is over in about two steps
HELD = 5.0  # times as fast may it be among those that are held, who would rattle between one another
MARGIN = 1e-3  # of the widest slow gap: closer nothing gets, so that round-off makes no contact
SWEEPS = 4  # from what contacts bore before to what they bear now


@lean_inner
def wall_push(x, v, push, radius, i, w, point, normal):
    """Of row i, which has the given push, at wall w: (push onto it, all of the push, approach, speed, gap)."""
    pressed, push2, closing, fast2, distance = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(x.shape[1]):
        fast2 += v[i, k] * v[i, k]
        pressed -= push[k] * normal[w, k]
        push2 += push[k] * push[k]
        closing -= v[i, k] * normal[w, k]
        distance += (x[i, k] - point[w, k]) * normal[w, k]
    return pressed, sqrt(push2), closing, sqrt(fast2), distance - radius[i]


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
        if not here and len(point):
            fast2, clear = 0.0, not oblique
            for k in range(d):
                push[k] = SLOW * h * a[i, k]
                fast2 += push[k] * push[k]
            gap = radius[i] + sqrt(fast2) * h
            for k in range(d):
                clear &= (x[i, k] >= lower[k] + gap) & (x[i, k] <= upper[k] - gap)
            if not clear:
                for wall in range(len(point)):
                    pressed, _, closing, _, gap = wall_push(x, v, push, radius, i, wall, point, normal)
                    here |= pressed > 0.0 and gap <= pressed * h and abs(closing) <= pressed
        if here:
            rows[found] = i
            found += 1
    return rows[:found]


@kernel
def within(x, radius, a, h, low, high, known):
    """Rows whose spheres, with their widest slow gap, touch the box [low, high], but for the `known` (ascending)."""
    rows, found, passed = np.empty(len(x), np.int64), 0, 0
    for i in range(len(x)):
        if passed < len(known) and known[passed] == i:
            passed += 1
            continue
        a2, inside = 0.0, True
        for k in range(x.shape[1]):
            a2 += a[i, k] * a[i, k]
        wide = radius[i] + HELD * SLOW * h * h * sqrt(a2)
        for k in range(x.shape[1]):
            inside &= (x[i, k] + wide >= low[k]) & (x[i, k] - wide <= high[k])
        if inside:
            rows[found] = i
            found += 1
    return rows[:found]


@kernel
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


@kernel
def contacts(x, v, push, radius, w, crowd, first, second, h, length, point, normal):
    """All contacts that may be slow, or that are among a crowd: (rows a and b, or -1 - wall; normals towards a; and so on).

    The rest: gap, shares of a and b, inertia, `widest` (the larger push) and approach; `crowd` tells which are kept at any
    speed. In the order of rows with walls, then of pairs.
    """
    d = x.shape[1]
    most = len(first) + len(x) * len(point)
    a, b = np.empty(most, np.int64), np.empty(most, np.int64)
    n, gaps, share, widest = np.empty((most, d)), np.empty(most), np.empty((most, 2)), np.empty(most)
    inertia, approach, any_speed = np.empty(most), np.empty(most), np.empty(most, np.bool_)
    made = 0
    for i in range(len(x)):
        for wall in range(len(point)):
            _, wide, closing, fast, gap = wall_push(x, v, push[i], radius, i, wall, point, normal)
            if w[i] > 0.0 and wide > 0.0 and gap <= max(HELD * wide, fast * crowd[i]) * h:
                a[made], b[made], widest[made], gaps[made], approach[made] = i, -1 - wall, wide, gap, closing
                for k in range(d):
                    n[made, k] = normal[wall, k]
                share[made, 0], share[made, 1], inertia[made] = 1.0, 0.0, 1.0 / w[i]
                any_speed[made] = crowd[i]
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
        closing, fast_i, fast_j = 0.0, 0.0, 0.0
        for k in range(d):
            n[made, k] /= distance
            closing -= (v[i, k] - v[j, k]) * n[made, k]
            fast_i += v[i, k] * v[i, k]
            fast_j += v[j, k] * v[j, k]
        gap, wide = distance - radius[i] - radius[j], sqrt(max(of_i, of_j))
        fast = (sqrt(fast_i) + sqrt(fast_j)) * (crowd[i] or crowd[j])
        if wide > 0.0 and gap <= max(HELD * wide, fast) * h:
            a[made], b[made], widest[made], gaps[made], approach[made] = i, j, wide, gap, closing
            inertia[made] = 1.0 / (w[i] + w[j])
            share[made, 0], share[made, 1] = w[i] * inertia[made], w[j] * inertia[made]
            any_speed[made] = crowd[i] or crowd[j]
            made += 1
    of = slice(0, made)
    return a[of], b[of], n[of], gaps[of], share[of], inertia[of], widest[of], approach[of], any_speed[of]


@kernel
def bear(v, a, b, normal, may_close, share, borne):
    """What contacts bear under pushes v (n, d), by a few sweeps from what they bore; both in place."""
    for c in range(len(a)):
        give(v, a[c], b[c], normal, share, c, borne[c])
    for _ in range(SWEEPS):
        sweep(v, a, b, normal, may_close, share, borne)
    return borne


@kernel
def pressing(push, a, b, normal, share, borne):
    """The speed that presses each contact, of rows with pushes (n, d) whose contacts bear `borne`."""
    d = push.shape[1]
    left, stress = push.copy(), np.zeros((len(push), d, d))
    for c in range(len(a)):
        give(left, a[c], b[c], normal, share, c, borne[c])
        for k in range(d):
            for m in range(d):
                part = borne[c] * normal[c, k] * normal[c, m]
                stress[a[c], k, m] += share[c, 0] * part
                if b[c] >= 0:
                    stress[b[c], k, m] += share[c, 1] * part
    speeds = np.empty(len(a))
    for c in range(len(a)):
        along = 0.0
        for k in range(d):
            for m in range(d):
                both = stress[a[c], k, m] + (stress[b[c], k, m] if b[c] >= 0 else 0.0)
                along += normal[c, k] * normal[c, m] * both
        others = relative(left, a[c], b[c], normal, c) - borne[c]
        speeds[c] = max(abs(others), along)
    return speeds


@kernel
def slow(pressed, held, widest, gap, closing, crowd, h):
    """Which contacts are slow: (their indices, at which speed each may close, below which speed it is slow)."""
    of, may_close, speeds = np.empty(len(gap), np.int64), np.empty(len(gap)), np.empty(len(gap))
    found = 0
    for c in range(len(gap)):
        most = HELD * widest[c]
        speed = min((HELD if held[c] else 1.0) * pressed[c], most)
        if crowd[c] or (speed > 0.0 and gap[c] <= speed * h and abs(closing[c]) <= speed):
            of[found], speeds[found] = c, most if crowd[c] else speed
            may_close[found] = max(gap[c] - MARGIN * most * h, 0.0) / h
            found += 1
    return of[:found], may_close[:found], speeds[:found]


@kernel
def spread(x, wide, first, second, length, supported):
    """Who touches one of a crowd, widths taken together, belongs to it. `first`, `second`: pairs of rows that may touch."""
    touch = np.empty(len(first), np.bool_)
    for p in range(len(first)):
        r2 = 0.0
        for k in range(x.shape[1]):
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
