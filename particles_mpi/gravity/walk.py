"""Walking the tree: each group of targets meets the cells that are far from it and the particles that are near, and adds them up.

A cell is far from a group if it passes the opening test `is_far` against the group's bounding box. With an opening angle of at
most 1 no cell is far from a particle of its own. Far cells act by mass and quadrupole: with the vector u from target to centre
of mass, rho^2 = u^2 + eps^2, second moments S, trace T, Q = u.S.u

    potential = -(M/rho + (3 Q/rho^2 - T)/(2 rho^3)),     a = u (M/rho^3 + (15 Q/(2 rho^2) - 3 T/2)/rho^5) - 3 S u/rho^5,

which is the Taylor expansion of -m/rho to second order, with softening too; or by mass alone, as a particle does. Where a group
is small as seen from a cell, the cell enters the group's own expansion (`expansion`), which all its targets share.

Sources act one after the other, in the order of the tree, on all targets of a group; the cells of the expansion in LANES sums.
So the order of every sum is the tree's: it depends neither on the ranks nor on the vectors of a processor.
"""

from typing import Any, NamedTuple

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
# A cell enters a group's expansion if the radius of the group is less than LARGEST of the distance r, and if the first term that
# the expansion leaves out, M/r^2 (radius/r)^4, is less than (SMALL * opening angle)^4 of the sum of M/r^2 over all cells.
LARGEST, SMALL = 0.5, 0.1
POTENTIAL, WORK, RESULT = 3, 4, 5  # columns of a result: acceleration (3), potential, work; and how many these are
# Work, in units of one particle acting on one target: a far quadrupole for a target, a near particle for a target, a cell of the
# expansion for a group, and a node that a group visits. Ranks get equal shares of it.
FAR, NEAR, EXPANDED, VISIT = 1.7, 1.0, 10.0, 12.0

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


class Group(NamedTuple):
    """Targets that have one list of sources."""

    begin: Any  # the first row of the tree that belongs to it
    end: Any  # and the first beyond
    box: Any  # (6,) lowest and highest corner of the box that bounds it
    middle: Any  # (3,) of the box
    size2: Any  # the square of the largest distance of a target from the middle


class Room(NamedTuple):
    """Arrays that all groups use, one after the other."""

    at: Any  # three arrays: coordinates of the targets, in whole blocks
    total: Any  # four arrays: acceleration and potential of each target
    far: Array  # (CELLS / LANES, FAR_WIDTH, LANES) cells that wait for the expansion
    sums: Array  # (COEFFICIENTS LANES,) of the expansion


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
    room = Room(at, total, np.empty((CELLS // LANES, FAR_WIDTH, LANES)), np.empty(COEFFICIENTS * LANES))
    for g in range(len(groups)):
        group = take_targets(tree.x, offset + groups[g, FIRST], offset + groups[g, END], room)
        limit = (SMALL * law.angle) ** 4 * strength(tree, group)
        sources, work = add_sources(tree, law, group, limit, room)
        give_results(group, room, work, result[groups[g, FIRST] : groups[g, END]])
        interactions += sources * (group.end - group.begin)
    return result, interactions


@walking
def take_targets(x, begin, end, room):
    """The group of targets x[begin:end], copied to the room, with sums of 0; the last one is repeated to fill a block."""
    at, total, _, sums = room
    sums[:] = 0.0
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
    return Group(begin, end, (lx, ly, lz, hx, hy, hz), (mx, my, mz), size2)


@lean_inner
def blocks_of(begin, end):
    """How many blocks the targets begin ... end fill."""
    return (end - begin + BLOCK - 1) // BLOCK


@walking
def give_results(group, room, work, result):
    """What the targets of a group found and what their expansion gives: acceleration, potential, work (targets, RESULT)."""
    (_, _, _, (mx, my, mz), _), (at, total, _, sums) = group, room
    add_lanes(sums)
    for t in range(len(result)):
        x, y, z, depth = evaluate(sums, (at[0][t] - mx, at[1][t] - my, at[2][t] - mz), sums[COEFFICIENTS:])
        result[t, 0], result[t, 1], result[t, 2] = total[0][t] + x, total[1][t] + y, total[2][t] + z
        result[t, POTENTIAL], result[t, WORK] = total[POTENTIAL][t] + depth, work


@walking
def strength(tree, group):
    """The sum of M/r^2 over all cells but the group's own, as seen with an opening angle of 1 from its middle."""
    (skip, first, count, cells, _, _), (begin, end, (lx, ly, lz, hx, hy, hz), (mx, my, mz), size2) = tree, group
    node, total = 0, 0.0
    while node < len(skip):
        cx, cy, cz = cells[node, CENTER], cells[node, CENTER + 1], cells[node, CENTER + 2]
        far = is_far(lx, ly, lz, hx, hy, hz, cx, cy, cz, cells[node, RADIUS], 1.0)
        if far or (count[node] and not begin <= first[node] < end):
            u, v, w = mx - cx, my - cy, mz - cz
            total += cells[node, MASS] / max(u * u + v * v + w * w, size2)
        node = skip[node] if far else node + 1
    return total


@walking
def add_sources(tree, law, group, limit, room):
    """All sources act on a group: on its targets, or on its expansion if what that leaves out of M/r^2 is below the limit.

    Returns how many sources there were, and the work of each target.
    """
    (skip, first, count, cells, x, mass), (angle, softening2, quadrupoles) = tree, law
    (begin, end, (lx, ly, lz, hx, hy, hz), (mx, my, mz), size2), (at, total, far, sums) = group, room
    blocks, angle2, size4, smallest2 = blocks_of(begin, end), angle * angle, size2 * size2, size2 / LARGEST**2
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
        d2 = u * u + v * v + w * w
        if d2 > smallest2 and cells[node, MASS] * size4 <= limit * (d2 * d2 * d2):
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
