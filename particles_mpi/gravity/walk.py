"""Walking the tree: each group of targets meets the cells that are far from it and the particles that are near, and adds them up.

A cell is far from a group if it passes the opening test `is_far` against the group's bounding box. With an opening angle of at
most 1 no cell is far from a particle of its own. Far cells act by mass and quadrupole: with the vector u from target to centre
of mass, rho^2 = u^2 + eps^2, second moments S, trace T, Q = u.S.u

    potential = -(M/rho + (3 Q/rho^2 - T)/(2 rho^3)),     a = u (M/rho^3 + (15 Q/(2 rho^2) - 3 T/2)/rho^5) - 3 S u/rho^5,

which is the Taylor expansion of -m/rho to second order, with softening too; or by mass alone, as a particle does. Where the group
is small as seen from the cell, the cell enters the group's own expansion (`expansion`), which all its targets share.

Sources act one after the other, in the order of the tree, on all targets of a group; the cells of the expansion in LANES sums.
So the order of every sum is the tree's: it depends neither on the ranks nor on the vectors of a processor.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from particles_mpi.gravity.expansion import (
    CELLS,
    COEFFICIENTS,
    FAR_WIDTH,
    LANES,
    add_lanes,
    enter_cell,
    evaluate,
    expand,
    fill_lanes,
)
from particles_mpi.gravity.octree import CENTER, END, FIRST, MASS, RADIUS, SECOND, is_far
from particles_mpi.gravity.powers import formula, inverse_root, pull
from particles_mpi.kernels.jit import fma, inner, kernel, lean_inner, wide
from particles_mpi.particles import Array

BLOCK = 8  # the number of targets of a group is rounded up to a multiple of it
SMALL = 0.45
POTENTIAL, WORK, RESULT = 3, 4, 5  # columns of a result: acceleration (3), potential, work; and how many these are
# Work, in units of one particle acting on one target: a far quadrupole for a target, a near particle for a target, a cell of the
# expansion for a group, and a node that a group visits. Ranks get equal shares of it.
FAR, NEAR, EXPANDED, VISIT = 1.7, 1.0, 8.0, 6.0

walking = inner(_nrt=False, error_model="numpy")


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


@formula
def add_particle(at, t, own, px, py, pz, mass, softening2, total):
    """Add to column t of total (4, .) what a particle at (px, py, pz) does to the target at[:, t]; nothing if t is `own`."""
    u, v, w = px - at[0][t], py - at[1][t], pz - at[2][t]
    r2 = fma(u, u, fma(v, v, fma(w, w, softening2)))
    f = pull(mass, r2) if t != own else 0.0
    total[0][t] = fma(f, u, total[0][t])
    total[1][t] = fma(f, v, total[1][t])
    total[2][t] = fma(f, w, total[2][t])
    total[POTENTIAL][t] = fma(-f, r2, total[POTENTIAL][t])


@formula
def add_quadrupole(at, t, cx, cy, cz, mass, second, softening2, total):
    """The same for a cell with its centre of mass at (cx, cy, cz), its mass and its second moments (6)."""
    u, v, w = cx - at[0][t], cy - at[1][t], cz - at[2][t]
    xx, xy, xz, yy, yz, zz = second
    q = inverse_root(fma(u, u, fma(v, v, fma(w, w, softening2))))
    q2 = q * q
    q3 = q * q2
    q5 = 3.0 * q3 * q2
    su = fma(xx, u, fma(xy, v, xz * w))
    sv = fma(xy, u, fma(yy, v, yz * w))
    sw = fma(xz, u, fma(yz, v, zz * w))
    bulge = q2 * fma(su, u, fma(sv, v, sw * w))  # Q/rho^2
    trace = 0.5 * (xx + yy + zz)
    f = fma(mass, q3, q5 * fma(2.5, bulge, -trace))
    total[0][t] = fma(f, u, fma(-q5, su, total[0][t]))
    total[1][t] = fma(f, v, fma(-q5, sv, total[1][t]))
    total[2][t] = fma(f, w, fma(-q5, sw, total[2][t]))
    total[POTENTIAL][t] -= fma(mass, q, q3 * fma(1.5, bulge, -trace))


@walking
def add_particles(at, blocks, own, x, mass, begin, end, softening2, total):
    """Particles begin ... end act on the targets of a group, of which row `own` is the first."""
    wide()
    for p in range(begin, end):
        px, py, pz, m = x[p, 0], x[p, 1], x[p, 2], mass[p]
        for t in range(blocks * BLOCK):
            add_particle(at, t, p - own, px, py, pz, m, softening2, total)


@walking
def add_cell(at, blocks, cell, softening2, quadrupoles, total):
    """A far cell acts on the targets of a group."""
    wide()
    mass, cx, cy, cz = cell[MASS], cell[CENTER], cell[CENTER + 1], cell[CENTER + 2]
    if quadrupoles:
        s = cell[SECOND], cell[SECOND + 1], cell[SECOND + 2], cell[SECOND + 3], cell[SECOND + 4], cell[SECOND + 5]
        for t in range(blocks * BLOCK):
            add_quadrupole(at, t, cx, cy, cz, mass, s, softening2, total)
    else:
        for t in range(blocks * BLOCK):
            add_particle(at, t, -1, cx, cy, cz, mass, softening2, total)


@kernel
def walk(tree, groups, offset, law):
    """Acceleration, potential and work for G = 1, (rows, RESULT), of the targets; and the number of interactions.

    `groups` (g, 2): FIRST and END row of each among the targets, which are the rows of the tree from `offset` on.
    """
    result, interactions, most = np.zeros((groups[-1, END] if len(groups) else 0, RESULT)), 0, 0
    for g in range(len(groups)):
        most = max(most, groups[g, END] - groups[g, FIRST] + BLOCK)
    at = np.empty(most), np.empty(most), np.empty(most)
    total = np.empty(most), np.empty(most), np.empty(most), np.empty(most)
    far, sums = np.empty((CELLS // LANES, FAR_WIDTH, LANES)), np.empty(COEFFICIENTS * LANES)
    for g in range(len(groups)):
        begin, end = offset + groups[g, FIRST], offset + groups[g, END]
        box, middle, size2 = take_targets(tree.x, begin, end, at, total)
        sums[:] = 0.0
        sources, work = add_sources(tree, law, (begin, end), box, middle, size2, at, total, far, sums)
        add_lanes(sums)
        for t in range(end - begin):
            ax, ay, az, depth = evaluate(
                sums, (at[0][t] - middle[0], at[1][t] - middle[1], at[2][t] - middle[2]), sums[COEFFICIENTS:]
            )
            row = result[groups[g, FIRST] + t]
            row[0], row[1], row[2] = total[0][t] + ax, total[1][t] + ay, total[2][t] + az
            row[POTENTIAL], row[WORK] = total[POTENTIAL][t] + depth, work
        interactions += sources * (end - begin)
    return result, interactions


@walking
def take_targets(x, begin, end, at, total):
    """Copy the targets x[begin:end] to `at`, the last one repeated to fill a block, with zeros in their sums.

    Returns their bounding box (lowest, highest corner), its middle, and the square of their largest distance from the middle.
    """
    lx, ly, lz = x[begin, 0], x[begin, 1], x[begin, 2]
    hx, hy, hz = lx, ly, lz
    for p in range(begin, end):
        lx, ly, lz = min(lx, x[p, 0]), min(ly, x[p, 1]), min(lz, x[p, 2])
        hx, hy, hz = max(hx, x[p, 0]), max(hy, x[p, 1]), max(hz, x[p, 2])
    mx, my, mz, size2 = 0.5 * (lx + hx), 0.5 * (ly + hy), 0.5 * (lz + hz), 0.0
    for t in range(blocks_of(begin, end) * BLOCK):
        p = min(begin + t, end - 1)
        at[0][t], at[1][t], at[2][t] = x[p, 0], x[p, 1], x[p, 2]
        total[0][t], total[1][t], total[2][t], total[POTENTIAL][t] = 0.0, 0.0, 0.0, 0.0
        size2 = max(size2, (x[p, 0] - mx) ** 2 + (x[p, 1] - my) ** 2 + (x[p, 2] - mz) ** 2)
    return (lx, ly, lz, hx, hy, hz), (mx, my, mz), size2


@lean_inner
def blocks_of(begin, end):
    """How many blocks the targets begin ... end fill."""
    return (end - begin + BLOCK - 1) // BLOCK


@walking
def add_sources(tree, law, group, box, middle, size2, at, total, far, sums):
    """All sources act on one group, the rows group[0] ... group[1] of the tree: on its targets or on its expansion.

    Returns how many sources there were, and the work of each target.
    """
    (skip, first, count, cells, x, mass), (angle, softening2, quadrupoles) = tree, law
    (begin, end), (lx, ly, lz, hx, hy, hz), (mx, my, mz) = group, box, middle
    blocks, angle2, small2 = blocks_of(begin, end), angle * angle, (SMALL * angle) ** 2
    expanded, on_targets, near, visits = 0, 0, 0, 0
    node = 0
    while node < len(skip):
        visits += 1
        cx, cy, cz = cells[node, CENTER], cells[node, CENTER + 1], cells[node, CENTER + 2]
        if not is_far(lx, ly, lz, hx, hy, hz, cx, cy, cz, cells[node, RADIUS], angle2):
            if count[node]:
                last = first[node] + count[node]
                own = begin if begin <= first[node] < end else last
                add_particles(at, blocks, own, x, mass, first[node], last, softening2, total)
                near += count[node]
            node += 1
            continue
        u, v, w = mx - cx, my - cy, mz - cz
        if size2 < small2 * (u * u + v * v + w * w):
            enter_cell(far, expanded % CELLS, u, v, w, cells[node], quadrupoles)
            expanded += 1
            if expanded % CELLS == 0:
                expand(far, CELLS // LANES, softening2, sums)
        else:
            add_cell(at, blocks, cells[node], softening2, quadrupoles, total)
            on_targets += 1
        node = skip[node]
    expand(far, fill_lanes(far, expanded % CELLS), softening2, sums)
    work = (FAR if quadrupoles else NEAR) * on_targets + NEAR * near + (VISIT * visits + EXPANDED * expanded) / (end - begin)
    return expanded + on_targets + near, work
