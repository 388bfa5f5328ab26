"""The zone, which is the box in which contacts are sought, around the rows involved; and crowds, which spread from row to row."""

from math import inf

import numpy as np

from particles_mpi.kernels.geometry import nearest
from particles_mpi.kernels.jit import kernel, lean_inner


@lean_inner
def touches(x, i, wide, zone):
    """Does the sphere of row i, of the radius `wide`, touch the box `zone` (2, d)?"""
    inside = True
    for k in range(x.shape[1]):
        inside &= (x[i, k] + wide >= zone[0, k]) & (x[i, k] - wide <= zone[1, k])
    return inside


@kernel
def inside_zone(x, wide, zone):
    """Which rows and ghosts touch the zone (2, d), with their widths (n,)."""
    inside = np.empty(len(x), np.bool_)
    for i in range(len(x)):
        inside[i] = touches(x, i, wide[i], zone)
    return inside


@kernel
def zone_around(x, wide, rows):
    """Return -low and high (2, d) of the box around these rows with their widths; -inf if there are no rows."""
    ends = np.full((2, x.shape[1]), -inf)
    for i in rows:
        for k in range(x.shape[1]):
            ends[0, k] = max(ends[0, k], wide[i] - x[i, k])
            ends[1, k] = max(ends[1, k], wide[i] + x[i, k])
    return ends


@kernel
def spread(start, other, x, wide, length, crowd):
    """Mark every row that touches a marked one, widths included, until there are no more; returns whether any was new."""
    new = False
    more = True
    while more:
        more = False
        for i in range(len(start) - 1):
            if crowd[i]:
                continue
            for e in range(start[i], start[i + 1]):
                j = other[e]
                if not crowd[j]:
                    continue
                r2 = 0.0
                for k in range(x.shape[1]):
                    r2 += nearest(x[i, k] - x[j, k], length[k]) ** 2
                if r2 <= (wide[i] + wide[j]) ** 2:
                    crowd[i] = new = more = True
                    break
    return new
