"""Velocities that let no contact close: the inelastic law of J. J. Moreau (Comput. Methods Appl. Mech. Eng. 177, 329 (1999)).

Of contact c: rows a[c] and b[c], which is negative for a wall; its normal[c] towards a; may_close[c], the speed at which it may
close; share[c], what part of its closing speed each partner gives up. Plain arrays.
"""

import numpy as np
from numba import njit

MOST_ROUNDS = 200
FLAT = 1e-13
RESTARTS = 6


@njit(cache=True)
def project(axes, v, a, b, normal, may_close, share, inertia, tolerance):
    """Velocities nearest to v, in kinetic energy, at which no contact closes faster than it may; in place. What each took.

    A quadratic programme, solved as by J. More and G. Toraldo (SIAM J. Optim. 1, 93 (1991)): Gauss-Seidel sweeps find which
    contacts are pressed, conjugate gradients their share, until one of them would pull. `inertia`: 1/(1/m_a + 1/m_b).
    """
    closing = np.zeros(len(a))  # approach that a contact has taken from its partners
    pressed, excess, way = np.empty(len(a), np.int64), np.empty(len(a)), np.empty(len(a))
    given = np.zeros_like(v)
    for _ in range(MOST_ROUNDS):
        worst = 0.0
        for c in range(len(a)):
            worst = max(worst, relax(axes, v, a, b, normal, may_close, share, closing, c))
        if worst <= tolerance:
            break
        for c in range(len(a) - 1, -1, -1):
            relax(axes, v, a, b, normal, may_close, share, closing, c)
        count = 0
        for c in range(len(a)):
            if closing[c] > 0.0:
                pressed[count] = c
                count += 1
        follow_gradients(
            axes, v, a, b, normal, may_close, share, inertia, tolerance, closing, pressed[:count], excess, way, given
        )
    return closing


@njit(cache=True)
def relax(axes, v, a, b, normal, may_close, share, closing, c):
    """Let contact c close as fast as it may, but not pull; returns the change."""
    new = max(closing[c] - may_close[c] - relative(axes, v, a[c], b[c], normal, c), 0.0)
    change = new - closing[c]
    closing[c] = new
    give(axes, v, a[c], b[c], normal, share, c, change)
    return abs(change)


@njit(cache=True)
def follow_gradients(axes, v, a, b, normal, may_close, share, inertia, tolerance, closing, pressed, excess, way, given):
    """Conjugate gradients for the pressed contacts, all of which are to close as fast as they may.

    Where one would pull it is let go, and the others begin anew, a few times. Never more energy than before.
    """
    for _ in range(RESTARTS):
        count = 0
        for c in pressed:
            if closing[c] > 0.0:
                pressed[count] = c
                count += 1
        pressed = pressed[:count]
        if not descend(axes, v, a, b, normal, may_close, share, inertia, tolerance, closing, pressed, excess, way, given):
            return


@njit(cache=True)
def descend(axes, v, a, b, normal, may_close, share, inertia, tolerance, closing, pressed, excess, way, given):
    """Conjugate gradients until all is done or a contact had to be let go; returns whether it had."""
    slope = 0.0
    for c in pressed:
        excess[c] = may_close[c] + relative(axes, v, a[c], b[c], normal, c)
        way[c] = -excess[c]
        slope += inertia[c] * excess[c] ** 2
    for _ in range(len(pressed)):
        clear(given, a, b, pressed)
        curvature, size, longest = 0.0, 0.0, np.inf  # along the way, and where the first contact would pull
        for c in pressed:
            give(axes, given, a[c], b[c], normal, share, c, way[c])
        for c in pressed:
            curvature += inertia[c] * way[c] * relative(axes, given, a[c], b[c], normal, c)
            size += inertia[c] * way[c] ** 2
            if way[c] < 0.0:
                longest = min(longest, -closing[c] / way[c])
        length = slope / curvature if curvature > FLAT * size else np.inf
        if length >= longest:  # as far as that, or all who would pull let go, if that is better still
            if length < np.inf and let_go(axes, v, a, b, normal, share, inertia, closing, pressed, excess, way, given, length):
                return True
            length = longest
        if not length < np.inf:
            return False
        before, slope, worst = slope, 0.0, 0.0
        clear(given, a, b, pressed)
        for c in pressed:
            give(axes, given, a[c], b[c], normal, share, c, length * way[c])
        for c in pressed:
            closing[c] = max(closing[c] + length * way[c], 0.0)
            excess[c] += relative(axes, given, a[c], b[c], normal, c)
            give(axes, v, a[c], b[c], normal, share, c, length * way[c])
            slope += inertia[c] * excess[c] ** 2
            worst = max(worst, abs(excess[c]))
        if length == longest:
            return True
        if worst <= 0.1 * tolerance:
            return False
        for c in pressed:
            way[c] = slope / before * way[c] - excess[c]
    return False


@njit(cache=True)
def let_go(axes, v, a, b, normal, share, inertia, closing, pressed, excess, way, given, length):
    """The whole length of the way, but no contact pulls; only if that is downhill: returns whether it was."""
    clear(given, a, b, pressed)
    for c in pressed:
        give(axes, given, a[c], b[c], normal, share, c, max(length * way[c], -closing[c]))
    change = 0.0
    for c in pressed:
        step = max(length * way[c], -closing[c])
        change += inertia[c] * step * (excess[c] + 0.5 * relative(axes, given, a[c], b[c], normal, c))
    if not change < 0.0:
        return False
    for c in pressed:
        step = max(length * way[c], -closing[c])
        closing[c] = closing[c] + step
        give(axes, v, a[c], b[c], normal, share, c, step)
    return True


@njit(cache=True)
def clear(given, a, b, pressed):
    """No velocity for the partners of the pressed contacts."""
    for c in pressed:
        given[a[c]] = 0.0
        if b[c] >= 0:
            given[b[c]] = 0.0


@njit(cache=True)
def relative(axes, v, i, j, normal, c):
    """Velocity of i relative to j, or to a wall, along the normal of contact c."""
    speed = 0.0
    for k in range(len(axes)):
        speed += (v[i, k] - (v[j, k] if j >= 0 else 0.0)) * normal[c, k]
    return speed


@njit(cache=True)
def give(axes, v, i, j, normal, share, c, change):
    """Contact c takes the approach `change` from its partners."""
    for k in range(len(axes)):
        v[i, k] += share[c, 0] * change * normal[c, k]
        if j >= 0:
            v[j, k] -= share[c, 1] * change * normal[c, k]
