"""Measures what the round-off of positions does to forces: moves each coordinate a little, at random but reproducibly."""

import numpy as np

from particles_mpi.kernels.jit import lean

SHAKEN = 32.0  # units in the last place by which a coordinate is moved, at most, to see what its round-off does


@lean
def random_factor(number, attempt):
    """A number in [-1, 1) that depends on these two (int64) alone: a multiplicative hash."""
    k = (np.uint64(number) + (np.uint64(attempt) << np.uint64(32))) * np.uint64(0x9E3779B97F4A7C15)
    k = (k ^ (k >> np.uint64(32))) * np.uint64(0xD6E8FEB86659FD93)
    return np.float64(np.int64(k >> np.uint64(11))) * 2.0**-52 - 1.0


@lean
def shake(x, d, attempt):
    """Move each coordinate of x (n d,) by up to SHAKEN units in its last place; bodies at the same position move together.

    The shift depends on position, axis and attempt. If it depended on the id, bodies at the same position, between which no force
    acts, would be separated, and the huge force between them would be taken for round-off.
    """
    for first in range(0, len(x), d):
        place = np.uint64(0)
        for k in range(d):
            mixed = (place ^ (place >> np.uint64(32))) * np.uint64(0x9E3779B97F4A7C15)
            place = mixed + np.float64(x[first + k]).view(np.uint64)
        for k in range(d):
            factor = random_factor(np.int64(place + np.uint64(k)), attempt)
            x[first + k] += SHAKEN * np.spacing(abs(x[first + k])) * factor
