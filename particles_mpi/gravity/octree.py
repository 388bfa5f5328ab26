"""A tree of cells over particles: halved boxes, the same for the same particles whatever the ranks. Plain arrays.

Particles stand in the order of their Morton keys: the bits of their coordinates in the box of all, interleaved. A cell is all
that share the first bits, `d` of them a level; a cell of at most LEAF particles is not divided further. Nodes stand in
preorder (a cell before its parts), so that `skip`, the node after all parts of a cell, is all that a walk needs.
J. Barnes and P. Hut, Nature 324, 446 (1986); keys: M. Warren and J. Salmon, Supercomputing '93, 12.

Vectors have three components here in any dimension: those beyond it are 0, which changes no bit of any sum.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from particles_mpi.kernels.jit import inner, kernel

LEAF = 32  # particles of a cell that is not divided
GROUP = 128  # particles of a cell that looks for its sources together
DEEPEST = 31  # levels at most

# A row of `cells`: mass, centre of mass, second moments about it (xx, xy, xz, yy, yz, zz), and a radius about it that holds all.
MASS, CENTER, SECOND, RADIUS, WIDTH = 0, 1, 4, 10, 11
SAFE = 1.0 + 2.0**-40  # more than rounding can take from a radius


def levels(dimension: int) -> int:
    """How often space can be halved: a key has 63 bits."""
    return min(63 // dimension, DEEPEST)


@kernel
def morton(x, lower, scale, d):
    """Keys (n,) of positions x (n, 3) in the cube at `lower` whose side is 2^levels / scale."""
    keys = np.empty(len(x), np.int64)
    deep = min(63 // d, DEEPEST)
    most = np.float64((np.int64(1) << deep) - 1)
    for i in range(len(x)):
        key = np.int64(0)
        for k in range(d):
            place = np.int64(min(max((x[i, k] - lower[k]) * scale, 0.0), most))
            for bit in range(deep):
                key |= ((place >> bit) & 1) << (bit * d + d - 1 - k)
        keys[i] = key
    return keys


@kernel
def sort_ties(keys, ids, order):
    """Where keys[order] are equal, put `order` into the order of ids. In place."""
    for i in range(1, len(order)):
        row, j = order[i], i
        while j > 0 and keys[order[j - 1]] == keys[row] and ids[order[j - 1]] > ids[row]:
            order[j] = order[j - 1]
            j -= 1
        order[j] = row


@kernel
def divide(keys, d, low, high):
    """The cells of sorted `keys` that lie within the keys low ... high of this rank, in preorder.

    Cells that reach beyond belong to several ranks and are left out; the largest that do not are the branches.
    Gives level (n,) and number of particles of each node (0 if it is divided), groups (first row, last row + 1), and
    branches (node, first key).
    """
    deep = min(63 // d, DEEPEST)
    nodes, groups, branches = np.empty((256, 2), np.int64), np.empty((256, 2), np.int64), np.empty((256, 2), np.int64)
    stack = np.empty((256, 5), np.int64)  # first row, last row + 1, level, lies in a branch, lies in a group
    made, grouped, top = 0, 0, 0
    roots = 0
    if len(keys):
        stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3], stack[0, 4] = 0, len(keys), 0, 0, 0
        top = 1
    while top:
        top -= 1
        first, last, level, inside, in_group = stack[top]
        shift = d * (deep - level)
        begin = (keys[first] >> shift) << shift if shift < 63 else np.int64(0)
        whole = inside or (begin >= low and begin + ((np.int64(1) << shift) - 1) <= high)
        leaf = whole and (last - first <= LEAF or level == deep)
        if whole:
            if made == len(nodes):
                nodes = longer(nodes)
            nodes[made, 0], nodes[made, 1] = level, last - first if leaf else 0
            if not inside:
                if roots == len(branches):
                    branches = longer(branches)
                branches[roots, 0], branches[roots, 1] = made, begin
                roots += 1
            if not in_group and (leaf or last - first <= GROUP):
                if grouped == len(groups):
                    groups = longer(groups)
                groups[grouped, 0], groups[grouped, 1] = first, last
                grouped, in_group = grouped + 1, 1
            made += 1
        end = first if leaf else last
        while end > first:  # the last part first, so that the first is taken first
            part = keys[end - 1] >> (shift - d)
            begin_row, beyond = first, end - 1
            while begin_row < beyond:
                middle = (begin_row + beyond) // 2
                if keys[middle] >> (shift - d) < part:
                    begin_row = middle + 1
                else:
                    beyond = middle
            stack[top, 0], stack[top, 1], stack[top, 2] = begin_row, end, level + 1
            stack[top, 3], stack[top, 4] = 1 if whole else 0, in_group
            top += 1
            end = begin_row
    return nodes[:made, 0].copy(), nodes[:made, 1].copy(), groups[:grouped].copy(), branches[:roots].copy()


@inner
def longer(rows):
    """The same rows with as much room again."""
    new = np.empty((2 * len(rows), rows.shape[1]), rows.dtype)
    for r in range(len(rows)):
        for k in range(rows.shape[1]):
            new[r, k] = rows[r, k]
    return new


@kernel
def skips(level, roots):
    """The node after all parts of each node, from the levels of nodes in preorder; `roots`: the nodes where trees begin."""
    skip = np.empty(len(level), np.int64)
    for tree in range(len(roots) - 1, -1, -1):
        end = roots[tree + 1] if tree + 1 < len(roots) else len(level)
        for i in range(end - 1, roots[tree] - 1, -1):
            j = i + 1
            while j < end and level[j] > level[i]:
                j = skip[j]
            skip[i] = j
    return skip


@kernel
def moments(skip, count, x, mass):
    """cells (n, WIDTH) and bounds (n, 6), lowest and highest corner, of a rank's own nodes with particles x (., 3), mass."""
    n = len(skip)
    cells, bounds = np.zeros((n, WIDTH)), np.empty((n, 6))
    last = len(x)
    for i in range(n - 1, -1, -1):
        if count[i]:
            of_particles(cells[i], bounds[i], x[last - count[i] : last], mass[last - count[i] : last])
            last -= count[i]
        else:
            of_parts(i, skip, cells, bounds)
    return cells, bounds


@inner
def of_particles(cell, bound, x, mass):
    """Moments of a leaf."""
    for k in range(3):
        bound[k], bound[3 + k] = x[0, k], x[0, k]
    for p in range(len(x)):
        cell[MASS] += mass[p]
        for k in range(3):
            cell[CENTER + k] += mass[p] * x[p, k]
            bound[k], bound[3 + k] = min(bound[k], x[p, k]), max(bound[3 + k], x[p, k])
    center_of_mass(cell, bound)
    for p in range(len(x)):
        r2 = add_second(cell, x[p, 0] - cell[1], x[p, 1] - cell[2], x[p, 2] - cell[3], mass[p])
        cell[RADIUS] = max(cell[RADIUS], sqrt(r2) * SAFE)


@inner
def of_parts(i, skip, cells, bounds):
    """Moments of node i from those of its parts, in their order."""
    cell, bound = cells[i], bounds[i]
    for e in range(len(cell)):
        cell[e] = 0.0
    for k in range(6):
        bound[k] = bounds[i + 1, k]
    part = i + 1
    while part < skip[i]:
        cell[MASS] += cells[part, MASS]
        for k in range(3):
            cell[CENTER + k] += cells[part, MASS] * cells[part, CENTER + k]
            bound[k], bound[3 + k] = min(bound[k], bounds[part, k]), max(bound[3 + k], bounds[part, 3 + k])
        part = skip[part]
    center_of_mass(cell, bound)
    part = i + 1
    while part < skip[i]:
        dx, dy, dz = cells[part, 1] - cell[1], cells[part, 2] - cell[2], cells[part, 3] - cell[3]
        r2 = add_second(cell, dx, dy, dz, cells[part, MASS])
        for e in range(6):
            cell[SECOND + e] += cells[part, SECOND + e]
        cell[RADIUS] = max(cell[RADIUS], (sqrt(r2) + cells[part, RADIUS]) * SAFE)
        part = skip[part]
    corner2 = 0.0
    for k in range(3):
        corner2 += max(cell[CENTER + k] - bound[k], bound[3 + k] - cell[CENTER + k]) ** 2
    cell[RADIUS] = min(cell[RADIUS], sqrt(corner2) * SAFE)


@inner
def center_of_mass(cell, bound):
    """From the sum of mass times position; the middle where there is no mass."""
    for k in range(3):
        middle = 0.5 * (bound[k] + bound[3 + k])
        cell[CENTER + k] = cell[CENTER + k] / cell[MASS] if cell[MASS] > 0.0 else middle


@inner
def add_second(cell, dx, dy, dz, mass):
    """Second moments of a mass at (dx, dy, dz) from the centre; returns the distance squared."""
    cell[SECOND] += mass * dx * dx
    cell[SECOND + 1] += mass * dx * dy
    cell[SECOND + 2] += mass * dx * dz
    cell[SECOND + 3] += mass * dy * dy
    cell[SECOND + 4] += mass * dy * dz
    cell[SECOND + 5] += mass * dz * dz
    return dx * dx + dy * dy + dz * dz
