"""The rows that contacts are sought for, copied from the particles and given back to them."""

import numpy as np

from particles_mpi.kernels.jit import kernel
from particles_mpi.kernels.markers import PRESSED


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
    """Velocities v (n, d) and who is `held` (n,) to the particles' `rows`; returns the rows that changed, and by how much."""
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
