"""The graph of contacts of a rank, where contacts last: which rows are near one another. It is kept until rows move by a skin.

A *half-edge* leads from a row of this rank to a partner, which is another row or a ghost. A contact of two rows has two
half-edges, one at each row; each is computed by the owner of its row, with the same bits. Half-edges of a row are in the order of
their partners' ids, so that sums over them have the same bits on any number of ranks.
"""

import numpy as np

from particles_mpi.contacts.persistent.zone import touches
from particles_mpi.kernels.jit import kernel
from particles_mpi.neighbours.candidates import touching
from particles_mpi.neighbours.halo_region import fetch_near_rows
from particles_mpi.neighbours.trajectories import AT_REST
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.halo import Halo
from particles_mpi.particles import Array, Particles

AGREED = 1.0 + 1e-9  # times the widths, so that ranks agree on which rows are near, whatever the round-off


class ContactGraph:
    """Rows of this rank, the ghosts next to them, and the pairs that come nearer than the sum of their widths plus a skin.

    ids: of all particles of the rank; rows (n,): those of them that are here, ascending; these are followed by `size` - n
    ghosts. start (n + 1,) and other (m,): the half-edges of row i are start[i] ... start[i + 1] - 1, and other[e] is the
    partner's place among rows and ghosts. index: the place of each row of the particles, or -1. id (size,); radius,
    inverse_mass and, of rough spheres, inverse_inertia (size + 1,), the last one being that of a wall.
    """

    def __init__(
        self, ranks: Communicator, p: Particles, rows: Array, wide: Array, skin: float, length: Array, pairs: bool = True,
        points: bool = False,
    ):  # fmt: skip
        """`wide` (len(p),): two rows are near if their distance is at most the sum of their widths. Without `pairs` no rows are
        near.

        Two points are near only if `points` touch one another.

        Collective.
        """
        self.rows, self.skin, self.version, self.length = rows, skin, p.version, length
        self.ids, self.place, self.wide = p.id.copy(), p.position[rows], wide[rows]
        self.index = np.full(len(p), -1, np.int32)
        self.index[rows] = np.arange(len(rows), dtype=np.int32)
        known = {"id": p.id[rows], "position": self.place, "radius": p.radius[rows], "inverse_mass": p.inverse_mass[rows]}
        known["reach"] = self.wide + 0.5 * skin
        known["inverse_inertia"] = p.inverse_inertia[rows] if "spin" in p.arrays else np.empty((len(rows), 0))
        self.halo: Halo | None = None
        if ranks.size > 1 and pairs:
            still = self.place, np.zeros_like(self.place), AGREED * known["reach"]
            _, sent, counts, theirs, arriving = fetch_near_rows(ranks, known, still, AT_REST, length)
            known = {name: np.concatenate((column, theirs[name])) for name, column in known.items()}
            self.halo = Halo(ranks, sent, counts, arriving, len(rows), 0)
        self.id, self.size = known["id"], len(known["id"])
        self.radius, self.inverse_mass = np.append(known["radius"], np.inf), np.append(known["inverse_mass"], 0.0)
        self.inverse_inertia = np.append(known["inverse_inertia"], 0.0)
        if not pairs:
            self.start, self.other = np.zeros(len(rows) + 1, np.int64), np.empty(0, np.int32)
            return
        near = touching(known["position"], known["reach"], known["inverse_mass"], self.id, length)
        touch = np.ones(len(near[0]), bool) if points else (self.radius[near[0]] > 0.0) | (self.radius[near[1]] > 0.0)
        self.start, self.other = half_edges(len(rows), near[0][touch], near[1][touch], self.id)

    def holds(self, p: Particles, wide: Array, zone: Array) -> bool:
        """Does this rank know all pairs of rows in the zone (2, d) that are near, by `wide`?"""
        if p.version != self.version:
            return False
        return bool(covers(p.position, wide, zone, self.index, self.place, self.wide, 0.5 * self.skin, self.length))

    def exchange(self, *columns: Array) -> None:
        """Ghost rows of each column (size or more, ...) as their owners have them. In place. Collective."""
        if self.halo:
            self.halo.refresh(*columns)


@kernel
def half_edges(owned, first, second, ids):
    """(start (owned + 1,), partner) of pairs of rows, for the first `owned` of them; a row's partners in order of their ids."""
    start = np.zeros(owned + 1, np.int64)
    for p in range(len(first)):
        for i in (first[p], second[p]):
            if i < owned:
                start[i + 1] += 1
    for i in range(owned):
        start[i + 1] += start[i]
    other, end = np.empty(start[owned], np.int32), start[:owned].copy()
    for p in range(len(first)):
        for side in range(2):
            i, j = (first[p], second[p]) if side == 0 else (second[p], first[p])
            if i < owned:
                e = end[i]
                end[i] += 1
                while e > start[i] and ids[other[e - 1]] > ids[j]:
                    other[e] = other[e - 1]
                    e -= 1
                other[e] = j
    return start, other


@kernel
def covers(x, wide, zone, index, place, width, margin, length):
    """Is every row that touches the zone in the graph, and moved and widened by no more than the margin since it was built?"""
    for i in range(len(x)):
        if touches(x, i, wide[i], zone):
            n = index[i]
            if n < 0:
                return False
            moved2, room = 0.0, margin - max(wide[i] - width[n], 0.0)
            for k in range(x.shape[1]):
                step = abs(x[i, k] - place[n, k])
                if length[k] > 0.0 and step > 0.5 * length[k]:
                    step = abs(length[k] - step)
                moved2 += step**2
            if room < 0.0 or moved2 > room**2:
                return False
    return True
