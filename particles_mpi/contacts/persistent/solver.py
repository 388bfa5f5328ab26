"""Velocities that let no contact close: the inelastic law of J. J. Moreau (Comput. Methods Appl. Mech. Eng. 177, 329 (1999)).

Of contact c: rows a[c] and b[c], which is negative for a wall; its normal[c] towards a; may_close[c], the speed at which it may
close; share[c], what part of its closing speed each partner gives up; inertia[c], 1/(1/m_a + 1/m_b). Plain arrays.
"""

from math import sqrt

import numpy as np

from particles_mpi.kernels.jit import inner, kernel, lean, lean_inner

MOST_ROUNDS = 200
BETTER = 1e-2  # than after a sweep: what a call makes of approach that is left, for the next one begins there
FLAT = 1e-13
MOST_TAKEN = 1e9  # times the largest relative speed at the beginning: more than any pile needs
RESTARTS = 6
MANY = 1 / 3  # of the contacts pressed: with fewer, the matrix leaves out those that only could be


@kernel
def project(v, a, b, normal, may_close, share, inertia, tolerance, guess, better):
    """Velocities nearest to v, in kinetic energy, at which no contact closes faster than it may; in place. What each took.

    A quadratic programme, solved as by J. More and G. Toraldo (SIAM J. Optim. 1, 93 (1991)): Gauss-Seidel sweeps find which
    contacts are pressed, conjugate gradients their share, until one of them would pull. `guess`: what each may take, to
    begin with; `better`: how much better than after a sweep is enough. Few contacts are done with after a sweep or two; for
    many the matrix is worth its while: that of those which were ever pressed, until a sweep of all presses no other.
    """
    limit = 0.0
    for c in range(len(a)):
        limit = max(limit, MOST_TAKEN * abs(relative(v, a[c], b[c], normal, c)))
    closing = begin(v, a, b, normal, may_close, share, inertia, guess, limit)
    first = sweep(v, a, b, normal, may_close, share, closing)
    if first > tolerance:
        tolerance = max(tolerance, better * first)
        tried, known = np.zeros(len(a), np.bool_), -1
        working_set(tried, closing)
        while sweep(v, a, b, normal, may_close, share, closing) > tolerance:
            of = working_set(tried, closing)
            if len(of) == known:
                break
            known, before, start = len(of), closing.copy(), v.copy()
            solve(v, of, a, b, normal, may_close, share, inertia, tolerance, closing)
            for c in of:
                give(v, a[c], b[c], normal, share, c, closing[c] - before[c])
            if worse(start, v, a, b, normal, may_close, inertia, before, closing, limit):
                for c in of:
                    closing[c] = before[c]
                for i in range(len(v)):
                    for k in range(v.shape[1]):
                        v[i, k] = start[i, k]
                for _ in range(MOST_ROUNDS):
                    if not sweep(v, a, b, normal, may_close, share, closing) > tolerance:
                        break
                break
    return closing


@lean
def worse(start, v, a, b, normal, may_close, inertia, before, closing, limit):
    """Did the dual problem lose as velocities went from `start` to v, and contacts from taking `before` to `closing`?

    It never does but for round-off. Where contacts are many to a particle they can take ever more against one another without
    a change of any velocity, and conjugate gradients may go that way until round-off is all that is left: so contacts that
    take more than `limit` are no gain either. To gain is to be nearer to the solution, and then
    the kinetic energy is not above that of the beginning.
    """
    gain, size, largest = 0.0, 0.0, 0.0
    for c in range(len(a)):
        mean = 0.5 * (relative(start, a[c], b[c], normal, c) + relative(v, a[c], b[c], normal, c))
        part = inertia[c] * (closing[c] - before[c]) * (mean + may_close[c])
        gain -= part
        size += abs(part)
        largest = max(largest, closing[c])
    return not (gain >= -1e-6 * size and largest <= limit)


@inner
def working_set(tried, closing):
    """Contacts that were pressed since the beginning, `tried` before or not; if these are many, all."""
    count = 0
    for c in range(len(closing)):
        tried[c] |= closing[c] > 0.0
        count += tried[c]
    every = count > MANY * len(closing)
    of, found = np.empty(len(closing), np.int64), 0
    for c in range(len(closing)):
        tried[c] |= every
        if tried[c]:
            of[found] = c
            found += 1
    return of[:found]


@kernel
def project_each(v, a, b, normal, may_close, share, inertia, tolerance):
    """The same for rows that touch walls alone, one by one, so that a row's bits do not depend on who else is here.

    Contacts of a row stand together; `tolerance` is that of each contact.
    """
    closing, first = np.empty(len(a)), 0
    while first < len(a):
        last = first + 1
        while last < len(a) and a[last] == a[first]:
            last += 1
        of = slice(first, last)
        some = a[of], b[of], normal[of], may_close[of], share[of]
        alone = last == first + 1  # most are; then nothing is left after a sweep but round-off, which takes another one
        closing[first] = 0.0
        done = alone and not sweep(v, *some, closing[of]) > tolerance[first]
        done |= alone and not done and not sweep(v, *some, closing[of]) > tolerance[first]
        if not done:
            before = closing[first] if alone else 0.0
            taken = project(v, *some, inertia[of], tolerance[of].max(), np.zeros(last - first), 0.0)
            for c in range(first, last):
                closing[c] = before + taken[c - first]
        first = last
    return closing


@inner
def begin(v, a, b, normal, may_close, share, inertia, guess, limit):
    """Approach that each contact has taken from its partners: the guess, if none is above `limit` and all are a gain."""
    start = v.copy()
    for c in range(len(a)):
        give(v, a[c], b[c], normal, share, c, guess[c])
    largest = 0.0
    gain = 0.0  # of the dual problem: sum of impulse (what it still took at the start and takes now, on average)
    for c in range(len(a)):
        mean = 0.5 * (relative(start, a[c], b[c], normal, c) + relative(v, a[c], b[c], normal, c))
        gain -= inertia[c] * guess[c] * (mean + may_close[c])
        largest = max(largest, guess[c])
    if gain >= 0.0 and largest <= limit:
        return guess.copy()
    for i in range(len(v)):
        for k in range(v.shape[1]):
            v[i, k] = start[i, k]
    return np.zeros(len(a))


@lean
def sweep(v, a, b, normal, may_close, share, closing):
    """Each contact in turn closes as fast as it may, but does not pull; returns the largest change."""
    worst = 0.0
    for c in range(len(a)):
        new = max(closing[c] - may_close[c] - relative(v, a[c], b[c], normal, c), 0.0)
        change = new - closing[c]
        closing[c] = new
        give(v, a[c], b[c], normal, share, c, change)
        worst = max(worst, abs(change))
    return worst


@lean
def relative(v, i, j, normal, c):
    """Velocity of i relative to j, or to a wall, along the normal of contact c."""
    speed = 0.0
    for k in range(v.shape[1]):
        speed += (v[i, k] - (v[j, k] if j >= 0 else 0.0)) * normal[c, k]
    return speed


@lean
def give(v, i, j, normal, share, c, change):
    """Contact c takes the approach `change` from its partners."""
    for k in range(v.shape[1]):
        v[i, k] += share[c, 0] * change * normal[c, k]
        if j >= 0:
            v[j, k] -= share[c, 1] * change * normal[c, k]


@inner
def solve(v, of, a, b, normal, may_close, share, inertia, tolerance, closing):
    """Contacts `of` together; only `closing` changes. In y = sqrt(inertia) closing the programme is min y A y/2 - f y, y >= 0."""
    size = len(of)
    scale, y, f = np.empty(size), np.empty(size), np.empty(size)
    for c in range(size):
        scale[c] = sqrt(inertia[of[c]])
        y[c] = scale[c] * closing[of[c]]
    matrix = coupling(len(v), of, a, b, normal, share, inertia, scale)
    for c in range(size):
        e = of[c]
        f[c] = y[c] + row(matrix, y, c) - scale[c] * (may_close[e] + relative(v, a[e], b[e], normal, e))
    pressed, excess = np.empty(size, np.int64), np.empty(size)
    way, clipped, bent = np.zeros(size), np.zeros(size), np.empty(size)
    for _ in range(MOST_ROUNDS):
        worst = 0.0
        for c in range(size):
            new = max(f[c] - row(matrix, y, c), 0.0)
            worst = max(worst, abs(new - y[c]) / scale[c])
            y[c] = new
        if worst <= tolerance:
            break
        for c in range(size - 1, -1, -1):
            y[c] = max(f[c] - row(matrix, y, c), 0.0)
        for _ in range(RESTARTS):
            count = 0
            for c in range(size):
                way[c], clipped[c] = 0.0, 0.0
                if y[c] > 0.0:
                    pressed[count] = c
                    count += 1
            if not descend(matrix, f, scale, tolerance, y, pressed[:count], excess, way, bent, clipped):
                break
    for c in range(size):
        closing[of[c]] = y[c] / scale[c]


@inner
def coupling(rows, of, a, b, normal, share, inertia, scale):
    """A for contacts `of`, without its diagonal, which is 1: (where its rows begin, columns, values)."""
    begins = np.zeros(rows + 1, np.int64)  # contacts of each row of particles
    for c in of:
        begins[a[c] + 1] += share[c, 0] > 0.0
        if b[c] >= 0:
            begins[b[c] + 1] += share[c, 1] > 0.0
    most = 0
    for i in range(rows):
        most += begins[i + 1] ** 2
        begins[i + 1] += begins[i]
    at, place = begins[:-1].copy(), np.empty(begins[rows], np.int64)
    for p in range(len(of)):
        c = of[p]
        if share[c, 0] > 0.0:
            place[at[a[c]]] = p
            at[a[c]] += 1
        if b[c] >= 0 and share[c, 1] > 0.0:
            place[at[b[c]]] = p
            at[b[c]] += 1
    starts, columns, values = np.zeros(len(of) + 1, np.int64), np.empty(most, np.int32), np.empty(most)
    found = 0
    for p in range(len(of)):
        c = of[p]
        for side in range(2):
            i = a[c] if side == 0 else b[c]
            if i < 0 or share[c, side] == 0.0:
                continue
            weight = share[c, side] / inertia[c] * scale[p] * (1.0 if side == 0 else -1.0)
            for other in place[begins[i] : begins[i + 1]]:
                if other == p:
                    continue
                e, along = of[other], 0.0
                for k in range(normal.shape[1]):
                    along += normal[c, k] * normal[e, k]
                columns[found] = other
                values[found] = weight * scale[other] * (along if a[e] == i else -along)
                found += 1
        starts[p + 1] = found
    return starts, columns[:found], values[:found]


@inner(fastmath={"reassoc", "contract"}, inline="always")
def row(matrix, y, c):
    """(A y)_c without the diagonal."""
    starts, columns, values = matrix
    total = 0.0
    for p in range(starts[c], starts[c + 1]):
        total += values[p] * y[columns[p]]
    return total


@lean_inner
def descend(matrix, f, scale, tolerance, y, pressed, excess, way, bent, clipped):
    """Conjugate gradients for the pressed contacts, until all is done or one had to be let go; returns whether one had.

    `way` and `clipped` are 0 for the others. Never uphill.
    """
    slope = 0.0
    for c in pressed:
        excess[c] = y[c] + row(matrix, y, c) - f[c]
        slope += excess[c] ** 2
    for c in pressed:
        way[c] = -excess[c]
    for _ in range(len(pressed)):
        curvature, size, longest = 0.0, 0.0, np.inf  # along the way, and where the first contact would pull
        for c in pressed:
            bent[c] = way[c] + row(matrix, way, c)
            curvature += way[c] * bent[c]
            size += way[c] ** 2
            if way[c] < 0.0:
                longest = min(longest, -y[c] / way[c])
        length = slope / curvature if curvature > FLAT * size else np.inf
        if length >= longest:  # as far as that, or all who would pull let go, if that is better still
            if length < np.inf and let_go(matrix, y, pressed, excess, way, clipped, length):
                return True
            length = longest
        if not length < np.inf:
            return False
        before, slope, worst = slope, 0.0, 0.0
        for c in pressed:
            y[c] = max(y[c] + length * way[c], 0.0)
            excess[c] += length * bent[c]
            slope += excess[c] ** 2
            worst = max(worst, abs(excess[c]) / scale[c])
        if length == longest:
            return True
        if worst <= 0.1 * tolerance:
            return False
        for c in pressed:
            way[c] = slope / before * way[c] - excess[c]
    return False


@lean_inner
def let_go(matrix, y, pressed, excess, way, clipped, length):
    """The whole length of the way, but no contact pulls; only if that is downhill: returns whether it was."""
    change = 0.0
    for c in pressed:
        clipped[c] = max(length * way[c], -y[c])
    for c in pressed:
        change += clipped[c] * (excess[c] + 0.5 * (clipped[c] + row(matrix, clipped, c)))
    if not change < 0.0:
        return False
    for c in pressed:
        y[c] += clipped[c]
    return True
