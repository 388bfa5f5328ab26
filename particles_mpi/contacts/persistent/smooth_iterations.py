"""What `iterations` do with the rows of smooth spheres."""

import numpy as np

from particles_mpi.contacts.persistent.problem import EXTRAPOLATED, IMPULSE, MAY_CLOSE, NORMAL, SHARE, STEP
from particles_mpi.kernels.jit import inner, with_item


@inner
def smooth_begin(axes, first, last, start, table, v0, v):
    """See `iterations.begin`."""
    one = np.uint64(1)
    for i in range(np.uint64(first), np.uint64(last)):
        given = axes
        for e in range(np.uint64(start[i]), np.uint64(start[i + one])):
            table[e, EXTRAPOLATED] = table[e, IMPULSE]
            part = table[e, SHARE] * table[e, IMPULSE]
            for k in range(len(axes)):
                given = with_item(given, k, given[k] + part * table[e, NORMAL + k])
        for k in range(len(axes)):
            v[i, np.uint64(k)] = v0[i, np.uint64(k)] + given[k]


@inner
def smooth_iterate(axes, first, last, problem, w, v0, v, after, beta, looks, sums):
    """See `iterations.iterate`."""
    start, partner, table, per_allowed, per_round_off = problem
    one = np.uint64(1)
    worst, over_round_off = 0.0, 0.0
    for i in range(np.uint64(first), np.uint64(last)):  # unsigned: indices that may be negative take twice as long
        squares, work = 0.0, 0.0
        own, given = axes, axes  # velocity of the row, and what its contacts give it: kept in registers, as no array is
        for k in range(len(axes)):
            own = with_item(own, k, v[i, np.uint64(k)])
        for e in range(np.uint64(start[i]), np.uint64(start[i + one])):
            j, excess = np.uint64(partner[e]), table[e, MAY_CLOSE]
            for k in range(len(axes)):
                excess += (own[k] - v[j, np.uint64(k)]) * table[e, NORMAL + k]
            step, extrapolated = table[e, STEP], table[e, EXTRAPOLATED]
            new = extrapolated - excess * step
            new = new if new > 0.0 else 0.0
            change = new - table[e, IMPULSE]
            if looks and step > 0.0:
                error = (extrapolated - new) / step
                part = abs(error) * per_allowed[e]
                squares += part * part
                worst = part if part > worst else worst
                part = abs(error) * per_round_off[e]
                over_round_off = part if part > over_round_off else over_round_off
                work += error * change * table[e, SHARE]
            next_one = new + beta * change
            table[e, IMPULSE], table[e, EXTRAPOLATED] = new, next_one
            part = table[e, SHARE] * next_one
            for k in range(len(axes)):
                given = with_item(given, k, given[k] + part * table[e, NORMAL + k])
        for k in range(len(axes)):
            after[i, np.uint64(k)] = v0[i, np.uint64(k)] + given[k]
        if looks:
            sums[i, np.uint64(0)], sums[i, np.uint64(1)] = squares, work / w[i] if w[i] > 0.0 else 0.0
    return worst, over_round_off


@inner
def smooth_works(axes, problem, w, v0, v, sums):
    """See `iterations.works`."""
    start, _, table, _, _ = problem
    most = 0.0
    for i in range(len(sums)):
        linear, quadratic = 0.0, 0.0
        for k in range(len(axes)):
            change = v[i, k] - v0[i, k]
            linear += change * v0[i, k]
            quadratic += change * change
        for e in range(start[i], start[i + 1]):
            linear += table[e, IMPULSE] * table[e, SHARE] ** 2 * table[e, MAY_CLOSE]
        sums[i, 0], sums[i, 1] = (linear / w[i], quadratic / w[i]) if w[i] > 0.0 else (0.0, 0.0)
        most = max(most, abs(sums[i, 0]), sums[i, 1])
    return most
