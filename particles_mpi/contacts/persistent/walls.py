"""The walls at which contacts last: and which rows these concern."""

import numpy as np

from particles_mpi.contacts.persistent.detection import SLOW_PUSH
from particles_mpi.contacts.persistent.near_walls import near_walls
from particles_mpi.kernels.planes import Planes
from particles_mpi.particles import Array, Particles


class Walls:
    """Those of the planes that are `keeping` contacts (bool, one for each plane). `len` is their number.

    taking (walls,): which of them take energy, and keep contacts of a sphere that touches no other, too.
    planes: their points and normals, (walls, d) each; faces: what all the planes bound, see `Planes`; straight: are all of
    them faces along the axes?
    """

    def __init__(self, planes: Planes, keeping: Array, taking: Array):
        self.planes, self.taking = (planes.point[keeping], planes.normal[keeping]), taking[keeping]
        self.faces = planes.lower, planes.upper, planes.oblique
        self.straight = not planes.oblique
        self.round_off = 1e-12 * np.abs(self.planes[0]).max(initial=0.0)

    def __len__(self) -> int:
        return len(self.planes[0])

    def involved(self, p: Particles, a: Array, h: float) -> Array:
        """Rows that are fixed or supported, or have a slow contact with a wall."""
        axes = (0.0,) * p.dimension
        return near_walls(axes, p.position, p.velocity, a, p.radius, p.fixed, p["supported"], h, self.faces, self.planes)

    def reach(self, fixed: Array, a: Array, h: float) -> float:
        """How far from walls slow contacts may be, of rows (at least one) with accelerations a (n, d), the same if not fixed."""
        push = float(np.sqrt((a[np.argmin(fixed)] ** 2).sum()))
        return 1.000001 * SLOW_PUSH * h * h * push + self.round_off
