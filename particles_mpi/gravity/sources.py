"""Particles and cells that act on each target of a group, in float64 or in float32.

A cell acts by mass and quadrupole: with the vector u from target to centre of mass, rho^2 = u^2 + eps^2, second moments S,
trace T, Q = u.S.u

    potential = -(M/rho + (3 Q/rho^2 - T)/(2 rho^3)),     a = u (M/rho^3 + (15 Q/(2 rho^2) - 3 T/2)/rho^5) - 3 S u/rho^5,

which is the Taylor expansion of -m/rho to second order, with softening too; or by mass alone, as a particle does.

Sources wait in lists, and those of a full list act one after the other on all targets. Their sum is then added to the total in
float64, so that float32 never adds up more than LIST numbers.
"""

from typing import Any, NamedTuple

import numpy as np

from particles_mpi.gravity.octree import CENTER, MASS, RADIUS, SECOND
from particles_mpi.gravity.powers import formula, inverse_root, pull
from particles_mpi.kernels.jit import as_kind, fma, inner, lean_inner, wide
from particles_mpi.particles import Array

BLOCK_TARGETS = 8  # the number of targets of a group is rounded up to a multiple of it
LIST = 64  # sources that act in one go
POTENTIAL = 3  # of the columns of a total: acceleration (3), potential

adding = inner(_nrt=False, error_model="numpy")


class Units(NamedTuple):
    """How numbers of a kind, float64 or float32, are stored: positions as length (x - origin), masses as mass m.

    Both factors are powers of two.
    """

    origin: Any  # (3,)
    length: Any
    mass: Any
    softening2: Any  # eps^2 in these units, as a number of this kind


class SourceLists(NamedTuple):
    """Arrays of one kind of numbers, which all groups use, one after the other."""

    at: Any  # three arrays: coordinates of the targets, in whole blocks
    sums: Any  # four arrays: acceleration and potential of each target by the sources of one list
    points: Array  # (LIST, 4) particles that wait to act: places, masses
    own: Array  # (LIST,) the number of the target that such a particle is, if it is one of them
    cells: Array  # (LIST, RADIUS) cells that wait to act: mass, place, second moments


@inner
def new_lists(most, kind):
    """SourceLists for groups of up to `most` targets, in numbers of this kind: np.float64 or np.float32."""
    at = np.empty(most, kind), np.empty(most, kind), np.empty(most, kind)
    sums = np.empty(most, kind), np.empty(most, kind), np.empty(most, kind), np.empty(most, kind)
    return SourceLists(at, sums, np.empty((LIST, 4), kind), np.empty(LIST, np.int64), np.empty((LIST, RADIUS), kind))


@adding
def begin_group(x, group, units, lists):
    """The targets of a group, rows of x (n, 3), in these units, the last one repeated to fill the blocks."""
    (ox, oy, oz), length = units.origin, units.length
    at, sums = lists.at, lists.sums
    for t in range(group.blocks * BLOCK_TARGETS):
        p = min(group.begin + t, group.end - 1)
        at[0][t], at[1][t], at[2][t] = length * (x[p, 0] - ox), length * (x[p, 1] - oy), length * (x[p, 2] - oz)
        sums[0][t], sums[1][t], sums[2][t], sums[POTENTIAL][t] = 0.0, 0.0, 0.0, 0.0


@formula
def add_particle(at, t, own, px, py, pz, mass, softening2, sums):
    """Add to column t of sums (4, .) what a particle at (px, py, pz) does to the target at[:, t]; nothing if t is `own`."""
    u, v, w = px - at[0][t], py - at[1][t], pz - at[2][t]
    r2 = fma(u, u, fma(v, v, fma(w, w, softening2)))
    f = pull(mass, r2) if t != own else as_kind(0.0, r2)
    sums[0][t] = fma(f, u, sums[0][t])
    sums[1][t] = fma(f, v, sums[1][t])
    sums[2][t] = fma(f, w, sums[2][t])
    sums[POTENTIAL][t] = fma(-f, r2, sums[POTENTIAL][t])


@formula
def add_quadrupole(at, t, cx, cy, cz, mass, second, softening2, sums):
    """The same for a cell with its centre of mass at (cx, cy, cz), its mass and its second moments (6)."""
    u, v, w = cx - at[0][t], cy - at[1][t], cz - at[2][t]
    xx, xy, xz, yy, yz, zz = second
    q = inverse_root(fma(u, u, fma(v, v, fma(w, w, softening2))))
    q2 = q * q
    q3 = q * q2
    q5 = as_kind(3.0, q) * q3 * q2
    su = fma(xx, u, fma(xy, v, xz * w))
    sv = fma(xy, u, fma(yy, v, yz * w))
    sw = fma(xz, u, fma(yz, v, zz * w))
    bulge = q2 * fma(su, u, fma(sv, v, sw * w))  # Q/rho^2
    trace = as_kind(0.5, q) * (xx + yy + zz)
    f = fma(mass, q3, q5 * fma(as_kind(2.5, q), bulge, -trace))
    sums[0][t] = fma(f, u, fma(-q5, su, sums[0][t]))
    sums[1][t] = fma(f, v, fma(-q5, sv, sums[1][t]))
    sums[2][t] = fma(f, w, fma(-q5, sw, sums[2][t]))
    sums[POTENTIAL][t] -= fma(mass, q, q3 * fma(as_kind(1.5, q), bulge, -trace))


@lean_inner
def enter_point(units, lists, n, x, mass, own):
    """Put a particle into the list as number n; `own`: its number among the targets, if it is one. Returns how many wait then."""
    (ox, oy, oz), length, unit, _ = units
    point, lists.own[n] = lists.points[n], own
    point[0], point[1], point[2], point[3] = length * (x[0] - ox), length * (x[1] - oy), length * (x[2] - oz), unit * mass
    return n + 1


@lean_inner
def enter_near_cell(units, lists, n, cell):
    """Put a cell (WIDTH,) into the list as number n. Returns how many wait then."""
    (ox, oy, oz), length, unit, _ = units
    near = lists.cells[n]
    near[MASS], near[CENTER] = unit * cell[MASS], length * (cell[CENTER] - ox)
    near[CENTER + 1], near[CENTER + 2] = length * (cell[CENTER + 1] - oy), length * (cell[CENTER + 2] - oz)
    for e in range(SECOND, RADIUS):
        near[e] = unit * (length * length * cell[e])
    return n + 1


@adding
def add_points(units, lists, n, blocks, total):
    """Let the first n particles of the list act on the targets, which fill so many blocks. Returns 0: none wait then."""
    wide()
    (at, sums, points, own, _), softening2 = lists, units.softening2
    for p in range(n):
        x, y, z, mass, number = points[p, 0], points[p, 1], points[p, 2], points[p, 3], own[p]
        for t in range(blocks * BLOCK_TARGETS):
            add_particle(at, t, number, x, y, z, mass, softening2, sums)
    add_sums(units, blocks, sums, total)
    return 0


@adding
def add_cells(units, lists, n, blocks, total):
    """Let the first n cells of the list act on the targets. Returns 0: none wait then."""
    wide()
    (at, sums, _, _, cells), softening2 = lists, units.softening2
    for c in range(n):
        mass, x, y, z = cells[c, MASS], cells[c, CENTER], cells[c, CENTER + 1], cells[c, CENTER + 2]
        xx, xy, xz = cells[c, SECOND], cells[c, SECOND + 1], cells[c, SECOND + 2]
        yy, yz, zz = cells[c, SECOND + 3], cells[c, SECOND + 4], cells[c, SECOND + 5]
        for t in range(blocks * BLOCK_TARGETS):
            add_quadrupole(at, t, x, y, z, mass, (xx, xy, xz, yy, yz, zz), softening2, sums)
    add_sums(units, blocks, sums, total)
    return 0


@formula
def add_sums(units, blocks, sums, total):
    """Add the sums of a list to the total, in float64 and its units, and set them to 0."""
    depth = units.length / units.mass
    strength = units.length * depth
    for t in range(blocks * BLOCK_TARGETS):
        total[0][t] += strength * sums[0][t]
        total[1][t] += strength * sums[1][t]
        total[2][t] += strength * sums[2][t]
        total[POTENTIAL][t] += depth * sums[POTENTIAL][t]
        sums[0][t], sums[1][t], sums[2][t], sums[POTENTIAL][t] = 0.0, 0.0, 0.0, 0.0
