"""The compiled loops of `solver`: iterations over rows, and sums over them that have the same bits on any ranks."""

from math import sqrt

import numpy as np

from particles_mpi.contacts.persistent.problem import AHEAD, MAY_CLOSE, NORMAL, SHARE, STEP, TAKEN
from particles_mpi.kernels.jit import inner, kernel, with_item

FINE, LARGE = 2.0**24, 2.0**14  # of whole numbers that stand for sums: units of 1, and the largest number
MOST = 5000  # iterations


@kernel
def begin(axes, first, last, start, table, v0, v):
    """Velocities v of the rows first ... last - 1, whose half-edges have taken what they did from v0; nothing is ahead of it."""
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
def iterate(axes, first, last, problem, w, v0, v, after, beta, looks, sums):
    """An iteration of the rows first ... last - 1: the table in place, velocities v to `after`.

    If it `looks`: returns the largest errors in v, in what is enough and in round-off. To sums[i] then the squares of the first,
    and the work of what changes against the momentum, which is positive past a minimum.
    """
    start, partner, table, loose, tight = problem
    one = np.uint64(1)
    rough, left = 0.0, 0.0
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
                rough = part if part > rough else rough
                part = abs(error) * tight[e]
                left = part if part > left else left
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
    return rough, left


@inner
def momentum(theta):
    """(beta of this iteration, theta of the next one): Nesterov's sequence."""
    after = 0.5 * (sqrt(theta**4 + 4.0 * theta * theta) - theta * theta)
    return theta * (1.0 - theta) / (theta * theta + after), after


@kernel
def iterations(axes, count, problem, w, v0, v, other, theta, looks, sums):
    """So many iterations of all rows; v and `other` (size + 1, d) take turns. If it `looks`, one only.

    Returns theta of the next one, and of the last one the largest errors and the largest work of a row: see `iterate`.
    """
    rough, left, most = 0.0, 0.0, 0.0
    for _ in range(count):
        beta, theta = momentum(theta)
        rough, left = iterate(axes, 0, len(problem[0]) - 1, problem, w, v0, v, other, beta, looks, sums)
        v, other = other, v
    if looks:
        for i in range(len(sums)):
            most = max(most, abs(sums[i, 1]))
    return theta, rough, left, most


@kernel
def works(axes, problem, w, v0, v, sums):
    """To sums[i] of each row, which its contacts took from v0 to v: p (N v0 + c), and p A p. Returns the largest."""
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


@kernel
def whole_numbers(sums, unit):
    """The columns of sums (n, 2), in these units, as sums of whole numbers, alike in any order and on any number of ranks."""
    first, second = np.int64(0), np.int64(0)
    for i in range(len(sums)):
        first += np.int64(min(sums[i, 0] / unit[0], LARGE) * FINE)
        second += np.int64(sums[i, 1] / unit[1] * FINE)
    return first, second


@kernel
def solve_each(axes, problem, w, v):
    """Velocities v (n, d) of rows that touch walls alone, in place, each by itself: a row's bits depend on no other."""
    start, table = problem[0], problem[2]
    n = len(start) - 1
    v0, other, sums = v.copy(), v.copy(), np.empty((n, 2))
    begin(axes, 0, n, start, table, v0, v)
    for i in range(n):
        theta, swapped = 1.0, False
        for _ in range(MOST):
            here, there = (other, v) if swapped else (v, other)
            beta, theta = momentum(theta)
            _, left = iterate(axes, i, i + 1, problem, w, v0, here, there, beta, True, sums)
            swapped = not swapped
            if left <= 1.0:
                break
            if sums[i, 1] > 0.0:
                theta = 1.0
                begin(axes, i, i + 1, start, table, v0, there)
    begin(axes, 0, n, start, table, v0, v)
