"""The direct sum over all pairs. Arrays only.

Every target adds up its sources in the order of their ids, one after the other, so that its sum has the same bits however
the sources are divided into blocks. The innermost loop runs over the targets of a tile, not over the sources: the compiler can
then use vector instructions without changing the order of any sum.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from particles_mpi.kernels.jit import kernel, lean_inner

TILE = 64  # targets whose coordinates and sums stay in the first-level cache


@lean_inner(error_model="numpy")
def attract_few(axes, x, mass, softening2, total):
    """total (n, d) = what `attract` gives for x as sources and targets: the same bits, for so few that tiles would be empty.

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
                r2 += r * r
            cube = r2 * sqrt(r2)
            near = r2 > 0.0
            on_i, on_j = mass[j] / cube if near else 0.0, mass[i] / cube if near else 0.0
            for k in range(len(axes)):
                total[i, k] += on_i * (x[j, k] - x[i, k])
                total[j, k] += on_j * (x[i, k] - x[j, k])


@kernel(error_model="numpy")
def attract(axes, x, source, mass, softening2, total):
    """total (n, d) += sum_j m_j r_j/(r_j^2 + softening2)^(3/2), r_j = source_j - x; a source at its target adds nothing."""
    d = len(axes)
    at, sums = np.empty((d, TILE)), np.empty((d, TILE))
    for first in range(0, len(x), TILE):
        count = min(TILE, len(x) - first)
        for t in range(TILE):
            for k in range(d):  # the rest of the last tile repeats the last target
                at[k, t] = x[first + min(t, count - 1), k]
                sums[k, t] = total[first + min(t, count - 1), k]
        for j in range(len(source)):
            m = mass[j]
            for t in range(TILE):
                r2 = softening2
                for k in range(d):
                    r = source[j, k] - at[k, t]
                    r2 += r * r
                pull = m / (r2 * sqrt(r2))
                pull = pull if r2 > 0.0 else 0.0
                for k in range(d):
                    sums[k, t] += pull * (source[j, k] - at[k, t])
        for t in range(count):
            for k in range(d):
                total[first + t, k] = sums[k, t]


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
