"""The problem that `solver` is given: the contacts of a rank's rows, as a table with one row for each half-edge."""

from math import sqrt
from typing import NamedTuple

import numpy as np

from particles_mpi.kernels.jit import in_place, kernel
from particles_mpi.particles import Array

# Columns of the table of half-edges. It has one row for each, 64 bytes long in space: arrays of their own would be in one
# another's way in the cache, all being read at the same pace.
SHARE = 0  # the part of the change of approach that this row contributes, w_i/(w_i + w_j)
STEP = 1  # length of a gradient step, (w_i + w_j)/D, and 0 for contacts that have no impulse
MAY_CLOSE = 2  # the speed at which it may close
IMPULSE = 3  # along the normal, as a speed: p (w_i + w_j), by which it changes the approach of its partners
EXTRAPOLATED = 4  # the same, moved on along the last change, by the momentum of the iteration
NORMAL = 5  # and the following ones: the normal, towards the row


class Problem(NamedTuple):
    """The contacts that are solved for, as half-edges: those of row i are start[i] ... start[i + 1] - 1.

    start (n + 1,); partner (m,): a row or ghost, or the row of zeros behind them that stands for walls; table (m, 5 + d) with the
    columns above, of rough spheres with more (`rough_table`). An error in speed is allowed up to 1/`per_allowed` (m,), as root
    mean square; below 1/`per_round_off` (m,) nothing is left but round-off.
    """

    start: Array
    partner: Array
    table: Array
    per_allowed: Array
    per_round_off: Array


class Targets(NamedTuple):
    """What a solution must reach for each half-edge, (m,): it may close at `may_close`; the others: see `Problem`."""

    may_close: Array
    per_allowed: Array
    per_round_off: Array


@in_place
def fourth_power_norm(size, m, t):
    """|m^4|^(1/4), by the Frobenius norm, of a symmetric matrix m (size, size): not below the absolute value of any eigenvalue.

    At most size^(1/8) times that. m and t (size, size) are overwritten.
    """
    for _ in range(2):
        for k in range(size):
            for n in range(size):
                total = 0.0
                for q in range(size):
                    total += m[k, q] * m[n, q]
                t[k, n] = total
        m, t = t, m
    square = 0.0
    for k in range(size):
        for n in range(size):
            square += m[k, n] * m[k, n]
    return sqrt(sqrt(sqrt(square)))


@kernel
def bound_rows(axes, start, normal, w, which, bound):
    """To bound (n,): an upper bound of w times the largest eigenvalue of S, the sum of n n^T over the contacts of each row.

    S divided by its trace is what `fourth_power_norm` takes, so that no power of it is too large or too small a number.
    """
    s, t = np.empty((len(axes), len(axes))), np.empty((len(axes), len(axes)))
    for i in range(len(start) - 1):
        trace = 0.0
        for e in range(start[i], start[i + 1]):
            trace += which[e]
        if trace <= 1.0:
            bound[i] = w[i] * trace
            continue
        s[:] = 0.0
        for e in range(np.uint64(start[i]), np.uint64(start[i + 1])):
            if not which[e]:
                continue
            for k in range(len(axes)):
                part = normal[e, np.uint64(k)] / trace
                for m in range(len(axes)):
                    s[k, m] += part * normal[e, np.uint64(m)]
        bound[i] = w[i] * trace * fourth_power_norm(len(axes), s, t)


@kernel
def table_of(axes, start, partner, normal, w, which, bound, may_close, impulses):
    """The table of half-edges (m, 5 + d), of which those that `which` marks may have an impulse; w, bound: see `bound_rows`."""
    table = np.empty((len(partner), NORMAL + len(axes)))
    for i in range(len(start) - 1):
        for e in range(start[i], start[i + 1]):
            j = partner[e]
            both = w[i] + w[j]
            table[e, SHARE] = w[i] / both
            table[e, STEP] = both / (bound[i] + bound[j]) if which[e] else 0.0
            table[e, MAY_CLOSE], table[e, IMPULSE], table[e, EXTRAPOLATED] = may_close[e], impulses[e], impulses[e]
            for k in range(len(axes)):
                table[e, NORMAL + k] = normal[e, k]
    return table
