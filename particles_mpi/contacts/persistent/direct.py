"""Few contacts of smooth spheres, solved directly: where iterations would not come to an end.

That is so for very different masses, and for chains of spheres that are nearly straight, which bear much more than presses them.

The minimum of p A p/2 + p b for p >= 0 (see `descent`) is found by the method of active sets (C. Lawson and R. Hanson, Solving
Least Squares Problems, 1974, chapter 23): contacts that bear something are chosen one after the other, the equations of those
chosen are solved by Cholesky's method, and what would pull is let go. It begins with those that bear something after iterations.
"""

from math import inf, sqrt

import numpy as np

from particles_mpi.contacts.persistent.problem import MAY_CLOSE, NORMAL, STEP, TAKEN
from particles_mpi.kernels.jit import inner, kernel

DEPENDENT = 1e-14  # of its diagonal element: below it a contact can do nothing that those chosen do not
ROUNDED = 1e-14  # of the impulses times the inverse masses: errors below it are round-off,
ROUNDED_SPEED = 1e-15  # as are those of velocities
REFINED = 3  # times that what is left of the equations is solved for


@inner
def factorize(matrix, chosen, first, size, begin, lower):
    """Cholesky's factor of the rows and columns `chosen` (size,) of a matrix: how many of its rows there are.

    That is less than `size` where the next one depends on those before. Its first rows, up to `first`, are there already.
    begin (size,): the first column of each row that is not 0, for what is left of it stays 0 in the factor.
    """
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
def solve_factorized(lower, begin, size, x):
    """x (size,) becomes the solution for the right side x."""
    for r in range(size):
        for k in range(begin[r], r):
            x[r] -= lower[r, k] * x[k]
        x[r] /= lower[r, r]
    for r in range(size - 1, -1, -1):
        x[r] /= lower[r, r]
        for k in range(begin[r], r):
            x[k] -= lower[r, k] * x[r]


@inner
def change_impulses(chosen, size, x, most, impulse, inside):
    """The chosen contacts (size,) come to bear `most` times x (size,) more, or less: until one bears nothing, and is let go.

    Returns (how many times x was added, how many contacts are left, how many of the first ones were there before). Nothing
    changes if `most` is infinite and no contact comes to bear nothing.
    """
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
def solve_for_chosen(lower, begin, chosen, size, speeds, x):
    """To x (size,) how much more the chosen contacts have to bear for their approaches, whose speeds (m,) these are, to be 0."""
    for r in range(size):
        x[r] = -speeds[chosen[r]]
    solve_factorized(lower, begin, size, x)


@inner
def approaches(axes, edges, rows, table, w, impulse, v0, velocity, speeds):
    """To velocity (size + 1, d) v0 after the impulses (m,), and to speeds (m,) how much faster partners part than they must."""
    velocity[:] = v0
    for c in range(len(rows)):
        e, i, j = edges[c, 0], rows[c, 0], rows[c, 1]
        for k in range(len(axes)):
            velocity[i, k] += w[i] * impulse[c] * table[e, NORMAL + k]
            velocity[j, k] -= w[j] * impulse[c] * table[e, NORMAL + k]
    for c in range(len(rows)):
        e, i, j = edges[c, 0], rows[c, 0], rows[c, 1]
        speeds[c] = table[e, MAY_CLOSE]
        for k in range(len(axes)):
            speeds[c] += (velocity[i, k] - velocity[j, k]) * table[e, NORMAL + k]


@inner
def contacts_of(axes, problem):
    """(half-edges (m, 2) of each contact, the second -1 for a wall; their rows (m, 2)) of those that may take something."""
    start, partner, table = problem[0], problem[1], problem[2]
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
def visit(first, done, start, of_row, rows, w, place, queue):
    """Rows that contacts lead to from row `first`, the nearest ones first: to queue[done:], and their places there to `place`.

    start (size + 2,), of_row: the contacts of row i are of_row[start[i]:start[i + 1]]. Returns how far the queue reaches.
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
def contacts_by_row(rows, size):
    """(start (size + 1,), of_row): the contacts (m, 2) of row i are of_row[start[i]:start[i + 1]]."""
    start, of_row = np.zeros(size + 1, np.int64), np.empty(rows.size, np.int64)
    for i in rows.flat:
        start[i + 1] += 1
    for i in range(size):
        start[i + 1] += start[i]
    end = start[:size].copy()
    for c in range(len(rows)):
        for i in rows[c]:
            of_row[end[i]] = c
            end[i] += 1
    return start, of_row


@inner
def in_space(rows, w):
    """The contacts (m,) in an order in which those of neighbours are near one another: from one end of a pile to the other.

    Then all elements of their matrix, and of its factor, are near the diagonal (E. Cuthill and J. McKee, Proc. 24th Nat. Conf.
    ACM, 157, 1969).
    """
    start, of_row = contacts_by_row(rows, len(w))
    place, queue, done = np.full(len(w), -1, np.int64), np.empty(len(w), np.int64), 0
    for first in range(len(w)):
        if place[first] < 0 and w[first] > 0.0:
            last = visit(first, done, start, of_row, rows, w, place, queue)
            for i in queue[done:last]:
                place[i] = -1
            done = visit(queue[last - 1], done, start, of_row, rows, w, place, queue)
    keys = np.empty(len(rows), np.int64)
    for c in range(len(rows)):
        keys[c] = max(place[rows[c, 0]], place[rows[c, 1]])
    return np.argsort(keys, kind="mergesort")


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
def round_off(axes, c, matrix, impulse, rows, v0):
    """Of the approach at contact c: what rounding of all impulses that act on it does, and of the velocities of its rows."""
    total = 0.0
    for o in range(len(impulse)):
        total += abs(matrix[c, o]) * impulse[o]
    speed = 0.0
    for i in rows[c]:
        for k in range(len(axes)):
            speed += abs(v0[i, k])
    return ROUNDED * total + ROUNDED_SPEED * speed


@kernel
def solve_directly(axes, problem, w, v0):
    """To the table what contacts have taken in the solution for velocities v0 (size + 1, d); returns whether one was found.

    It begins with what they have taken so far. problem, w: see `Problem`; rows in the order of ids, and a last one for walls,
    whose inverse mass is 0. If none is found, nothing has changed.
    """
    table = problem[2]
    edges, rows = contacts_of(axes, problem)
    order = in_space(rows, w)
    edges, rows = edges[order], rows[order]
    m = len(rows)
    matrix = matrix_of(axes, edges, rows, table, w)
    impulse, speeds, x, lower = np.zeros(m), np.empty(m), np.empty(m), np.empty((m, m))
    velocity, chosen, begin, inside = np.empty_like(v0), np.empty(m, np.int64), np.empty(m, np.int64), np.zeros(m, np.bool_)
    size = 0
    for c in range(m):
        chosen[size], taken = c, table[edges[c, 0], TAKEN]
        if taken > 0.0 and factorize(matrix, chosen, size, size + 1, begin, lower) > size:
            inside[c], impulse[c] = True, taken / (w[rows[c, 0]] + w[rows[c, 1]])
            size += 1
    known = size  # so many rows of the factor are known
    approaches(axes, edges, rows, table, w, impulse, v0, velocity, speeds)
    for _ in range(10 * m + 10):
        while size > 0:
            if factorize(matrix, chosen, known, size, begin, lower) < size:
                return False
            known = size
            solve_for_chosen(lower, begin, chosen, size, speeds, x)
            before = size
            _, size, known = change_impulses(chosen, size, x, 1.0, impulse, inside)
            approaches(axes, edges, rows, table, w, impulse, v0, velocity, speeds)
            if size == before:
                break
        worst, new = 0.0, -1
        for c in range(m):
            scale = sqrt(matrix[c, c])
            if not inside[c] and speeds[c] < worst * scale and -speeds[c] > round_off(axes, c, matrix, impulse, rows, v0):
                worst, new = speeds[c] / scale, c
        if new < 0:
            break
        chosen[size] = new
        if factorize(matrix, chosen, known, size + 1, begin, lower) <= size:
            # The new one takes over from one of those on which it depends: what it does along with them moves nothing.
            for r in range(size):
                x[r] = -matrix[chosen[r], new]
            solve_factorized(lower, begin, size, x)
            impulse[new], size, known = change_impulses(chosen, size, x, inf, impulse, inside)
            if not impulse[new] < inf:
                return False
        inside[new] = True
        chosen[size] = new
        size += 1
    for _ in range(REFINED if size > 0 and factorize(matrix, chosen, known, size, begin, lower) == size else 0):
        solve_for_chosen(lower, begin, chosen, size, speeds, x)
        for r in range(size):
            impulse[chosen[r]] = max(impulse[chosen[r]] + x[r], 0.0)
        approaches(axes, edges, rows, table, w, impulse, v0, velocity, speeds)
    tight = problem[4]
    for c in range(m):
        error = abs(speeds[c]) if inside[c] else max(-speeds[c], 0.0)
        if not error * tight[edges[c, 0]] <= 1.0 and not error <= round_off(axes, c, matrix, impulse, rows, v0):
            return False
    for c in range(m):
        taken = impulse[c] * (w[rows[c, 0]] + w[rows[c, 1]])
        table[edges[c, 0], TAKEN] = taken
        if edges[c, 1] >= 0:
            table[edges[c, 1], TAKEN] = taken
    return True
