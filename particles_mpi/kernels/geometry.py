"""Distances in a periodic box, and places brought back into it. Scalars and arrays only."""

from __future__ import annotations

import numpy as np

from particles_mpi.kernels.jit import kernel, lean_inner


@lean_inner
def nearest(r, length):
    """The component r of a distance, by the nearest periodic image."""
    if length > 0.0:
        if r > 0.5 * length:
            r -= length
        elif r < -0.5 * length:
            r += length
    return r


@lean_inner
def boxes_between(r, length):
    """What to take from the component r of a distance, to get the nearest periodic image however many boxes away."""
    return length * np.rint(r / length) if abs(r) > 0.5 * length > 0.0 else 0.0


@kernel
def wrap(x, lower, upper, length):
    """Positions back into [lower, upper) on periodic axes (length > 0), in place on x (n, d)."""
    for k in range(x.shape[1]):
        if length[k] > 0.0:
            for i in range(x.shape[0]):
                if x[i, k] < lower[k] or x[i, k] >= upper[k]:
                    y = lower[k] + (x[i, k] - lower[k]) % length[k]
                    x[i, k] = y if y < upper[k] else lower[k]
