"""The rows that contacts are sought for, copied from the particles and given back to them."""

from typing import NamedTuple

import numpy as np

from particles_mpi.kernels.jit import kernel
from particles_mpi.kernels.markers import PRESSED
from particles_mpi.particles import Array


class Local(NamedTuple):
    """Rows, ghosts and a wall: x, v, push (size + 1, d), radius, w = 1/m or 0, crowd, supported (size + 1,), and, of rough
    spheres, spin (size + 1, d(d-1)/2), which has no row in a smooth scene."""

    x: Array
    v: Array
    push: Array
    radius: Array
    w: Array
    crowd: Array
    supported: Array
    spin: Array


@kernel
def gather(rows, position, velocity, a, supported, scale, x, v, push, held):
    """The state of `rows` of the particles, pushes being accelerations times `scale`; the last row is that of a wall."""
    d, last = x.shape[1], len(x) - 1
    for n in range(len(rows)):
        i = rows[n]
        for k in range(d):
            x[n, k], v[n, k], push[n, k] = position[i, k], velocity[i, k], scale * a[i, k]
        held[n] = supported[i]
    x[last], v[last], push[last], held[last] = 0.0, 0.0, 0.0, 0.0


@kernel
def hand_over(rows, v, held, velocity, supported):
    """Write velocities v (n, d), and whether rows are `held` (n,), to the particles; returns changed rows, and by how much."""
    changed, by, found = np.empty(len(rows), np.int64), np.empty(v.shape), 0
    for n in range(len(rows)):
        i, differs = rows[n], False
        supported[i] = PRESSED * held[n]
        for k in range(v.shape[1]):
            by[found, k] = v[n, k] - velocity[i, k]
            differs |= by[found, k] != 0.0
            velocity[i, k] = v[n, k]
        changed[found] = i
        found += differs
    return changed[:found], by[:found]
