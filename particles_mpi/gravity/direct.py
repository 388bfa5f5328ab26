"""The direct sum over all pairs. Arrays only.

Every target adds up its sources in the order of their ids, one after the other, so that its sum has the same bits however the
sources are divided into blocks. The innermost loop runs over the targets of a tile, not over the sources: the compiler can then
use vector instructions without changing the order of any sum, and the sum has the same bits with vectors of any length.
"""

from math import sqrt
from typing import Any

import numpy as np

from particles_mpi.gravity.powers import formula, pull
from particles_mpi.kernels.jit import fma, inner, kernel, wide

TILE = 64  # targets whose coordinates and sums stay in the first-level cache

summing: Any = inner(_nrt=False, error_model="numpy")


@formula
def attract_one(axes, at, first, step, source, j, mass, softening2, total):
    """Source j of source (m, d), of this mass, acts on a target: coordinate k of it is at[first + k step], its sum in total."""
    r2 = softening2
    for k in range(len(axes)):
        r = source[j, k] - at[first + k * step]
        r2 = fma(r, r, r2)
    strength = pull(mass, r2)
    for k in range(len(axes)):
        total[first + k * step] = fma(strength, source[j, k] - at[first + k * step], total[first + k * step])


@kernel(error_model="numpy")
def attract(axes, x, source, mass, softening2, total):
    """total (n, d) += sum_j m_j r_j/(r_j^2 + softening2)^(3/2), r_j = source_j - x; a source at its target adds nothing."""
    d = len(axes)
    at, sums = np.empty(d * TILE), np.empty(d * TILE)
    for first in range(0, len(x), TILE):
        count = min(TILE, len(x) - first)
        for t in range(TILE):
            for k in range(d):  # the rest of the last tile repeats the last target
                at[k * TILE + t] = x[first + min(t, count - 1), k]
                sums[k * TILE + t] = total[first + min(t, count - 1), k]
        attract_tile(axes, at, source, mass, softening2, sums)
        for t in range(count):
            for k in range(d):
                total[first + t, k] = sums[k * TILE + t]


@summing
def attract_tile(axes, at, source, mass, softening2, sums):
    """All sources act on TILE targets: at (d TILE,), axis by axis, and likewise their sums."""
    wide()
    for j in range(len(source)):
        for t in range(TILE):
            attract_one(axes, at, t, TILE, source, j, mass[j], softening2, sums)


@summing
def attract_few(axes, x, mass, softening2, total):
    """total (n, d) = what `attract` gives for x (n, d) as sources and targets, with the same bits; faster where they are few.

    Each target takes its sources in their order, although each pair is looked at once.
    """
    for i in range(len(x)):
        for k in range(len(axes)):
            total[i, k] = 0.0
    for i in range(len(x)):
        for j in range(i + 1, len(x)):
            r2 = softening2
            for k in range(len(axes)):
                r = x[j, k] - x[i, k]
                r2 = fma(r, r, r2)
            on_i, on_j = pull(mass[j], r2), pull(mass[i], r2)
            for k in range(len(axes)):
                total[i, k] = fma(on_i, x[j, k] - x[i, k], total[i, k])
                total[j, k] = fma(on_j, x[i, k] - x[j, k], total[j, k])


@kernel(error_model="numpy")
def add_potential(axes, x, ids, source, mass, source_ids, softening2, total):
    """total (n,) -= sum_j m_j/(r_j^2 + softening2)^(1/2), without the target and, if not softened, what is at its place."""
    for i in range(len(x)):
        u = total[i]
        for j in range(len(source)):
            r2 = 0.0
            for k in range(len(axes)):
                r = source[j, k] - x[i, k]
                r2 += r * r
            distance = sqrt(r2 + softening2)
            u -= mass[j] / distance if distance > 0.0 and ids[i] != source_ids[j] else 0.0
        total[i] = u
