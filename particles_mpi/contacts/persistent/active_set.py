"""The contacts that `direct` chooses to have an impulse: the order of their equations, and their solution (A.-L. Cholesky)."""

from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from particles_mpi.kernels.jit import inner
from particles_mpi.particles import Array

DEPENDENT = 1e-14  # of its diagonal element: below it a contact can do nothing that those chosen do not


class Active(NamedTuple):
    """The state of the method: which contacts are chosen, and the impulses of all."""

    matrix: Array  # (m, m) A: what an impulse at one contact does to the approach at another
    impulse: Array  # (m,) of each contact
    speeds: Array  # (m,) how much faster its partners part than they must
    inside: Array  # (m,) bool: is it chosen?
    chosen: Array  # (m,) the first ones: those that are, in the order in which they were
    lower: Array  # (m, m) Cholesky's factor of their rows and columns of the matrix
    begin: Array  # (m,) the first column of each row of the factor that is not 0
    x: Array  # (m,) right side and solution of their equations
    velocity: Array  # (size + 1, d) velocities after the impulses


@inner
def factorize(active, first, size):
    """Cholesky's factor of the first `size` chosen contacts: how many of its rows there are.

    That is less than `size` where the next one depends on those before. Its first rows, up to `first`, are there already. What is
    0 at the left of a row of the matrix stays 0 in the factor.
    """
    matrix, chosen, begin, lower = active.matrix, active.chosen, active.begin, active.lower
    for r in range(first, size):
        begin[r] = 0
        while begin[r] < r and matrix[chosen[r], chosen[begin[r]]] == 0.0:
            begin[r] += 1
        for c in range(begin[r], r + 1):
            total = matrix[chosen[r], chosen[c]]
            for k in range(max(begin[r], begin[c]), c):
                total -= lower[r, k] * lower[c, k]
            if c < r:
                lower[r, c] = total / lower[c, c]
            elif total > DEPENDENT * matrix[chosen[r], chosen[r]]:
                lower[r, r] = sqrt(total)
            else:
                return r
    return size


@inner
def solve_factorized(active, size):
    """x becomes the solution for the right side x, of the first `size` chosen contacts."""
    lower, begin, x = active.lower, active.begin, active.x
    for r in range(size):
        for k in range(begin[r], r):
            x[r] -= lower[r, k] * x[k]
        x[r] /= lower[r, r]
    for r in range(size - 1, -1, -1):
        x[r] /= lower[r, r]
        for k in range(begin[r], r):
            x[k] -= lower[r, k] * x[r]


@inner
def change_impulses(active, size, most):
    """Add `most` times x to the impulses of the chosen contacts, or less: the first one that comes to 0 ends it, and is let go.

    Returns (how many times x was added, how many contacts are left, how many of these, from the first on, kept their place).
    Nothing changes if `most` is infinite and no impulse comes to be 0.
    """
    _, impulse, _, inside, chosen, _, _, x, _ = active
    part = most
    for r in range(size):
        if x[r] < 0.0:
            part = min(part, impulse[chosen[r]] / -x[r])
    kept, same = 0, size
    for r in range(size if part < inf else 0):
        c = chosen[r]
        inside[c] = not (x[r] < 0.0 and impulse[c] / -x[r] <= part)
        impulse[c] = impulse[c] + part * x[r] if inside[c] else 0.0
        if inside[c]:
            chosen[kept] = c
            kept += 1
        else:
            same = min(same, r)
    return part, kept, same


@inner
def solve_for_chosen(active, size):
    """Write to x the changes of impulses of the chosen contacts with which their speeds become 0."""
    for r in range(size):
        active.x[r] = -active.speeds[active.chosen[r]]
    solve_factorized(active, size)


@inner
def contacts_by_row(rows, size):
    """(start (size + 1,), of_row (2 m,)): the contacts of row i, among rows (m, 2), are of_row[start[i]:start[i + 1]]."""
    every, start = rows.reshape(-1), np.zeros(size + 1, np.int64)
    start[1:] = np.cumsum(np.bincount(every, minlength=size))
    return start, np.argsort(every, kind="mergesort") // 2


@inner
def visit_from(first, done, start, of_row, rows, w, place, queue):
    """Write the rows to which contacts lead from row `first`, nearest first, to queue[done:], and their places in it to `place`.

    start (len(w) + 1,), of_row: see `contacts_by_row`. Returns how far the queue reaches.
    """
    queue[done], place[first], end = first, done, done + 1
    while done < end:
        i = queue[done]
        done += 1
        for n in range(start[i], start[i + 1]):
            c = of_row[n]
            j = rows[c, 1] if rows[c, 0] == i else rows[c, 0]
            if w[j] > 0.0 and place[j] < 0:
                queue[end], place[j] = j, end
                end += 1
    return end


@inner
def order_of_contacts(rows, w):
    """The contacts (m,) in an order in which those of neighbours are near one another: from one end of a pile to the other.

    Then all elements of their matrix, and of its factor, are near the diagonal (E. Cuthill and J. McKee, Proc. 24th Nat. Conf.
    ACM, 157, 1969).
    """
    start, of_row = contacts_by_row(rows, len(w))
    place, queue, done = np.full(len(w), -1, np.int64), np.empty(len(w), np.int64), 0
    for first in range(len(w)):
        if place[first] < 0 and w[first] > 0.0:
            last = visit_from(first, done, start, of_row, rows, w, place, queue)
            for i in queue[done:last]:
                place[i] = -1
            done = visit_from(queue[last - 1], done, start, of_row, rows, w, place, queue)
    keys = np.empty(len(rows), np.int64)
    for c in range(len(rows)):
        keys[c] = max(place[rows[c, 0]], place[rows[c, 1]])
    return np.argsort(keys, kind="mergesort")
