"""The compiled loops of `descent`: iterations over rows, and sums over them that have the same bits on any ranks.

With one inverse mass a row, w (size + 1,), spheres are smooth; of rough ones w (size + 1, 2) has 1/m and 1/I. Only what is for
that kind is compiled.
"""

from math import inf, sqrt

import numpy as np

from particles_mpi.contacts.persistent.rough_iterations import rough_begin, rough_iterate, rough_works
from particles_mpi.contacts.persistent.smooth_iterations import smooth_begin, smooth_iterate, smooth_works
from particles_mpi.kernels.jit import inner, kernel

FINE, LARGE = 2.0**24, 2.0**14  # sums are of whole numbers, so that no order changes a bit: of units of 1/FINE, LARGE at most
MOST = 5000  # iterations


@inner
def momentum(theta):
    """(beta of this iteration, theta of the next one): Nesterov's sequence."""
    after = 0.5 * (sqrt(theta**4 + 4.0 * theta * theta) - theta * theta)
    return theta * (1.0 - theta) / (theta * theta + after), after


@kernel
def begin(axes, first, last, problem, w, v0, v):
    """Velocities v of rows first ... last - 1: v0 and what their half-edges have taken; iterations start without momentum."""
    if w.ndim == 1:
        smooth_begin(axes, first, last, problem[0], problem[2], v0, v)
    else:
        rough_begin(axes, first, last, problem[0], problem[2], v0, v)


@inner
def iterate(axes, first, last, problem, w, v0, v, after, beta, looks, sums):
    """One iteration of the rows first ... last - 1: updates the table in place, and writes the velocities to `after`.

    If it `looks`, it returns the largest error of an approach speed divided by the error that is allowed, and the largest one
    divided by round-off. To sums[i] it then writes the sum of squares of the first quotient over the half-edges of row i, and the
    work of the change against the momentum, which is positive when the minimum was passed.
    """
    if w.ndim == 1:
        return smooth_iterate(axes, first, last, problem, w, v0, v, after, beta, looks, sums)
    else:  # one of the two is left out before types are found
        return rough_iterate(axes, first, last, problem, w, v0, v, after, beta, looks, sums)


@kernel
def iterations(axes, count, problem, w, v0, v, other, theta, looks, sums):
    """So many iterations of all rows; v and `other` (size + 1, d) take turns. If it `looks`, it does so in the last one.

    Returns theta of the next one, and of the last one the largest errors and the largest work of a row: see `iterate`.
    """
    worst, over_round_off, most = 0.0, 0.0, 0.0
    for number in range(count):
        beta, theta = momentum(theta)
        look = looks and number == count - 1
        worst, over_round_off = iterate(axes, 0, len(problem[0]) - 1, problem, w, v0, v, other, beta, look, sums)
        v, other = other, v
    if looks:
        for i in range(len(sums)):
            most = max(most, abs(sums[i, 1]))
    return theta, worst, over_round_off, most


@kernel
def works(axes, problem, w, v0, v, sums):
    """To sums[i] (n, 2): the part of row i in p.(N v0 + c) and in p.A p, of the impulses p that took the rows from v0 to v.

    Returns the largest absolute value of these numbers.
    """
    if w.ndim == 1:
        return smooth_works(axes, problem, w, v0, v, sums)
    else:
        return rough_works(axes, problem, w, v0, v, sums)


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
    """Velocities v (n + 1, columns) of rows that touch walls alone, in place, each by itself: a row's bits depend on no other.

    The last one is that of walls.
    Momentum is given up past a minimum, and with friction, which has none, where errors grow.
    """
    n = len(problem[0]) - 1
    v0, other, sums = v.copy(), v.copy(), np.empty((n, 2))
    begin(axes, 0, n, problem, w, v0, v)
    for i in range(n):
        theta, swapped, before = 1.0, False, inf
        for _ in range(MOST):
            here, there = (other, v) if swapped else (v, other)
            beta, theta = momentum(theta)
            _, over_round_off = iterate(axes, i, i + 1, problem, w, v0, here, there, beta, True, sums)
            swapped = not swapped
            if over_round_off <= 1.0:
                break
            if sums[i, 1] > 0.0 if w.ndim == 1 else sums[i, 0] > before:
                theta = 1.0
                begin(axes, i, i + 1, problem, w, v0, there)
            before = sums[i, 0]
    begin(axes, 0, n, problem, w, v0, v)
