"""The direct sum over all pairs. Arrays only.

A target adds up its sources in the order of their ids: up to ONE_SUM particles in one sum, more in eight. Number j of all sources
then enters lane j mod 8, and the lanes are added in the end. So the bits are the same however the sources are divided into
blocks, and vectors of any length can compute the sums, of eight targets or of eight sources. Targets lie in tiles, axis by axis,
which stay in the first-level cache.

Where targets are sources too, each pair of tiles is looked at once and acts on both, which saves half of the arithmetic. In the
order (0, 0), (0, 1), ..., (1, 1), (1, 2), ... each tile still meets its sources in the order of ids.
"""

from typing import Any

import numpy as np

from particles_mpi.gravity.powers import formula, if_positive, inverse_cube, inverse_root
from particles_mpi.kernels.jit import fma, inner, kernel, wide
from particles_mpi.kernels.lanes import LANE_COUNT, eight, load, store
from particles_mpi.particles import Array

ONE_SUM = 256  # particles in all up to which a target makes one sum
TILE = 8 * LANE_COUNT  # targets
TOGETHER = 16  # tiles that act on another one in turn while the caches hold it

summing: Any = inner(_nrt=False, error_model="numpy")


class Attraction:
    """The attraction of targets x (n, d), for G = 1, by sources that come in blocks in the order of ids.

    at (tiles, d TILE): the targets, axis by axis; the last tile is filled up with the last target. sums (tiles, lanes d TILE):
    what acted on the targets so far; met: the number of sources so far.
    """

    def __init__(self, x: Array, total: int, softening2: float):
        """`total`: the number of sources that will come."""
        self.x, self.softening2, self.met = x, softening2, 0
        self.axes, self.lanes = (0,) * x.shape[1], 1 if total <= ONE_SUM else LANE_COUNT
        self.at = in_tiles(x)
        self.sums = np.zeros((len(self.at), self.lanes * self.at.shape[1]))

    def add(self, source: Array, mass: Array) -> None:
        """Sources (m, d) with these masses act on all targets; one at the place of a target adds nothing to it."""
        attract(self.axes, self.at, source, mass, self.softening2, self.met, self.lanes, self.sums)
        self.met += len(mass)

    def add_one_another(self, mass: Array, begin: int, end: int) -> None:
        """Let targets, in the order of ids, act on one another: tiles `begin` to `end`, and for each of them all tiles behind it.

        Only where there are several lanes.
        """
        filled = np.zeros((len(self.at), TILE))
        filled.reshape(-1)[: len(mass)] = mass
        attract_one_another(self.axes, self.x, self.at, filled, self.softening2, self.met, begin, end, self.sums)
        self.met += len(mass) if end == len(self.at) else 0

    def accelerations(self) -> Array:
        """The sums of all lanes, (n, d)."""
        n, d = self.x.shape
        lanes = self.sums.reshape(len(self.at), self.lanes, d, TILE)
        while lanes.shape[1] > 1:
            lanes = lanes[:, : lanes.shape[1] // 2] + lanes[:, lanes.shape[1] // 2 :]
        return np.ascontiguousarray(lanes[:, 0].transpose(0, 2, 1).reshape(len(self.at) * TILE, d)[:n])


def in_tiles(column: Array) -> Array:
    """Rows (n, d) or (n,) as tiles (tiles, d TILE), axis by axis; the last is filled up with the last row."""
    n, axes = len(column), column.size // max(len(column), 1)
    tiles = -(-n // TILE)
    filled = column.reshape(n, axes)[np.minimum(np.arange(tiles * TILE), n - 1)]
    return np.ascontiguousarray(filled.reshape(tiles, TILE, axes).transpose(0, 2, 1)).reshape(tiles, axes * TILE)


@kernel(error_model="numpy")
def attract(axes, at, source, mass, softening2, first, lanes, sums):
    """sums += sum_j m_j r_j/(r_j^2 + softening2)^(3/2), r_j from a target to source j, which is number first + j of all."""
    for tile in range(len(at)):
        attract_tile(axes, at[tile], source, mass, softening2, first, lanes, sums[tile])


@summing
def attract_tile(axes, at, source, mass, softening2, first, lanes, sums):
    """The same for one tile of targets."""
    wide()
    for j in range(len(source)):
        lane = ((first + j) & (lanes - 1)) * len(at)  # lanes: a power of 2
        for t in range(0, TILE, LANE_COUNT):
            r2 = eight(softening2)
            for k in range(len(axes)):
                r = eight(source[j, k]) - load(at, k * TILE + t)
                r2 = fma(r, r, r2)
            strength = inverse_cube(r2) * eight(mass[j])
            for k in range(len(axes)):
                r = eight(source[j, k]) - load(at, k * TILE + t)
                store(sums, lane + k * TILE + t, fma(strength, r, load(sums, lane + k * TILE + t)))


@kernel(error_model="numpy")
def attract_one_another(axes, x, at, mass, softening2, first, begin, end, sums):
    """What `attract` gives for the targets x (n, d) as sources, with masses (tiles, TILE), in half of the time: the same bits.

    Only the part of it that comes from tiles `begin` to `end` - 1 and all tiles behind them.
    """
    size = len(axes) * TILE
    own = np.empty((TOGETHER, size * LANE_COUNT))  # sums of a tile, lane by lane for each of its targets
    for group in range(begin, end, TOGETHER):
        behind = min(group + TOGETHER, end)
        for other in range(group, len(at)):
            for tile in range(group, min(other, behind)):
                number, of = first + tile * TILE, own[tile - group]
                attract_tiles(axes, at[tile], mass[tile], at[other], mass[other], softening2, number, of, sums[other])
            if other < behind:
                rows, number = slice(other * TILE, min((other + 1) * TILE, len(x))), first + other * TILE
                attract_tile(axes, at[other], x[rows], mass[other], softening2, number, LANE_COUNT, sums[other])
                for place in range(size):
                    for lane in range(LANE_COUNT):
                        own[other - group, place * LANE_COUNT + lane] = sums[
                            other, ((first + lane) & (LANE_COUNT - 1)) * size + place
                        ]
        for tile in range(group, behind):
            for place in range(size):
                for lane in range(LANE_COUNT):
                    sums[tile, ((first + lane) & (LANE_COUNT - 1)) * size + place] = own[tile - group, place * LANE_COUNT + lane]


@summing
def attract_tiles(axes, at, mass, other, other_mass, softening2, first, own, sums):
    """Let two tiles act on one another: `own` are the sums of the first, by target, and `sums` those of the other."""
    wide()
    for i in range(TILE):
        lane = ((first + i) & (LANE_COUNT - 1)) * len(at)
        for t in range(0, TILE, LANE_COUNT):
            r2 = eight(softening2)
            for k in range(len(axes)):
                r = load(other, k * TILE + t) - eight(at[k * TILE + i])
                r2 = fma(r, r, r2)
            strength = inverse_cube(r2)
            on_one, on_others = strength * load(other_mass, t), strength * eight(mass[i])
            for k in range(len(axes)):
                r = load(other, k * TILE + t) - eight(at[k * TILE + i])
                one, others = (k * TILE + i) * LANE_COUNT, lane + k * TILE + t
                store(own, one, fma(on_one, r, load(own, one)))
                store(sums, others, fma(on_others, -r, load(sums, others)))


@formula
def attract_few(axes, x, mass, softening2, total):
    """total (n, d) = what `attract` gives in one lane for x (n, d) as sources and targets, with the same bits; at most ONE_SUM.

    Each target takes its sources in their order, although each pair is looked at once.
    """
    for i in range(len(x)):
        for k in range(len(axes)):
            total[i, k] = 0.0
    for i in range(len(x)):
        for j in range(i + 1, len(x)):
            r2 = softening2
            for k in range(len(axes)):
                r = x[j, k] - x[i, k]
                r2 = fma(r, r, r2)
            strength = inverse_cube(r2)
            on_i, on_j = strength * mass[j], strength * mass[i]
            for k in range(len(axes)):
                total[i, k] = fma(on_i, x[j, k] - x[i, k], total[i, k])
                total[j, k] = fma(on_j, x[i, k] - x[j, k], total[j, k])


@kernel(error_model="numpy")
def add_potential(axes, at, ids, source, mass, source_ids, softening2, total):
    """total (tiles, TILE) -= sum_j m_j/(r_j^2 + softening2)^(1/2), without the target and, if not softened, what is at its place.

    at, ids: of the targets, `in_tiles`.
    """
    for tile in range(len(at)):
        add_potential_of_tile(axes, at[tile], ids[tile], source, mass, source_ids, softening2, total[tile])


@summing
def add_potential_of_tile(axes, at, ids, source, mass, source_ids, softening2, total):
    """The same for one tile of targets."""
    wide()
    for j in range(len(source)):
        for t in range(TILE):
            r2 = softening2
            for k in range(len(axes)):
                r = source[j, k] - at[k * TILE + t]
                r2 = fma(r, r, r2)
            near = if_positive(r2, inverse_root(r2))
            total[t] = fma(-mass[j], near if ids[t] != source_ids[j] else 0.0, total[t])
