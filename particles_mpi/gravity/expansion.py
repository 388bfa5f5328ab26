"""Far cells act on a group of targets by one Taylor expansion about its middle.

With the vector r from a cell's centre of mass to the middle of the group, and D_n the n-th derivatives of (r^2 + eps^2)^(-1/2),
a cell of mass M and second moments S adds to the coefficient m of the expansion

    L_m = M D_m + 1/2 sum_ij S_ij D_(m+ij),

the second part where m + ij has at most ORDER axes. At a from the middle, potential = -sum_m L_m a^m/m!, and the acceleration is
the gradient of the sum. W. Dehnen, J. Comput. Phys. 179, 27 (2002).

Derivatives of all orders follow from the radial ones, g_0 = 1/rho, g_k = -(2 k - 1) g_(k-1)/rho^2, by products with r:
D_x = g_1 x, D_xy = g_2 x y, D_xx = g_2 x^2 + g_1, and so on.
"""

from itertools import product

import numpy as np

from particles_mpi.gravity.octree import MASS, SECOND
from particles_mpi.gravity.powers import formula, inverse_root
from particles_mpi.kernels.jit import as_kind, fma, inner, lean_inner, wide

ORDER = 4
CELLS = 256  # of a list that are added up at a time: they stay in the first-level cache
CELL_LANES = 16  # cells that are added up side by side: the order of the sum depends on it, not on the vectors of a processor
FAR_MASS, FAR_WIDTH = 3, 10  # rows of a list of far cells: r (3), mass, S/2 (xx, 2 xy, 2 xz, yy, 2 yz, zz)

POWERS = sorted((n for n in product(range(ORDER + 1), repeat=3) if sum(n) <= ORDER), key=lambda n: (sum(n), [-k for k in n]))
COEFFICIENTS = len(POWERS)
COLUMN_OF = {n: row for row, n in enumerate(POWERS)}


def higher(n: tuple[int, ...], axis: int, by: int = 1) -> int:
    """The number of the coefficient whose power of `axis` is that of n plus `by`; -1 if there is none."""
    return COLUMN_OF.get(tuple(power + by * (k == axis) for k, power in enumerate(n)), -1)


AXIS = np.array([int(np.argmax(np.array(n) > 0)) for n in POWERS])  # each power is a lower one times a coordinate
LOWER = np.array([higher(n, axis, -1) for n, axis in zip(POWERS, AXIS)])
OVER = np.array([1.0 / max(n[axis], 1) for n, axis in zip(POWERS, AXIS)])
HIGHER = np.array([[higher(n, axis) for axis in range(3)] for n in POWERS])
LOW = sum(sum(n) < ORDER for n in POWERS)  # coefficients that have higher ones


@lean_inner
def enter_cell(far, n, r, cell, mass_unit, moment_unit):
    """Enter a cell (WIDTH,) as number n into a list (CELLS/CELL_LANES, FAR_WIDTH, CELL_LANES); the group's middle is at r (3)
    from it.

    r is in the units of the list; `mass_unit`, `moment_unit`: what masses and second moments are to be multiplied by. Returns how
    many there are then.
    """
    entry, lane = far[n // CELL_LANES], n % CELL_LANES
    entry[0, lane], entry[1, lane], entry[2, lane], entry[FAR_MASS, lane] = r[0], r[1], r[2], mass_unit * cell[MASS]
    for e in range(6):
        half = 0.5 if e == 0 or e == 3 or e == 5 else 1.0  # the others count twice
        entry[FAR_MASS + 1 + e, lane] = half * (moment_unit * cell[SECOND + e])
    return n + 1


@formula
def contract(start, s, xx, xy, xz, yy, yz, zz):
    """start plus the sum of six products."""
    return fma(s[0], xx, fma(s[1], xy, fma(s[2], xz, fma(s[3], yy, fma(s[4], yz, fma(s[5], zz, start))))))


@formula
def add_cell(far, lane, softening2, sums):
    """The cell in one lane of a list of far cells (FAR_WIDTH, .) adds its part to the sums (COEFFICIENTS, CELL_LANES)."""
    x, y, z, mass = far[0, lane], far[1, lane], far[2, lane], far[FAR_MASS, lane]
    s = far[4, lane], far[5, lane], far[6, lane], far[7, lane], far[8, lane], far[9, lane]
    xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z
    g0 = inverse_root(softening2 + xx + yy + zz)
    q = g0 * g0
    two, three, five, seven = as_kind(2.0, q), as_kind(3.0, q), as_kind(5.0, q), as_kind(7.0, q)
    g1 = -g0 * q
    g2 = -three * g1 * q
    g3 = -five * g2 * q
    g4 = -seven * g3 * q
    px, py, pz = fma(g3, xx, g2), fma(g3, yy, g2), fma(g3, zz, g2)
    tx, ty, tz = fma(g4, xx, three * g3), fma(g4, yy, three * g3), fma(g4, zz, three * g3)
    fx, fy, fz = fma(g4, xx, g3), fma(g4, yy, g3), fma(g4, zz, g3)
    dxx, dxy, dxz, dyy, dyz, dzz = fma(g2, xx, g1), g2 * xy, g2 * xz, fma(g2, yy, g1), g2 * yz, fma(g2, zz, g1)
    xxx, xxy, xxz, xyy, xyz = x * fma(two, g2, px), y * px, z * px, x * py, x * (g3 * yz)
    xzz, yyy, yyz, yzz, zzz = x * pz, y * fma(two, g2, py), z * py, y * pz, z * fma(two, g2, pz)
    xxxx, xxxy, xxxz = fma(xx, fma(3.0, g3, tx), three * g2), xy * tx, xz * tx
    xxyy, xxyz, xxzz = fma(yy, fx, px), yz * fx, fma(zz, fx, px)
    xyyy, xyyz, xyzz, xzzz = xy * ty, xz * fy, xy * fz, xz * tz
    yyyy, yyyz, yyzz = fma(yy, fma(3.0, g3, ty), three * g2), yz * ty, fma(zz, fy, py)
    yzzz, zzzz = yz * tz, fma(zz, fma(3.0, g3, tz), three * g2)
    sums[lane] = contract(fma(mass, g0, sums[lane]), s, dxx, dxy, dxz, dyy, dyz, dzz)
    sums[CELL_LANES + lane] = contract(fma(mass, g1 * x, sums[CELL_LANES + lane]), s, xxx, xxy, xxz, xyy, xyz, xzz)
    sums[2 * CELL_LANES + lane] = contract(fma(mass, g1 * y, sums[2 * CELL_LANES + lane]), s, xxy, xyy, xyz, yyy, yyz, yzz)
    sums[3 * CELL_LANES + lane] = contract(fma(mass, g1 * z, sums[3 * CELL_LANES + lane]), s, xxz, xyz, xzz, yyz, yzz, zzz)
    sums[4 * CELL_LANES + lane] = contract(fma(mass, dxx, sums[4 * CELL_LANES + lane]), s, xxxx, xxxy, xxxz, xxyy, xxyz, xxzz)
    sums[5 * CELL_LANES + lane] = contract(fma(mass, dxy, sums[5 * CELL_LANES + lane]), s, xxxy, xxyy, xxyz, xyyy, xyyz, xyzz)
    sums[6 * CELL_LANES + lane] = contract(fma(mass, dxz, sums[6 * CELL_LANES + lane]), s, xxxz, xxyz, xxzz, xyyz, xyzz, xzzz)
    sums[7 * CELL_LANES + lane] = contract(fma(mass, dyy, sums[7 * CELL_LANES + lane]), s, xxyy, xyyy, xyyz, yyyy, yyyz, yyzz)
    sums[8 * CELL_LANES + lane] = contract(fma(mass, dyz, sums[8 * CELL_LANES + lane]), s, xxyz, xyyz, xyzz, yyyz, yyzz, yzzz)
    sums[9 * CELL_LANES + lane] = contract(fma(mass, dzz, sums[9 * CELL_LANES + lane]), s, xxzz, xyzz, xzzz, yyzz, yzzz, zzzz)
    sums[10 * CELL_LANES + lane] = fma(mass, xxx, sums[10 * CELL_LANES + lane])
    sums[11 * CELL_LANES + lane] = fma(mass, xxy, sums[11 * CELL_LANES + lane])
    sums[12 * CELL_LANES + lane] = fma(mass, xxz, sums[12 * CELL_LANES + lane])
    sums[13 * CELL_LANES + lane] = fma(mass, xyy, sums[13 * CELL_LANES + lane])
    sums[14 * CELL_LANES + lane] = fma(mass, xyz, sums[14 * CELL_LANES + lane])
    sums[15 * CELL_LANES + lane] = fma(mass, xzz, sums[15 * CELL_LANES + lane])
    sums[16 * CELL_LANES + lane] = fma(mass, yyy, sums[16 * CELL_LANES + lane])
    sums[17 * CELL_LANES + lane] = fma(mass, yyz, sums[17 * CELL_LANES + lane])
    sums[18 * CELL_LANES + lane] = fma(mass, yzz, sums[18 * CELL_LANES + lane])
    sums[19 * CELL_LANES + lane] = fma(mass, zzz, sums[19 * CELL_LANES + lane])
    sums[20 * CELL_LANES + lane] = fma(mass, xxxx, sums[20 * CELL_LANES + lane])
    sums[21 * CELL_LANES + lane] = fma(mass, xxxy, sums[21 * CELL_LANES + lane])
    sums[22 * CELL_LANES + lane] = fma(mass, xxxz, sums[22 * CELL_LANES + lane])
    sums[23 * CELL_LANES + lane] = fma(mass, xxyy, sums[23 * CELL_LANES + lane])
    sums[24 * CELL_LANES + lane] = fma(mass, xxyz, sums[24 * CELL_LANES + lane])
    sums[25 * CELL_LANES + lane] = fma(mass, xxzz, sums[25 * CELL_LANES + lane])
    sums[26 * CELL_LANES + lane] = fma(mass, xyyy, sums[26 * CELL_LANES + lane])
    sums[27 * CELL_LANES + lane] = fma(mass, xyyz, sums[27 * CELL_LANES + lane])
    sums[28 * CELL_LANES + lane] = fma(mass, xyzz, sums[28 * CELL_LANES + lane])
    sums[29 * CELL_LANES + lane] = fma(mass, xzzz, sums[29 * CELL_LANES + lane])
    sums[30 * CELL_LANES + lane] = fma(mass, yyyy, sums[30 * CELL_LANES + lane])
    sums[31 * CELL_LANES + lane] = fma(mass, yyyz, sums[31 * CELL_LANES + lane])
    sums[32 * CELL_LANES + lane] = fma(mass, yyzz, sums[32 * CELL_LANES + lane])
    sums[33 * CELL_LANES + lane] = fma(mass, yzzz, sums[33 * CELL_LANES + lane])
    sums[34 * CELL_LANES + lane] = fma(mass, zzzz, sums[34 * CELL_LANES + lane])


@inner(_nrt=False, error_model="numpy")
def expand(far, n, softening2, sums):
    """Add the parts of the first n cells of a list to the sums (COEFFICIENTS CELL_LANES,); massless cells fill the last block.

    Returns 0, the number of cells in the list then.
    """
    wide()
    while n % CELL_LANES:
        far[n // CELL_LANES, :, n % CELL_LANES] = 0.0
        far[n // CELL_LANES, 0, n % CELL_LANES] = 1.0
        n += 1
    for block in range(n // CELL_LANES):
        for lane in range(CELL_LANES):
            add_cell(far[block], lane, softening2, sums)
    return 0


@lean_inner
def add_lanes(sums, coefficients):
    """The sums (COEFFICIENTS CELL_LANES,) of all lanes, in their order, as float64: coefficients (COEFFICIENTS,) or more."""
    for m in range(COEFFICIENTS):
        coefficients[m] = np.float64(sums[m * CELL_LANES])
        for lane in range(1, CELL_LANES):
            coefficients[m] += np.float64(sums[m * CELL_LANES + lane])


@lean_inner
def evaluate(coefficients, a, power):
    """Acceleration (3) and potential of an expansion at a (3,) from its middle; power (COEFFICIENTS,) is room for a^m/m!."""
    power[0], x, y, z, depth = 1.0, 0.0, 0.0, 0.0, 0.0
    for m in range(COEFFICIENTS):
        if m > 0:
            power[m] = power[LOWER[m]] * a[AXIS[m]] * OVER[m]
        depth = fma(coefficients[m], power[m], depth)
        if m < LOW:
            x = fma(coefficients[HIGHER[m, 0]], power[m], x)
            y = fma(coefficients[HIGHER[m, 1]], power[m], y)
            z = fma(coefficients[HIGHER[m, 2]], power[m], z)
    return x, y, z, -depth
