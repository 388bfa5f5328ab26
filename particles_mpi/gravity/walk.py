"""Walking the tree: each group of targets lists the cells that are far from it and the particles that are near, and adds them up.

A cell is far from a group if it passes the opening test `is_far` against the group's bounding box. With an opening angle of at
most 1 no cell is far from a particle of its own. Far cells act by mass and quadrupole: with the vector u from target to centre
of mass, rho^2 = u^2 + eps^2, second moments S, trace T, Q = u.S.u

    potential = -(M/rho + (3 Q/rho^2 - T)/(2 rho^3)),     a = u (M/rho^3 + (15 Q/(2 rho^2) - 3 T/2)/rho^5) - 3 S u/rho^5,

which is the Taylor expansion of -m/rho to second order, with softening too; or by mass alone, as a particle does.

The compiler may use vector instructions in these sums: the order then depends on the length of a list, never on the ranks.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from particles_mpi.gravity.octree import CENTER, END, FIRST, MASS, RADIUS, SECOND, is_far
from particles_mpi.kernels.jit import inner, kernel
from particles_mpi.particles import Array

CELLS, PARTICLES = 256, 512  # sources that are added up at a time: they stay in the first-level cache
POTENTIAL, WORK, RESULT = 3, 4, 5  # columns of a result: acceleration (3), potential, work; and how many these are
# Work, in units of one particle acting on one target: a far quadrupole for a target, a near particle for a target, and a node
# that a group visits. Ranks get equal shares of it.
FAR, NEAR, VISIT = 1.7, 1.0, 12.0

summing: Any = inner(_nrt=False, error_model="numpy", fastmath={"reassoc", "nsz", "contract"})
walking: Any = inner(_nrt=False, error_model="numpy")


class Nodes(NamedTuple):
    """The nodes of a tree in preorder, and the particles in its leaves."""

    skip: Array  # (nodes,) the first node that does not belong to the cell
    first: Array  # (nodes,) the first row of a leaf
    particle_count: Array  # (nodes,) rows of a leaf; 0 for cells that are divided, or whose particles are not on this rank
    cells: Array  # (nodes, WIDTH) moments
    x: Array  # (rows, 3) positions
    mass: Array  # (rows,)


class Law(NamedTuple):
    """How cells and particles act."""

    angle: float  # opening angle
    softening2: float  # eps^2
    quadrupoles: bool  # do far cells act by their second moments too?


@summing
def add_particles(near, n, x, y, z, own, softening2, total, t):
    """Add to total[t] the acceleration and potential at (x, y, z) of the first n particles of near (4, .): position, mass.

    Column `own` is the target itself, which adds nothing; -1 if it is not among them.
    """
    ax, ay, az, potential = 0.0, 0.0, 0.0, 0.0
    for j in range(n):
        u, v, w = near[0, j] - x, near[1, j] - y, near[2, j] - z
        r2 = softening2 + u * u + v * v + w * w
        q = 1.0 / sqrt(r2)
        q = q if r2 > 0.0 and j != own else 0.0
        m = near[3, j] * q
        f = m * q * q
        ax, ay, az, potential = ax + f * u, ay + f * v, az + f * w, potential - m
    total[t, 0] += ax
    total[t, 1] += ay
    total[t, 2] += az
    total[t, POTENTIAL] += potential


@summing
def add_cells(far, n, x, y, z, softening2, total, t):
    """The same for the first n cells of far (11, .): centre of mass (3), mass, 3 S (xx, xy, xz, yy, yz, zz), 3 T/2."""
    ax, ay, az, potential = 0.0, 0.0, 0.0, 0.0
    for j in range(n):
        u, v, w = far[0, j] - x, far[1, j] - y, far[2, j] - z
        q = 1.0 / sqrt(softening2 + u * u + v * v + w * w)
        q2 = q * q
        q3 = q * q2
        q5 = q3 * q2
        su = far[4, j] * u + far[5, j] * v + far[6, j] * w
        sv = far[5, j] * u + far[7, j] * v + far[8, j] * w
        sw = far[6, j] * u + far[8, j] * v + far[9, j] * w
        bulge = (su * u + sv * v + sw * w) * q2  # 3 Q/rho^2
        trace = far[10, j]
        f = far[3, j] * q3 + q5 * (2.5 * bulge - trace)
        ax, ay, az = ax + f * u - q5 * su, ay + f * v - q5 * sv, az + f * w - q5 * sw
        potential -= far[3, j] * q + q3 * (0.5 * bulge - trace / 3.0)
    total[t, 0] += ax
    total[t, 1] += ay
    total[t, 2] += az
    total[t, POTENTIAL] += potential


@kernel
def walk(tree, groups, offset, law):
    """Acceleration, potential and work for G = 1, (rows, RESULT), of the targets; and the number of interactions.

    `groups` (g, 2): FIRST and END row of each among the targets, which are the rows of the tree from `offset` on.
    """
    result, interactions = np.zeros((groups[-1, END] if len(groups) else 0, RESULT)), 0
    lists = np.empty((11, CELLS)), np.empty((4, PARTICLES))
    for g in range(len(groups)):
        sources = add_sources(groups[g], tree, offset, law, lists, result)
        interactions += sources * (groups[g, END] - groups[g, FIRST])
    return result, interactions


@walking
def add_sources(group, tree, offset, law, lists, result):
    """All sources act on one group, whose rows are group[FIRST] ... group[END] of the result. Returns how many sources."""
    (begin, end), (skip, first, count, cells, x, mass), (angle, softening2, quadrupoles) = group, tree, law
    far, near = lists
    lx, ly, lz = x[offset + begin, 0], x[offset + begin, 1], x[offset + begin, 2]
    hx, hy, hz = lx, ly, lz
    for p in range(offset + begin, offset + end):
        lx, ly, lz = min(lx, x[p, 0]), min(ly, x[p, 1]), min(lz, x[p, 2])
        hx, hy, hz = max(hx, x[p, 0]), max(hy, x[p, 1]), max(hz, x[p, 2])
    angle2 = angle * angle
    n_far, n_near, all_far, all_near, visits = 0, 0, 0, 0, 0
    own, column = -1, 0  # the first row of the group that is in `near`, and its column there
    node = 0
    while node < len(skip):
        visits += 1
        cx, cy, cz = cells[node, CENTER], cells[node, CENTER + 1], cells[node, CENTER + 2]
        if is_far(lx, ly, lz, hx, hy, hz, cx, cy, cz, cells[node, RADIUS], angle2):
            if n_far == CELLS:
                flush_far(far, np.int64(n_far), x, begin, end, offset, softening2, quadrupoles, result)
                all_far, n_far = all_far + n_far, 0
            far[0, n_far], far[1, n_far], far[2, n_far], far[3, n_far] = cx, cy, cz, cells[node, MASS]
            if quadrupoles:
                for e in range(6):
                    far[4 + e, n_far] = 3.0 * cells[node, SECOND + e]
                far[10, n_far] = 0.5 * (far[4, n_far] + far[7, n_far] + far[9, n_far])
            n_far += 1
            node = skip[node]
            continue
        for p in range(first[node], first[node] + count[node]):
            if n_near == PARTICLES:
                flush_near(near, np.int64(n_near), x, begin, end, offset, np.int64(own), np.int64(column), softening2, result)
                all_near, n_near, own = all_near + n_near, 0, -1
            if own < 0 and offset + begin <= p < offset + end:
                own, column = p, n_near
            near[0, n_near], near[1, n_near], near[2, n_near], near[3, n_near] = x[p, 0], x[p, 1], x[p, 2], mass[p]
            n_near += 1
        node += 1
    flush_far(far, np.int64(n_far), x, begin, end, offset, softening2, quadrupoles, result)
    flush_near(near, np.int64(n_near), x, begin, end, offset, np.int64(own), np.int64(column), softening2, result)
    all_far, all_near = all_far + n_far, all_near + n_near
    work = (FAR if quadrupoles else NEAR) * all_far + NEAR * all_near + VISIT * visits / (end - begin)
    for t in range(begin, end):
        result[t, WORK] = work
    return all_far + all_near


@walking
def flush_far(far, n, x, begin, end, offset, softening2, quadrupoles, result):
    """The first n cells of the list act on every target of the group."""
    for t in range(begin, end):
        p = offset + t
        if quadrupoles:
            add_cells(far, n, x[p, 0], x[p, 1], x[p, 2], softening2, result, t)
        else:
            add_particles(far, n, x[p, 0], x[p, 1], x[p, 2], np.int64(-1), softening2, result, t)


@walking
def flush_near(near, n, x, begin, end, offset, own, column, softening2, result):
    """The first n particles of the list act on every target of the group, but none on itself."""
    for t in range(begin, end):
        p = offset + t
        itself = column + p - own if own >= 0 else np.int64(-1)
        add_particles(near, n, x[p, 0], x[p, 1], x[p, 2], itself, softening2, result, t)
