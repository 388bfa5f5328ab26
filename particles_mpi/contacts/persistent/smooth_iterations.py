"""What `iterations` do with the rows of smooth spheres."""

import numpy as np

from particles_mpi.contacts.persistent.problem import AHEAD, MAY_CLOSE, NORMAL, SHARE, STEP, TAKEN
from particles_mpi.kernels.jit import inner, with_item


@inner
def smooth_begin(axes, first, last, start, table, v0, v):
    """See `iterations.begin`."""
    one = np.uint64(1)
    for i in range(np.uint64(first), np.uint64(last)):
        given = axes
        for e in range(np.uint64(start[i]), np.uint64(start[i + one])):
            table[e, AHEAD] = table[e, TAKEN]
            part = table[e, SHARE] * table[e, TAKEN]
            for k in range(len(axes)):
                given = with_item(given, k, given[k] + part * table[e, NORMAL + k])
        for k in range(len(axes)):
            v[i, np.uint64(k)] = v0[i, np.uint64(k)] + given[k]


@inner
def smooth_iterate(axes, first, last, problem, w, v0, v, after, beta, looks, sums):
    """See `iterations.iterate`."""
    start, partner, table, loose, tight = problem
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
            step, ahead = table[e, STEP], table[e, AHEAD]
            new = ahead - excess * step
            new = new if new > 0.0 else 0.0
            change = new - table[e, TAKEN]
            if looks and step > 0.0:
                error = (ahead - new) / step
                part = abs(error) * loose[e]
                squares += part * part
                worst = part if part > worst else worst
                part = abs(error) * tight[e]
                over_round_off = part if part > over_round_off else over_round_off
                work += error * change * table[e, SHARE]
            next_one = new + beta * change
            table[e, TAKEN], table[e, AHEAD] = new, next_one
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
    start, table, most = problem[0], problem[2], 0.0
    for i in range(len(sums)):
        asked, did = 0.0, 0.0
        for k in range(len(axes)):
            change = v[i, k] - v0[i, k]
            asked += change * v0[i, k]
            did += change * change
        for e in range(start[i], start[i + 1]):
            asked += table[e, TAKEN] * table[e, SHARE] ** 2 * table[e, MAY_CLOSE]
        sums[i, 0], sums[i, 1] = (asked / w[i], did / w[i]) if w[i] > 0.0 else (0.0, 0.0)
        most = max(most, abs(sums[i, 0]), sums[i, 1])
    return most
