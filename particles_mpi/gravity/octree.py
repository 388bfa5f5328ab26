"""The octree (a quadtree in 2D): a cube is halved along every axis, again and again, until few particles are left in a cell.

The particles are sorted by Morton keys, which interleave the bits of their coordinates within the cube of all particles.
A cell at level l consists of all particles whose keys agree in the first l d bits, in dimension d; a cell with at most LEAF
particles, a leaf, is not divided. So the tree depends on the particles alone, and not on the ranks. Nodes are stored in
preorder, a cell before its parts: `skip[i]`, the first node that does not belong to cell i, is all that a walk needs.
J. Barnes and P. Hut, Nature 324, 446 (1986); keys: M. Warren and J. Salmon, Supercomputing '93, 12.

Vectors have three components here in every dimension; the additional ones are 0, which changes no bit of any sum.
"""

from math import sqrt

import numpy as np

from particles_mpi.kernels.jit import inner, kernel, lean_inner

LEAF = 16  # most particles in a cell that is not divided
GROUP = 192  # most particles in a group: a cell whose particles are targets with one common list of sources
DEEPEST = 31  # most levels

# Columns of `cells`, the multipole moments of a node: mass, centre of mass (3), second moments about that centre (xx, xy, xz,
# yy, yz, zz), and the radius of a sphere about it that contains all particles of the cell.
MASS, CENTER, SECOND, RADIUS, WIDTH = 0, 1, 4, 10, 11
FIRST, END = 0, 1  # columns of `groups`: first row, and last row + 1
ENLARGED = 1.0 + 2.0**-40  # enlarges a radius by more than rounding can have taken from it


@kernel
def levels(dimension):
    """How often a cell can be halved: a key has 63 bits."""
    return min(63 // dimension, DEEPEST)


@lean_inner
def distance2(lx, ly, lz, hx, hy, hz, x, y, z):
    """The square of the distance from a point to the box with lowest corner l and highest corner h; 0 inside."""
    dx, dy, dz = max(lx - x, x - hx, 0.0), max(ly - y, y - hy, 0.0), max(lz - z, z - hz, 0.0)
    return dx * dx + dy * dy + dz * dz


@lean_inner
def is_far(apart2, radius, angle2):
    """The opening test: is a cell far from a box? `apart2`: the square of the distance from its centre of mass to the box.

    It is far if `radius` < angle * distance, with angle2 = angle^2. J. Salmon and M. Warren, J. Comput. Phys. 111, 136 (1994).
    """
    return angle2 * apart2 > radius * radius


@kernel
def morton(x, lower, scale, d):
    """Morton keys (n,) of positions x (n, 3) in the cube with lowest corner `lower` and side 2^levels / scale."""
    keys = np.empty(len(x), np.int64)
    deep = levels(d)
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
    """Where keys[order] are equal, sort `order` by ids. In place."""
    for i in range(1, len(order)):
        row, j = order[i], i
        while j > 0 and keys[order[j - 1]] == keys[row] and ids[order[j - 1]] > ids[row]:
            order[j] = order[j - 1]
            j -= 1
        order[j] = row


@kernel
def divide(keys, d, low, high):
    """The cells of the sorted `keys` (n,) that lie within the range low <= key <= high of this rank, in preorder.

    Cells that extend beyond the range are shared by several ranks and are left out; the largest cells within it are the
    branches. Returns the level of each node (nodes,), its number of particles, 0 if it is divided (nodes,), the groups
    (groups, 2) as FIRST and END row, and the branches (branches, 2) as node and first key.
    """
    deep = levels(d)
    node_level: list[int] = []
    node_count: list[int] = []
    groups, branches = [], []
    stack = [(0, len(keys), 0, False, False)]  # first row, last row + 1, level, in a branch?, in a group?
    while len(stack) and len(keys):
        first, last, level, inside, in_group = stack.pop()
        shift = d * (deep - level)
        begin = (keys[first] >> shift) << shift if shift < 63 else 0
        whole = inside or (begin >= low and begin + ((np.int64(1) << shift) - 1) <= high)
        leaf = whole and (last - first <= LEAF or level == deep)
        if whole:
            if not inside:
                branches.append(len(node_level))
                branches.append(begin)
            if not in_group and (leaf or last - first <= GROUP):
                groups.append(first)
                groups.append(last)
                in_group = True
            node_level.append(level)
            node_count.append(last - first if leaf else 0)
        end = first if leaf else last
        while end > first:  # the last part goes onto the stack first, so that the first part is taken from it first
            part = keys[end - 1] >> (shift - d)
            begin_row, beyond = first, end - 1
            while begin_row < beyond:
                middle = (begin_row + beyond) // 2
                if keys[middle] >> (shift - d) < part:
                    begin_row = middle + 1
                else:
                    beyond = middle
            stack.append((begin_row, end, level + 1, whole, in_group))
            end = begin_row
    return np.array(node_level), np.array(node_count), np.array(groups).reshape(-1, 2), np.array(branches).reshape(-1, 2)


@kernel
def skips(level, roots):
    """skip (n,) from the levels (n,) of nodes in preorder; `roots`: the nodes at which separate trees begin."""
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
    """Moments (n, WIDTH) of a rank's nodes, and boxes (n, 6): lowest, highest corner; from the rows of all leaves, in order."""
    n = len(skip)
    cells, bounds = np.zeros((n, WIDTH)), np.empty((n, 6))
    last = len(x)
    for i in range(n - 1, -1, -1):
        if count[i]:
            leaf_moments(cells[i], bounds[i], x[last - count[i] : last], mass[last - count[i] : last])
            last -= count[i]
        else:
            combine_moments(i, skip, cells, bounds)
    return cells, bounds


@inner
def leaf_moments(cell, bound, x, mass):
    """Moments (WIDTH,) and bounding box (6,) of a leaf, from its particles x (p, 3), mass (p,). In place."""
    for k in range(3):
        bound[k], bound[3 + k] = x[0, k], x[0, k]
    for p in range(len(x)):
        cell[MASS] += mass[p]
        for k in range(3):
            cell[CENTER + k] += mass[p] * x[p, k]
            bound[k], bound[3 + k] = min(bound[k], x[p, k]), max(bound[3 + k], x[p, k])
    center_of_mass(cell, bound)
    for p in range(len(x)):
        r2 = add_second_moments(cell, x[p, 0] - cell[CENTER], x[p, 1] - cell[CENTER + 1], x[p, 2] - cell[CENTER + 2], mass[p])
        cell[RADIUS] = max(cell[RADIUS], sqrt(r2) * ENLARGED)


@inner
def combine_moments(i, skip, cells, bounds):
    """Moments and bounding box of node i from those of its parts, in their order. In place."""
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
        sub = cells[part]
        dx, dy, dz = sub[CENTER] - cell[CENTER], sub[CENTER + 1] - cell[CENTER + 1], sub[CENTER + 2] - cell[CENTER + 2]
        r2 = add_second_moments(cell, dx, dy, dz, sub[MASS])
        for e in range(6):
            cell[SECOND + e] += cells[part, SECOND + e]
        cell[RADIUS] = max(cell[RADIUS], (sqrt(r2) + cells[part, RADIUS]) * ENLARGED)
        part = skip[part]
    corner2 = 0.0
    for k in range(3):
        corner2 += max(cell[CENTER + k] - bound[k], bound[3 + k] - cell[CENTER + k]) ** 2
    cell[RADIUS] = min(cell[RADIUS], sqrt(corner2) * ENLARGED)


@inner
def center_of_mass(cell, bound):
    """The centre of mass from the sum of mass times position; without mass the middle of the box. In place."""
    for k in range(3):
        middle = 0.5 * (bound[k] + bound[3 + k])
        cell[CENTER + k] = cell[CENTER + k] / cell[MASS] if cell[MASS] > 0.0 else middle


@inner
def add_second_moments(cell, dx, dy, dz, mass):
    """Add the second moments of a mass at distance (dx, dy, dz) from the centre; returns the distance squared."""
    entry = SECOND
    for a, b in ((dx, dx), (dx, dy), (dx, dz), (dy, dy), (dy, dz), (dz, dz)):
        cell[entry] += mass * a * b
        entry += 1
    return dx * dx + dy * dy + dz * dz
