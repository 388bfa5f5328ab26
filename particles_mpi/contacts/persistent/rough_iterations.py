"""What `iterations` do with the rows of rough spheres: contacts that stick, slide and resist rolling.

The half-edge from row i to its partner j, with the normal n towards i, has the impulse p along n, t across it and a couple c.
With arms a and spins s of both, surfaces slip with the velocity u = v_i - v_j - (a_i s_i + a_j s_j) x n. Coulomb's law holds in
the velocities at the end:

    p >= 0, n.u >= -(what it may close), p = 0 where it closes less;   |t| <= mu p, t opposite to u where it slips;
    |c| <= b p, c opposite to s_i - s_j where it rolls or spins              (b: a length, the resistance to rolling).

In an iteration p follows from the approach as for smooth spheres, then t and c are moved against slip and rolling and cut to the
length that p allows. What stays as it is under that obeys Coulomb's law itself, without the opening of sliding contacts that a
convex cone brings with it (M. Anitescu, Math. Program. 105, 113 (2006)); that iterations get there is not proven but seen, and
what is left is measured. All three are kept as speeds, times w_i + w_j, like `IMPULSE`. Velocities and spins of a row stand
side by side.
"""

from math import sqrt

import numpy as np

from particles_mpi.contacts.persistent.problem import EXTRAPOLATED, IMPULSE, MAY_CLOSE, NORMAL, SHARE, STEP
from particles_mpi.contacts.persistent.rough_table import (
    ARM,
    MU,
    OTHER_ARM,
    RESISTANCE,
    ROLL_STEP,
    SLIDE_STEP,
    SPIN_SHARE,
    TANGENTIAL,
    spins_of,
)
from particles_mpi.contacts.rough import plane_of
from particles_mpi.kernels.jit import in_place, inner, kernel, with_item


@in_place
def give(axes, table, e, given, turned):
    """Add the extrapolated impulse of half-edge e to the sums `given` and `turned` (tuples) of row i; returns both."""
    d, s, at = len(axes), spins_of(axes), NORMAL + len(axes)
    share, spin_share = table[e, SHARE], table[e, at + SPIN_SHARE]
    extrapolated, tangential, rolled = share * table[e, EXTRAPOLATED], at + TANGENTIAL + d, at + TANGENTIAL + 2 * d + s
    for k in range(d):
        given = with_item(given, k, given[k] + (extrapolated * table[e, NORMAL + k] + share * table[e, tangential + k]))
    for p in range(d):
        for q in range(p + 1, d):
            c, sign = plane_of(axes, p, q)
            torque = sign * (table[e, NORMAL + p] * table[e, tangential + q] - table[e, NORMAL + q] * table[e, tangential + p])
            turned = with_item(turned, c, turned[c] + spin_share * (table[e, rolled + c] - table[e, at + ARM] * torque))
    return given, turned


@inner
def rough_begin(axes, first, last, start, table, v0, v):
    """See `iterations.begin`: velocities and spins v of the rows."""
    d, s, at = len(axes), spins_of(axes), NORMAL + len(axes) + TANGENTIAL
    for i in range(first, last):
        given, turned = axes, axes
        for e in range(start[i], start[i + 1]):
            table[e, EXTRAPOLATED] = table[e, IMPULSE]
            for k in range(d):
                table[e, at + d + k] = table[e, at + k]
            for c in range(s):
                table[e, at + 2 * d + s + c] = table[e, at + 2 * d + c]
            given, turned = give(axes, table, e, given, turned)
        for k in range(d):
            v[i, k] = v0[i, k] + given[k]
        for c in range(s):
            v[i, d + c] = v0[i, d + c] + turned[c]


@in_place
def cut(table, e, at, width, step, most, beta, wanted):
    """The tangential impulse of half-edge e, or its couple, from column `at` on: `wanted` (a tuple), not longer than `most`.

    Moves it on by beta times its change. Returns the squares of the error in speed, and error times change.
    """
    size2 = 0.0
    for c in range(width):
        size2 += wanted[c] * wanted[c]
    part = 1.0
    if size2 > most * most:
        part = most / sqrt(size2)
    error2, work = 0.0, 0.0
    for c in range(width):
        new = part * wanted[c]
        change = new - table[e, at + c]
        error = (table[e, at + width + c] - new) / step
        error2 += error * error
        work += error * change
        table[e, at + c] = new
        table[e, at + width + c] = new + beta * change
    return error2, work


@inner
def rough_iterate(axes, first, last, problem, w, v0, v, after, beta, looks, sums):
    """See `iterations.iterate`."""
    start, partner, table, per_allowed, per_round_off = problem
    d, s, at = len(axes), spins_of(axes), NORMAL + len(axes)
    worst, over_round_off = 0.0, 0.0
    for i in range(np.uint64(first), np.uint64(last)):
        squares, work = 0.0, 0.0
        given, turned = axes, axes
        for e in range(np.uint64(start[i]), np.uint64(start[i + np.uint64(1)])):
            step = table[e, STEP]
            if step == 0.0:
                continue
            j, approach = np.uint64(partner[e]), 0.0
            slip, spin = axes, axes
            for k in range(d):
                u = v[i, np.uint64(k)] - v[j, np.uint64(k)]
                slip = with_item(slip, k, u)
                approach += u * table[e, NORMAL + k]
            arm, far = table[e, at + ARM], table[e, at + OTHER_ARM]
            for p in range(d):
                for q in range(p + 1, d):
                    c, sign = plane_of(axes, p, q)
                    one, two = v[i, np.uint64(d + c)], v[j, np.uint64(d + c)]
                    rim = sign * (arm * one + far * two)
                    slip = with_item(slip, p, slip[p] + rim * table[e, NORMAL + q])
                    slip = with_item(slip, q, slip[q] - rim * table[e, NORMAL + p])
                    spin = with_item(spin, c, one - two)
            extrapolated = table[e, EXTRAPOLATED]
            new = extrapolated - (table[e, MAY_CLOSE] + approach) * step
            new = new if new > 0.0 else 0.0
            change, error = new - table[e, IMPULSE], (extrapolated - new) / step
            table[e, IMPULSE], table[e, EXTRAPOLATED] = new, new + beta * change
            error2, worked = error * error, error * change
            slide_step, roll_step = table[e, at + SLIDE_STEP], table[e, at + ROLL_STEP]
            for k in range(d):
                across = slip[k] - approach * table[e, NORMAL + k]
                slip = with_item(slip, k, table[e, at + TANGENTIAL + d + k] - across * slide_step)
            if slide_step > 0.0:
                most = table[e, at + MU] * new if new > 0.0 else 0.0
                more, done = cut(table, e, at + TANGENTIAL, d, slide_step, most, beta, slip)
                error2, worked = error2 + more, worked + done
            if roll_step > 0.0:
                for c in range(s):
                    spin = with_item(spin, c, table[e, at + TANGENTIAL + 2 * d + s + c] - spin[c] * roll_step)
                most = table[e, at + RESISTANCE] * new
                more, done = cut(table, e, at + TANGENTIAL + 2 * d, s, roll_step, most, beta, spin)
                reach = (arm if arm > far else far) ** 2  # an error in spin, as one of the surface
                error2, worked = error2 + more * reach, worked + done
            if looks:
                size = sqrt(error2)
                part = size * per_allowed[e]
                squares += part * part
                worst = part if part > worst else worst
                part = size * per_round_off[e]
                over_round_off = part if part > over_round_off else over_round_off
                work += worked * table[e, SHARE]
            given, turned = give(axes, table, e, given, turned)
        for k in range(d):
            after[i, np.uint64(k)] = v0[i, np.uint64(k)] + given[k]
        for c in range(s):
            after[i, np.uint64(d + c)] = v0[i, np.uint64(d + c)] + turned[c]
        if looks:
            sums[i, np.uint64(0)], sums[i, np.uint64(1)] = squares, work / w[i, np.uint64(0)] if w[i, np.uint64(0)] > 0.0 else 0.0
    return worst, over_round_off


@inner
def rough_works(axes, problem, w, v0, v, sums):
    """See `iterations.works`."""
    start, _, table, _, _ = problem
    most = 0.0
    d, s = len(axes), spins_of(axes)
    for i in range(len(sums)):
        linear, quadratic = 0.0, 0.0
        for k in range(d + s):
            inverse = w[i, 0 if k < d else 1]
            if inverse > 0.0:
                change = v[i, k] - v0[i, k]
                linear += change * v0[i, k] / inverse
                quadratic += change * change / inverse
        for e in range(start[i], start[i + 1]):
            if w[i, 0] > 0.0:
                linear += table[e, IMPULSE] * table[e, SHARE] ** 2 * table[e, MAY_CLOSE] / w[i, 0]
        sums[i, 0], sums[i, 1] = linear, quadratic
        most = max(most, abs(linear), quadratic)
    return most


@kernel
def slide_loads(axes, start, partner, tangential, w, net_push):
    """Add the loads of contacts across their normals, tangential (m, d or more), to the net pushes (n, d) of rows."""
    for i in range(len(start) - 1):
        for e in range(start[i], start[i + 1]):
            share = w[i] / (w[i] + w[partner[e]])
            for k in range(len(axes)):
                net_push[i, k] += share * tangential[e, k]
