"""The compiled loops of `descent`: iterations over rows, and sums over them that have the same bits on any ranks.

With one inverse mass a row, w (size + 1,), spheres are smooth; of rough ones w (size + 1, 2) has 1/m and 1/I. Only what is for
that kind is compiled.
"""

from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from particles_mpi.contacts.persistent.rough_iterations import rough_begin, rough_iterate, rough_works
from particles_mpi.contacts.persistent.smooth_iterations import smooth_begin, smooth_iterate, smooth_works
from particles_mpi.kernels.jit import inner, kernel

# Sums are of whole numbers, so that no order changes a bit: of units of 1/SUM_UNITS, LARGEST_SUM at most.
SUM_UNITS, LARGEST_SUM = 2.0**24, 2.0**14
LARGEST_UNIT = 1e300  # of squares of errors, which may be infinite
MOST_ITERATIONS = 5000
CHECK = 5  # iterations between two looks at what is left
FIRST_THETA = 0.25  # where the sequence of momenta begins: not at 1, for solutions begin near the last one
OUTLIER = 20.0  # times the root mean square that is allowed may the largest error be
CALM = 1e-3  # of the allowed errors, root mean square: below it at least MORE iterations are done
MORE = 150  # iterations in such a pile: fewer do not show what else has to fall
GROWN = 3.0  # times the least sum of squares of errors so far: above it rough spheres give up momentum, see `verdict`


@inner
def momentum(theta):
    """(beta of this iteration, theta of the next one): Nesterov's sequence."""
    after = 0.5 * (sqrt(theta**4 + 4.0 * theta * theta) - theta * theta)
    return theta * (1.0 - theta) / (theta * theta + after), after


@kernel
def begin(axes, first, last, problem, w, v0, v):
    """Velocities v of rows first ... last - 1: v0 and the impulses of their half-edges; iterations start without momentum."""
    start, _, table, _, _ = problem
    if w.ndim == 1:
        smooth_begin(axes, first, last, start, table, v0, v)
    else:
        rough_begin(axes, first, last, start, table, v0, v)


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
        worst, over_round_off = iterate(axes, 0, len(sums), problem, w, v0, v, other, beta, look, sums)
        v, other = other, v
    for i in range(len(sums) if looks else 0):
        most = max(most, abs(sums[i, 1]))
    return theta, worst, over_round_off, most


@inner
def unit_of_squares(worst):
    """In which unit the squares of errors are summed, of which the worst error is the largest: 1 where that may be allowed.

    Else it grows with the worst, so that no row with less than LARGEST_SUM/512 such errors is cut: cut ones do not show growth.
    """
    return min(max(worst * worst / 512.0, 1.0), LARGEST_UNIT)


class Rules(NamedTuple):
    """When iterations end: how many `half_edges` may have an impulse; iterations at `least`, `until` how many for now, and at
    most at all (`limit`); are spheres `rough`?"""

    half_edges: int
    least: int
    until: int
    limit: int
    rough: bool


@inner
def verdict(seen, rules, done, best):
    """After `done` iterations: (are errors allowed, and far below that, may iterations end, should momentum be given up).

    seen: what the last one saw, the two largest errors, and sums over all rows of squares of errors, and of works; best: the
    least sum of squares so far. rules: `Rules`, as a plain tuple in kernels.
    """
    worst, over_round_off, squares, work = seen
    count, least, until, limit, rough = rules
    good, calm = worst <= OUTLIER and squares <= count * SUM_UNITS, rough and squares <= count * SUM_UNITS * CALM**2
    enough = done >= (max(MORE, least) if calm else least)
    ends = over_round_off <= 1.0 or (good and enough) or done >= until
    grown = rough and 2 * done <= limit and squares > GROWN * best  # in the second half what was not found is sought without it
    return good, calm, ends, grown or work > 0.0


@kernel
def iterate_to_end(axes, problem, w, v0, v, other, theta, rules, done, best, sums):
    """`CHECK` iterations and a look, again and again, until the `verdict` is that they may end, where all rows are here.

    Returns (theta, iterations done, best, and what the last look saw: see `iterations`).
    """
    n, count, looks = len(sums), np.int64(CHECK), np.bool_(True)
    while True:
        theta, worst, over_round_off, most = iterations(axes, count, problem, w, v0, v, other, theta, looks, sums)
        v, other = other, v  # for CHECK is odd
        done += CHECK
        unit = unit_of_squares(worst)
        squares, work = whole_numbers(sums, (unit, most if most > 0.0 else 1.0))
        of_all = squares * unit
        _, _, ends, anew = verdict((worst, over_round_off, of_all, float(work)), rules, done, best)
        if ends:
            return theta, done, best, worst, over_round_off, most
        if anew:
            theta = FIRST_THETA
            begin(axes, 0, n, problem, w, v0, v)
        best = min(best, of_all)


@kernel
def works(axes, problem, w, v0, v, sums):
    """To sums[i] (n, 2): the part of row i in the linear term p.(N v0 + c) and in the quadratic term p.A p of what is minimised,
    for the impulses p that changed the velocities of rows from v0 to v.

    Returns the largest absolute value of these numbers.
    """
    if w.ndim == 1:
        return smooth_works(axes, problem, w, v0, v, sums)
    else:
        return rough_works(axes, problem, w, v0, v, sums)


@kernel
def whole_numbers(sums, unit):
    """Sums of the columns of sums (n, 2), divided by their `unit` and times SUM_UNITS, as whole numbers.

    A row of the first column counts LARGEST_SUM units at most. The same in any order and on any number of ranks.
    """
    first, second = np.int64(0), np.int64(0)
    for i in range(len(sums)):
        first += np.int64(min(sums[i, 0] / unit[0], LARGEST_SUM) * SUM_UNITS)
        second += np.int64(sums[i, 1] / unit[1] * SUM_UNITS)
    return first, second


@kernel
def solve_each(axes, problem, w, v):
    """Velocities v (n + 1, columns) of rows that touch walls alone, the last one being that of the walls. In place.

    Each row is solved by itself, so its bits depend on no other.
    Momentum is given up past a minimum, and with friction, which has none, where errors grow.
    """
    n = len(v) - 1
    v0, other, sums = v.copy(), v.copy(), np.empty((n, 2))
    begin(axes, 0, n, problem, w, v0, v)
    for i in range(n):
        theta, swapped, before = 1.0, False, inf
        for _ in range(MOST_ITERATIONS):
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
