"""The contacts that have an impulse, as `direct` chooses them, and their equations, by Cholesky's method."""

from math import inf, sqrt
from typing import NamedTuple

from particles_mpi.kernels.jit import inner
from particles_mpi.particles import Array

DEPENDENT = 1e-14  # of its diagonal element: below it a contact can do nothing that those chosen do not


class Active(NamedTuple):
    """The state of the method: which contacts are chosen, and their impulses."""

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
    """Add `most` times x to the impulses of the chosen contacts, or less: until that of one is 0, which is let go.

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
    """To x the impulses that the chosen contacts need besides, for their speeds to be 0."""
    for r in range(size):
        active.x[r] = -active.speeds[active.chosen[r]]
    solve_factorized(active, size)
