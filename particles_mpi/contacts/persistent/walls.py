"""The walls at which contacts last, and which rows these concern."""

from math import inf, sqrt

import numpy as np

from particles_mpi.contacts.persistent.detection import ROUND_UP, SLOW_PUSH
from particles_mpi.kernels.jit import in_place, kernel
from particles_mpi.kernels.planes import Planes
from particles_mpi.particles import Array, Particles

ROUND_OFF = 1e-12  # of a coordinate, at most


class Walls:
    """The planes that are `keeping` contacts (bool, one for each plane). `len` is their number.

    taking (walls,): which of them take energy, and so also keep a sphere that touches no other one. planes: their points and
    normals, (walls, d) each; faces: what all the planes bound, see `Planes`; straight: are all of them faces along the axes?
    """

    def __init__(self, planes: Planes, keeping: Array, taking: Array):
        self.planes, self.taking = (planes.point[keeping], planes.normal[keeping]), taking[keeping]
        self.faces = planes.lower, planes.upper, planes.oblique
        self.straight = not planes.oblique
        self.round_off = ROUND_OFF * np.abs(self.planes[0]).max(initial=0.0)

    def __len__(self) -> int:
        return len(self.planes[0])

    def involved(self, p: Particles, a: Array, h: float) -> Array:
        """Rows that are fixed or supported, or have a slow contact with a wall."""
        axes = (0.0,) * p.dimension
        return near_walls(axes, p.position, p.velocity, a, p.radius, p.fixed, p["supported"], h, self.faces, self.planes)

    def reach(self, fixed: Array, a: Array, h: float) -> float:
        """How far from walls slow contacts may be, of rows (at least one) with accelerations a (n, d), the same if not fixed."""
        push = float(np.sqrt((a[np.argmin(fixed)] ** 2).sum()))
        return ROUND_UP * SLOW_PUSH * h * h * push + self.round_off


@in_place
def has_slow_wall(axes, x, v, a, radius, i, h, planes):
    """Has row i a slow contact with a wall, which forces press?"""
    point, normal = planes
    slow = False
    for wall in range(len(point)):
        pressed, closing, distance = 0.0, 0.0, 0.0
        for k in range(len(axes)):
            pressed -= SLOW_PUSH * h * a[i, k] * normal[wall, k]
            closing -= v[i, k] * normal[wall, k]
            distance += (x[i, k] - point[wall, k]) * normal[wall, k]
        slow |= pressed > 0.0 and distance - radius[i] <= pressed * h and abs(closing) <= pressed
    return slow


@kernel
def near_walls(axes, x, v, a, radius, fixed, supported, h, faces, planes):
    """Rows that are fixed or supported, or have a slow contact with a wall.

    `faces`: (lower, upper, oblique), see `Planes`, beyond which the first walls are; `planes`: (points, normals) of the walls.
    """
    lower, upper, oblique = faces
    rows, found = np.empty(len(x), np.int64), 0
    low, high = np.empty(len(axes)), np.empty(len(axes))
    most = 0.0
    for i in range(len(x)):
        a2 = 0.0
        for k in range(len(axes)):
            a2 += a[i, k] * a[i, k]
        most = max(most, a2)
    for k in range(len(axes)):  # within these no sphere is near a face, whatever its push: most rows need no closer look
        far = ROUND_UP * SLOW_PUSH * h * h * sqrt(most)
        low[k] = lower[k] + far + ROUND_OFF * max(lower[k], -lower[k]) if lower[k] > -inf else -inf
        high[k] = upper[k] - far - ROUND_OFF * max(upper[k], -upper[k]) if upper[k] < inf else inf
    for i in range(len(x)):
        here = (supported[i] != 0) | (fixed[i] != 0)
        inside = not oblique
        for k in range(len(axes)):
            inside &= (x[i, k] >= low[k] + radius[i]) & (x[i, k] <= high[k] - radius[i])
        if inside & (not here):
            continue
        if here or has_slow_wall(axes, x, v, a, radius, i, h, planes):
            rows[found] = i
            found += 1
    return rows[:found]


@kernel
def near_walls_among(axes, rows, x, v, a, radius, supported, h, planes):
    """Those of `rows` that are supported, or have a slow contact with a wall."""
    chosen, found = np.empty(len(rows), np.int64), 0
    for i in rows:
        chosen[found] = i
        found += supported[i] != 0 or has_slow_wall(axes, x, v, a, radius, i, h, planes)
    return chosen[:found]
