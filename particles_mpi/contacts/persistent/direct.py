"""Direct solution for few contacts of smooth spheres, where iterations would not end.

That happens for very different masses, and for chains of spheres that are nearly straight, whose impulses are much larger than
the forces that press them.

The minimum of p A p/2 + p b for p >= 0 (see `descent`) is found by the method of active sets (C. Lawson and R. Hanson, Solving
Least Squares Problems, 1974, chapter 23): contacts are chosen to have an impulse, one after the other; the equations of those
chosen are solved by Cholesky's method; a contact that would pull is let go. It begins with the impulses after the iterations.
"""

from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from particles_mpi.contacts.persistent.active_set import (
    Active,
    change_impulses,
    contacts_by_row,
    factorize,
    order_of_contacts,
    solve_factorized,
    solve_for_chosen,
)
from particles_mpi.contacts.persistent.problem import IMPULSE, MAY_CLOSE, NORMAL, STEP
from particles_mpi.kernels.jit import inner, kernel
from particles_mpi.particles import Array

IMPULSE_ROUND_OFF = 1e-14  # of the impulses times the inverse masses: errors below it are round-off,
ROUNDED_SPEED = 1e-15  # as are those of velocities
REFINED = 3  # times that what is left of the equations is solved for


class System(NamedTuple):
    """What is solved for together: `m` contacts of `size` rows, and a last row for walls."""

    edges: Array  # (m, 2) half-edges of each contact, the second -1 for a wall
    rows: Array  # (m, 2) its rows
    table: Array  # of the problem, see `Problem`
    w: Array  # (size + 1,) inverse masses
    v0: Array  # (size + 1, d) velocities before


@inner
def find_speeds(axes, system, active):
    """Write to `active` the velocities after its impulses, and the speeds of its contacts."""
    edges, rows, table, w, v0 = system
    velocity, speeds = active.velocity, active.speeds
    velocity[:] = v0
    for c in range(len(rows)):
        e, i, j = edges[c, 0], rows[c, 0], rows[c, 1]
        for k in range(len(axes)):
            velocity[i, k] += w[i] * active.impulse[c] * table[e, NORMAL + k]
            velocity[j, k] -= w[j] * active.impulse[c] * table[e, NORMAL + k]
    for c in range(len(rows)):
        e, i, j = edges[c, 0], rows[c, 0], rows[c, 1]
        speeds[c] = table[e, MAY_CLOSE]
        for k in range(len(axes)):
            speeds[c] += (velocity[i, k] - velocity[j, k]) * table[e, NORMAL + k]


@inner
def contacts_of(axes, problem):
    """(half-edges (m, 2) of each contact, the second -1 for a wall; their rows (m, 2)) of those that may have an impulse."""
    start, partner, table, _, _ = problem
    n, m = len(start) - 1, 0
    edges, rows = np.empty((len(partner), 2), np.int64), np.empty((len(partner), 2), np.int64)
    for i in range(n):
        for e in range(start[i], start[i + 1]):
            j = np.int64(partner[e])
            if not table[e, STEP] > 0.0 or j < i:
                continue
            edges[m, 0], edges[m, 1], rows[m, 0], rows[m, 1] = e, -1, i, j
            nearest = 0.0
            for other in range(start[j] if j < n else 0, start[j + 1] if j < n else 0):
                against = 0.0
                for k in range(len(axes)):
                    against -= table[e, NORMAL + k] * table[other, NORMAL + k]
                if partner[other] == i and against > nearest:  # of two images the one with the opposite normal
                    nearest, edges[m, 1] = against, other
            m += 1
    return edges[:m], rows[:m]


@inner
def matrix_of(axes, edges, rows, table, w):
    """A (m, m): what an impulse at one contact does to the approach at another."""
    start, of_row = contacts_by_row(rows, len(w))
    matrix = np.zeros((len(rows), len(rows)))
    for c in range(len(rows)):
        for side in range(2):
            i = rows[c, side]
            for n in range(start[i], start[i + 1] if w[i] > 0.0 else start[i]):
                o, along = of_row[n], 0.0
                for k in range(len(axes)):
                    along += table[edges[c, 0], NORMAL + k] * table[edges[o, 0], NORMAL + k]
                matrix[c, o] += (1.0 if rows[o, side] == i else -1.0) * w[i] * along
    return matrix


@inner
def round_off(axes, c, system, active):
    """Return the round-off of the speed of contact c: that of all impulses that act on it, and of the velocities of its rows."""
    total = 0.0
    for o in range(len(active.impulse)):
        total += abs(active.matrix[c, o]) * active.impulse[o]
    speed = 0.0
    for i in system.rows[c]:
        for k in range(len(axes)):
            speed += abs(system.v0[i, k])
    return IMPULSE_ROUND_OFF * total + ROUNDED_SPEED * speed


@inner
def choose_those_that_bear(system, active):
    """Begin with the contacts that have an impulse, but for those that depend on others; returns their number."""
    edges, rows, table, w, _ = system
    size = 0
    for c in range(len(rows)):
        active.chosen[size], speed = c, table[edges[c, 0], IMPULSE]
        if speed > 0.0 and factorize(active, size, size + 1) > size:
            active.inside[c], active.impulse[c] = True, speed / (w[rows[c, 0]] + w[rows[c, 1]])
            size += 1
    return size


@inner
def let_go(axes, system, active, known, size):
    """Solve for the chosen contacts, and let go those that would pull, until none does.

    `known`: how many rows of their factor are known. Returns (that number, how many contacts are chosen); the latter is -1 if
    their equations have no solution.
    """
    while size > 0:
        if factorize(active, known, size) < size:
            return known, -1
        known = size
        solve_for_chosen(active, size)
        before = size
        _, size, known = change_impulses(active, size, 1.0)
        find_speeds(axes, system, active)
        if size == before:
            break
    return known, size


@inner
def fastest_approach(axes, system, active):
    """Of the contacts that are not chosen, the one that closes most, measured by what it takes to stop it; -1 if none does."""
    worst, found = 0.0, -1
    for c in range(len(system.rows)):
        scale, speed = sqrt(active.matrix[c, c]), active.speeds[c]
        if not active.inside[c] and speed < worst * scale and -speed > round_off(axes, c, system, active):
            worst, found = speed / scale, c
    return found


@inner
def choose(active, new, known, size):
    """Choose contact `new` too; returns (rows of the factor that are known, how many contacts are chosen, -1 if it cannot be).

    If it depends on those chosen, it replaces one of them: a combination of it and them moves nothing.
    """
    active.chosen[size] = new
    if factorize(active, known, size + 1) <= size:
        for r in range(size):
            active.x[r] = -active.matrix[active.chosen[r], new]
        solve_factorized(active, size)
        active.impulse[new], size, known = change_impulses(active, size, inf)
        if not active.impulse[new] < inf:
            return known, -1
    active.inside[new] = True
    active.chosen[size] = new
    return known, size + 1


@inner
def refine(axes, system, active, known, size):
    """Solve, some times, for the speeds of the chosen contacts that rounding has left."""
    for _ in range(REFINED if size > 0 and factorize(active, known, size) == size else 0):
        solve_for_chosen(active, size)
        for r in range(size):
            c = active.chosen[r]
            active.impulse[c] = max(active.impulse[c] + active.x[r], 0.0)
        find_speeds(axes, system, active)


@inner
def is_solution(axes, system, active, per_round_off):
    """Does no contact pull, and none close by more than allowed errors (`per_round_off`, see `Problem`) or round-off?"""
    for c in range(len(system.rows)):
        error = abs(active.speeds[c]) if active.inside[c] else max(-active.speeds[c], 0.0)
        if not error * per_round_off[system.edges[c, 0]] <= 1.0 and not error <= round_off(axes, c, system, active):
            return False
    return True


@kernel
def solve_directly(axes, problem, w, v0):
    """Write the impulses of the solution for velocities v0 (size + 1, d) to the table; returns whether one was found.

    It begins with the impulses of the table. problem, w: see `Problem`; rows in the order of ids, and a last one for walls, whose
    inverse mass is 0. If no solution is found, nothing is changed.
    """
    _, _, table, _, per_round_off = problem
    edges, rows = contacts_of(axes, problem)
    order = order_of_contacts(rows, w)
    system, m = System(edges[order], rows[order], table, w, v0), len(rows)
    active = Active(
        matrix_of(axes, system.edges, system.rows, table, w), np.zeros(m), np.empty(m), np.zeros(m, np.bool_),
        np.empty(m, np.int64), np.empty((m, m)), np.empty(m, np.int64), np.empty(m), np.empty_like(v0),
    )  # fmt: skip
    size = choose_those_that_bear(system, active)
    known = size
    find_speeds(axes, system, active)
    for _ in range(10 * m + 10):
        known, size = let_go(axes, system, active, known, size)
        new = fastest_approach(axes, system, active) if size >= 0 else -1
        if new < 0:
            break
        known, size = choose(active, new, known, size)
        if size < 0:
            break
    if size < 0:
        return False
    refine(axes, system, active, known, size)
    if not is_solution(axes, system, active, per_round_off):
        return False
    for c in range(m):
        speed = active.impulse[c] * (w[system.rows[c, 0]] + w[system.rows[c, 1]])
        table[system.edges[c, 0], IMPULSE] = speed
        if system.edges[c, 1] >= 0:
            table[system.edges[c, 1], IMPULSE] = speed
    return True
