"""Tests whether all particles are there, finite, and at places where particles can be. Arrays only."""

import numpy as np

from particles_mpi.kernels.jit import lean

WATCH_EVERY = 10  # steps between two checks
WALL_ROUND_OFF = 1e-9  # relative distance beyond a wall that counts as rounding


@lean
def find_invalid(axes, x, v, fixed, planes, lower, length):
    """(first row that is not finite, first row beyond a wall or outside the periodic box, which wall); -1 for none of them.

    planes: `Planes` as a plain tuple; lower, length: of the box.
    """
    point, normal, _, _, lowest, highest, oblique = planes
    numbers, astray, at = -1, -1, -1
    for i in range(len(x)):
        sums, size, between = 0.0, 0.0, not oblique
        for k in range(len(axes)):
            sums += x[i, k] * 0.0 + v[i, k] * 0.0
            size += abs(x[i, k])
            between &= (x[i, k] >= lowest[k]) & (x[i, k] <= highest[k])
            beyond = x[i, k] < lower[k] or x[i, k] > lower[k] + length[k]
            if length[k] > 0.0 and beyond and astray < 0:
                astray = i
        if sums != 0.0 and numbers < 0:
            numbers = i
        if between or fixed[i] or astray >= 0:
            continue
        for w in range(len(point)):
            distance, scale = 0.0, size
            for k in range(len(axes)):
                distance += (x[i, k] - point[w, k]) * normal[w, k]
                scale += abs(point[w, k])
            if distance < -WALL_ROUND_OFF * scale and astray < 0:
                astray, at = i, w
    return numbers, astray, at


@lean
def id_checksum(ids):
    """Number, sum and sum of squares of the ids: the same for every order of them. int64, which may overflow and wrap."""
    total = squares = np.int64(0)
    for i in ids:
        total += i
        squares += i * i
    return len(ids), total, squares
