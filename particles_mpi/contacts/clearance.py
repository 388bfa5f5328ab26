"""Can any contact take place in a drift? For a few spheres, all pairs are tested."""

import numpy as np

from particles_mpi.contacts.law import may_come_near
from particles_mpi.contacts.walls import may_hit, wall_contact
from particles_mpi.kernels.geometry import nearest
from particles_mpi.kernels.jit import in_place
from particles_mpi.kernels.markers import NO_PARTNER
from particles_mpi.neighbours.trajectories import fastest


@in_place
def images_are_far(axes, x, v, radius, h, length):
    """Is the box so wide that in a drift over h only the nearest image of a partner can matter?

    It is if 4 h times the largest speed, plus the largest diameter, is below 0.499 of each periodic length (d,): no step passes
    that a search for neighbours would refuse.
    """
    periodic = False
    for k in range(len(axes)):
        periodic |= length[k] > 0.0
    if not periodic:
        return True
    largest = 0.0
    for i in range(len(radius)):
        largest = max(largest, radius[i])
    reach = 4.0 * h * fastest(x, v) + 2.0 * largest
    far = True
    for k in range(len(axes)):
        far &= (length[k] <= 0.0) | (reach < 0.499 * length[k])
    return far


@in_place
def all_clear(axes, x, v, radius, h, length, bounded, planes):
    """Is it sure that no row of x, v (n, d) meets another one, or a wall, on a straight path over h? It is a quick test.

    length (d,): of the box on periodic axes, 0 on others; bounded: are there walls?
    """
    if not images_are_far(axes, x, v, radius, h, length):
        return False
    for i in range(len(x)):
        if bounded and may_hit(axes, x, v, np.int64(0), 0.0, i, radius[i], h, planes):
            _, wall = wall_contact(axes, x, v, np.int64(0), 0.0, i, radius[i], NO_PARTNER, h, planes)
            if wall >= 0:
                return False
        for j in range(i):
            u2 = 0.0
            ru = 0.0
            r2 = 0.0
            for k in range(len(axes)):
                r = nearest(x[i, k] - x[j, k], length[k])
                u = v[i, k] - v[j, k]
                u2 += u * u
                ru += r * u
                r2 += r * r
            if may_come_near(u2, ru, r2, radius[i] + radius[j], h):
                return False
    return True
