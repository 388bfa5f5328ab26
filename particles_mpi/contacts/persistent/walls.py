"""The walls at which contacts last: which rows these concern, and the velocities of rows that touch nothing else."""

import numpy as np

from particles_mpi.contacts.persistent.detection import PRECISE, SLOW, near_walls, near_walls_among
from particles_mpi.contacts.persistent.on_walls import settle_on_walls
from particles_mpi.contacts.walls import NearFaces
from particles_mpi.kernels.planes import Planes
from particles_mpi.particles import Array, Particles


class Walls:
    """Those of the planes that are `taking` energy (bool, one for each plane). `len` is their number.

    planes: their points and normals, (walls, d) each; faces: what all the planes bound, see `Planes`. With `screens`, all
    movable rows have the same acceleration and no pair of them is kept: then a drift may tell which rows are near faces.
    """

    def __init__(self, planes: Planes, taking: Array, screens: bool):
        self.planes = planes.point[taking], planes.normal[taking]
        self.faces = planes.lower, planes.upper, planes.oblique
        self.near_faces = NearFaces() if screens and not planes.oblique else None
        self.round_off = 1e-12 * np.abs(self.planes[0]).max(initial=0.0)

    def __len__(self) -> int:
        return len(self.planes[0])

    def involved(self, p: Particles, a: Array, h: float) -> Array:
        """Rows that are supported, or have a slow contact with a wall; where pairs are kept, fixed ones too."""
        state, near = (p.position, p.velocity, a, p.radius), self.near_faces
        if near and len(p):
            near.reach = self.reach(p.fixed, a, h)
            rows = near.within(near.reach, p)  # with all that were held: these have not moved away from their walls
            if rows is not None:
                return near_walls_among(rows, *state, p["supported"], h, *self.planes)
        return near_walls(*state, p.fixed, p["supported"], h, *self.faces, *self.planes)

    def reach(self, fixed: Array, a: Array, h: float) -> float:
        """How far from walls slow contacts may be, of rows (at least one) with accelerations a (n, d), the same if not fixed."""
        push = float(np.sqrt((a[np.argmin(fixed)] ** 2).sum()))
        return 1.000001 * SLOW * h * h * push + self.round_off

    def settle(self, p: Particles, a: Array, h: float, rows: Array, length: Array) -> tuple[Array, Array]:
        """(velocities (n, d) of smooth `rows` that keep slow contacts with walls, which of them these contacts hold (n,) uint8).

        After a kick by accelerations a in a step of h; `length` (d,): of the periodic box, 0 along axes that are not periodic.
        """
        fields = p.position, p.velocity, p.radius, p.mass, p.fixed, p["supported"]
        axes = (0.0,) * p.dimension
        return settle_on_walls(axes, rows, fields, a, h, length, self.faces, self.planes, PRECISE)
