"""Walking the tree: each group of targets meets the cells that are far from it and the particles that are near, and adds them up.

A cell is far from a group if it passes the opening test `is_far` against the group's bounding box. With an opening angle of at
most 1 no cell is far from a particle of its own. Far cells act by mass and quadrupole, or by mass alone (`sources`). Where a
group is small as seen from a cell, the cell enters the group's own expansion (`expansion`), which all its targets share.

A vector holds twice as many float32 as float64, and their round-off, 1e-7 of a force, is far below what the tree leaves out
unless the opening angle is small. So what is not close to a group acts on it in float32, with the middle of the group as origin:
no distance is then so small that the round-off of two places would matter. What is close acts in float64.

Sources act in the order of the tree, those of either kind of numbers; the cells of the expansion in CELL_LANES sums. So the order
of every sum is the tree's: it depends neither on the ranks nor on the vectors of a processor.
"""

from math import frexp, ldexp, sqrt
from typing import Any, NamedTuple

import numpy as np

from particles_mpi.gravity.expansion import CELL_LANES, CELLS, COEFFICIENTS, FAR_WIDTH, add_lanes, enter_cell, evaluate, expand
from particles_mpi.gravity.octree import CENTER, END, FIRST, MASS, RADIUS, distance2, is_far
from particles_mpi.gravity.sources import (
    BLOCK_TARGETS,
    LIST,
    POTENTIAL,
    SourceLists,
    Units,
    add_cells,
    add_points,
    adding,
    begin_group,
    enter_near_cell,
    enter_point,
    new_lists,
)
from particles_mpi.kernels.jit import kernel, prefetch
from particles_mpi.particles import Array

# A cell enters a group's expansion if the radius of the group is less than LARGEST of the distance r, and if the first term that
# the expansion leaves out, M/r^2 (radius/r)^4, is less than (SMALL * opening angle)^4 of the sum of M/r^2 over all cells.
# That sum is taken with the square COARSE2 of an opening angle.
LARGEST, SMALL, COARSE2 = 0.5, 0.1, 4.0
# Float32 from the opening angle SINGLE on, for sources further from the box around a group than BESIDE radii of the group; not
# for groups below TINY of the whole tree, where powers of distances would leave the range of float32.
SINGLE, BESIDE, TINY = 0.1, 0.05, 1e-6
WORK, RESULT = POTENTIAL + 1, POTENTIAL + 2  # columns of a result: acceleration (3), potential, work; and how many these are
# Work, in units of one particle acting on one target in float64: a far quadrupole for a target, a near particle for a target, a
# cell of the expansion for a group, and a node that a group visits. Ranks get equal shares of it.
FAR, NEAR, EXPANDED, VISIT = 0.85, 0.5, 5.0, 12.0


class Nodes(NamedTuple):
    """The nodes of a tree in preorder, and the particles in its leaves."""

    skip: Array  # (nodes,) the first node that does not belong to the cell
    first: Array  # (nodes,) the first row of a leaf
    particle_count: Array  # (nodes,) rows of a leaf; 0 for cells that are divided, or whose particles are not on this rank
    cells: Array  # (nodes, WIDTH) moments
    x: Array  # (rows, 3) positions
    mass: Array  # (rows,)


class Law(NamedTuple):
    """The parameters with which cells and particles act."""

    angle: float  # opening angle
    softening2: float  # eps^2
    quadrupoles: bool  # do far cells act by their second moments too?


class Group(NamedTuple):
    """Targets that have one list of sources."""

    begin: Any  # the first row of the tree that belongs to it
    end: Any  # and the first beyond
    blocks: Any  # that its targets fill
    box: Any  # (6,) lowest and highest corner of the box that bounds it
    middle: Any  # (3,) of the box
    size2: Any  # the square of the largest distance of a target from the middle


class Room(NamedTuple):
    """Memory that all groups use, one after the other."""

    double: SourceLists  # in float64, for sources that are close
    single: SourceLists  # in float32, for all others
    total: Any  # four arrays in float64: acceleration and potential of each target
    far: Array  # (CELLS / CELL_LANES, FAR_WIDTH, CELL_LANES) float32: cells that wait for the expansion
    sums: Array  # (COEFFICIENTS CELL_LANES,) float32: of the expansion
    coefficients: Array  # (2 COEFFICIENTS,) those of the expansion, and room for `evaluate`


@kernel
def walk(tree, groups, offset, law):
    """Acceleration, potential and work for G = 1, (rows, RESULT), of the targets; and the number of interactions.

    `groups` (g, 2): FIRST and END row of each among the targets, which are the rows of the tree from `offset` on.
    """
    result, interactions, most = np.zeros((groups[-1, END] if len(groups) else 0, RESULT)), 0, np.int64(0)
    for g in range(len(groups)):
        most = max(most, groups[g, END] - groups[g, FIRST] + BLOCK_TARGETS)
    total = np.empty(most), np.empty(most), np.empty(most), np.empty(most)
    far = np.empty((CELLS // CELL_LANES, FAR_WIDTH, CELL_LANES), np.float32)
    sums = np.empty(COEFFICIENTS * CELL_LANES, np.float32)
    room = Room(new_lists(most, np.float64), new_lists(most, np.float32), total, far, sums, np.empty(2 * COEFFICIENTS))
    mass = ldexp(1.0, -frexp(tree.cells[0, MASS])[1])
    for g in range(len(groups)):
        group = group_of(tree.x, offset + groups[g, FIRST], offset + groups[g, END])
        double = Units((0.0, 0.0, 0.0), 1.0, 1.0, law.softening2)
        length = ldexp(1.0, -frexp(max(sqrt(group.size2), TINY))[1])
        single = Units(group.middle, length, mass, np.float32(length * length * law.softening2))
        begin_group(tree.x, group, double, room.double)
        begin_group(tree.x, group, single, room.single)
        for k in range(4):
            total[k][: group.blocks * BLOCK_TARGETS] = 0.0
        sums[:] = 0.0
        sources, work = add_sources(tree, law, group, double, single, room)
        give_results(tree.x, group, single, room, work, result[groups[g, FIRST] : groups[g, END]])
        interactions += sources * (group.end - group.begin)
    return result, interactions


@adding
def group_of(x, begin, end):
    """The group of targets x[begin:end]."""
    lx, ly, lz = x[begin, 0], x[begin, 1], x[begin, 2]
    hx, hy, hz = lx, ly, lz
    for p in range(begin, end):
        lx, ly, lz = min(lx, x[p, 0]), min(ly, x[p, 1]), min(lz, x[p, 2])
        hx, hy, hz = max(hx, x[p, 0]), max(hy, x[p, 1]), max(hz, x[p, 2])
    mx, my, mz, size2 = 0.5 * (lx + hx), 0.5 * (ly + hy), 0.5 * (lz + hz), 0.0
    for p in range(begin, end):
        size2 = max(size2, (x[p, 0] - mx) ** 2 + (x[p, 1] - my) ** 2 + (x[p, 2] - mz) ** 2)
    return Group(begin, end, (end - begin + BLOCK_TARGETS - 1) // BLOCK_TARGETS, (lx, ly, lz, hx, hy, hz), (mx, my, mz), size2)


@adding
def give_results(x, group, units, room, work, rows):
    """Return the results of the targets of a group: acceleration, potential, work (targets, RESULT), from lists and expansion."""
    (mx, my, mz), length, mass, _ = units
    total, coefficients = room.total, room.coefficients
    add_lanes(room.sums, coefficients)
    depth_unit = length / mass
    unit = length * depth_unit
    for t in range(len(rows)):
        p = group.begin + t
        a = length * (x[p, 0] - mx), length * (x[p, 1] - my), length * (x[p, 2] - mz)
        ax, ay, az, depth = evaluate(coefficients, a, coefficients[COEFFICIENTS:])
        rows[t, 0], rows[t, 1], rows[t, 2] = total[0][t] + unit * ax, total[1][t] + unit * ay, total[2][t] + unit * az
        rows[t, POTENTIAL], rows[t, WORK] = total[POTENTIAL][t] + depth_unit * depth, work


@adding
def strength(tree, group):
    """The sum of M/r^2 over all cells but the group's own, as seen from its middle, by so wide an angle that they are few."""
    (skip, first, count, cells, _, _), (lx, ly, lz, hx, hy, hz), (mx, my, mz) = tree, group.box, group.middle
    node, total = 0, 0.0
    while node < len(skip):
        cx, cy, cz = cells[node, CENTER], cells[node, CENTER + 1], cells[node, CENTER + 2]
        far = is_far(distance2(lx, ly, lz, hx, hy, hz, cx, cy, cz), cells[node, RADIUS], COARSE2)
        if far or (count[node] and not group.begin <= first[node] < group.end):
            u, v, w = mx - cx, my - cy, mz - cz
            total += cells[node, MASS] / max(u * u + v * v + w * w, group.size2)
        node = skip[node] if far else node + 1
    return total


@adding
def add_sources(tree, law, group, double, single, room):
    """All sources act on a group: on its targets, or on its expansion if what that leaves out of M/r^2 is below the limit.

    `double`, `single`: the Units of either kind of numbers. Returns how many sources there were, and the work of each target.
    """
    (skip, first, count, cells, x, mass), (angle, _, quadrupoles) = tree, law
    begin, end, blocks, (lx, ly, lz, hx, hy, hz), (mx, my, mz), size2 = group
    angle2, size4, smallest2, close2, limit = angle * angle, size2 * size2, size2 / LARGEST**2, np.inf, -1.0
    if angle >= SINGLE and size2 > TINY * TINY:
        close2, limit = BESIDE * BESIDE * size2, (SMALL * angle) ** 4 * strength(tree, group)
    length, moment_unit = single.length, single.length * single.length * single.mass if quadrupoles else 0.0
    double_points = double_cells = single_points = single_cells = far_cells = np.int64(0)  # that wait
    expanded, on_targets, near, visits = 0, 0, 0, 0
    node = 0
    while node < len(skip):
        visits += 1
        prefetch(cells, skip[node])  # where the walk goes on if this one is far
        cell = cells[node]
        u, v, w = mx - cell[CENTER], my - cell[CENTER + 1], mz - cell[CENTER + 2]
        d2, apart2 = u * u + v * v + w * w, distance2(lx, ly, lz, hx, hy, hz, cell[CENTER], cell[CENTER + 1], cell[CENTER + 2])
        far = is_far(apart2, cell[RADIUS], angle2)
        if far and d2 > smallest2 and cell[MASS] * size4 <= limit * (d2 * d2 * d2):
            waiting = enter_cell(room.far, far_cells, (length * u, length * v, length * w), cell, single.mass, moment_unit)
            far_cells = waiting if waiting < CELLS else expand(room.far, waiting, single.softening2, room.sums)
            expanded += 1
        elif far and quadrupoles:
            if apart2 > close2:
                waiting = enter_near_cell(single, room.single, single_cells, cell)
                single_cells = waiting if waiting < LIST else add_cells(single, room.single, waiting, blocks, room.total)
            else:
                waiting = enter_near_cell(double, room.double, double_cells, cell)
                double_cells = waiting if waiting < LIST else add_cells(double, room.double, waiting, blocks, room.total)
            on_targets += 1
        else:
            for p in range(first[node], first[node] + (1 if far else count[node])):
                place, m, own = (cell[CENTER : CENTER + 3], cell[MASS], -1) if far else (x[p], mass[p], p - begin)
                if distance2(lx, ly, lz, hx, hy, hz, place[0], place[1], place[2]) > close2:
                    waiting = enter_point(single, room.single, single_points, place, m, own)
                    single_points = waiting if waiting < LIST else add_points(single, room.single, waiting, blocks, room.total)
                else:
                    waiting = enter_point(double, room.double, double_points, place, m, own)
                    double_points = waiting if waiting < LIST else add_points(double, room.double, waiting, blocks, room.total)
                near += 1
        node = skip[node] if far else node + 1
    add_points(double, room.double, double_points, blocks, room.total)
    add_cells(double, room.double, double_cells, blocks, room.total)
    add_points(single, room.single, single_points, blocks, room.total)
    add_cells(single, room.single, single_cells, blocks, room.total)
    expand(room.far, far_cells, single.softening2, room.sums)
    work = FAR * on_targets + NEAR * near + (VISIT * visits + EXPANDED * expanded) / (end - begin)
    return expanded + on_targets + near, work
