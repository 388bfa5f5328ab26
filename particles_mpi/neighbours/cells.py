"""Linked cells on at most three axes, and the candidate pairs in them. Plain arrays; periodic boxes by image entries.

A cell grid has an empty margin, so that a neighbour cell is a constant offset away and needs no test. Cells
along the last gridded axis are contiguous in the sorted order: all that are near a given one are one run of entries.
"""

from __future__ import annotations

from itertools import product
from math import inf

import numpy as np
from numba import njit

from particles_mpi.particles import Array

GRIDDED = 3  # axes with cells; more would cost 3^d cells to visit, and the others are tested by distance anyway
FINE = 4  # cells to the cut-off on the last gridded axis: runs along it can be any length, so that they may as well be tight
AT_ONCE = 8
BLOCK = 2048  # near pairs judged at a time


def images(x: Array, cut: float, lower: Array, upper: Array, length: Array) -> tuple[Array, Array]:
    """(positions, rows): every row of x (n, d), and its periodic images, inside [lower - cut, upper + cut] on periodic axes."""
    rows = np.arange(len(x))
    for k in np.flatnonzero(length > 0.0):
        low, high = lower[k] - cut, upper[k] + cut
        copies = [(x, rows)]
        for shift in (-length[k], length[k]):
            moved = x[:, k] + shift
            kept = (moved >= low) & (moved <= high)
            y = x[kept]
            y[:, k] = moved[kept]
            copies.append((y, rows[kept]))
        x, rows = np.concatenate([c[0] for c in copies]), np.concatenate([c[1] for c in copies])
        kept = (x[:, k] >= low) & (x[:, k] <= high)
        x, rows = x[kept], rows[kept]
    return x, rows


def grid(x: Array, side: float) -> tuple[tuple[float, ...], tuple[float, ...], tuple[int, ...], tuple[int, ...]]:
    """(origin, cells a unit length, margin, cells with both margins), an entry a gridded axis, of cells over x (n, d).

    `margin` cells are at least `side` long together: 1, and FINE on the last axis; about one to FINE cells a particle.
    """
    low, high = bounds(x)
    origin = low[:GRIDDED]
    extent = high[:GRIDDED] - origin
    side = max(side * (1.0 + 1e-8), np.finfo(float).tiny, float(extent.max()) * 1e-6)  # 1e-8: above any round-off
    while np.prod(np.floor(extent / side) + 1.0) > max(len(x), 64):
        side *= 1.25
    margin = np.ones(len(origin), int)
    margin[-1] = FINE
    per = margin / side
    cells = (extent * per).astype(int) + 1 + 2 * margin
    return tuple(origin.tolist()), tuple(per.tolist()), tuple(margin.tolist()), tuple(cells.tolist())


@njit(cache=True)
def bounds(x):
    """(lowest, highest) coordinates of the rows of x (n, d); (inf, -inf) if n = 0."""
    low = np.full(x.shape[1], inf)
    high = np.full(x.shape[1], -inf)
    for i in range(x.shape[0]):
        for k in range(x.shape[1]):
            low[k] = min(low[k], x[i, k])
            high[k] = max(high[k], x[i, k])
    return low, high


@njit(cache=True, error_model="numpy")
def cell_order(x, origin, per, margin, cells):
    """(order, cell, start): rows sorted by cell (rows in order within one), the cell of each of these, and where each
    cell starts among them; a counting sort. The other arguments are those that `grid` gives.
    """
    n = len(x)
    count = 1
    for k in range(len(cells)):
        count *= cells[k]
    cell_of = np.empty(n, np.int32)
    start = np.zeros(count + 2, np.int32)  # of cell c: for now its rows counted at c + 2, then its next free place at c + 1
    for i in range(n):
        c = 0
        for k in range(len(cells)):
            place = int((x[i, k] - origin[k]) * per[k]) + margin[k]
            c = c * cells[k] + min(place, cells[k] - 1 - margin[k])
        cell_of[i] = c
        start[c + 2] += 1
    for c in range(count):
        start[c + 2] += start[c + 1]
    order = np.empty(n, np.int32)
    cell = np.empty(n, np.int32)
    for i in range(n):
        c = cell_of[i]
        place = start[c + 1]
        order[place] = i
        cell[place] = c
        start[c + 1] = place + 1
    return order, cell, start


def forward_rows(cells: tuple[int, ...]) -> Array:
    """Offsets of the rows of cells (runs along the last axis) that follow a cell's own: half of its neighbourhood."""
    strides = np.append(np.cumprod(cells[::-1])[::-1][1:], 1)
    steps = [s for s in product((-1, 0, 1), repeat=len(cells) - 1) if s > (0,) * (len(cells) - 1)]
    return np.array([np.dot(s, strides[:-1]) for s in steps], np.int64)


@njit(cache=True)
def take_rows(x, row, order):
    """(x[order], row[order])"""
    y = np.empty_like(x)
    row_of = np.empty(len(order), np.int32)
    for a in range(len(order)):
        row_of[a] = row[order[a]]
        for k in range(x.shape[1]):
            y[a, k] = x[order[a], k]
    return y, row_of


@njit(cache=True)
def list_around(a, cell, start, margin, offsets, around):
    """Entries after a in a's own row of cells, and those in the rows that follow; into `around`, returns how many.

    Runs are short: AT_ONCE places are written whatever their length, without a loop whose end the processor must guess.
    """
    listed = 0
    begin, end = a + 1, start[np.uint64(cell + margin + 1)]
    for run in range(len(offsets) + 1):
        for m in range(AT_ONCE):
            around[np.uint64(listed + m)] = begin + m
        for m in range(AT_ONCE, end - begin):
            around[np.uint64(listed + m)] = begin + m
        listed += end - begin
        if run < len(offsets):
            c = cell + offsets[run]
            begin, end = start[np.uint64(c - margin)], start[np.uint64(c + margin + 1)]
    return listed


@njit(cache=True, error_model="numpy")
def find_pairs(axes, x, row, cell, start, margin, offsets, radius, w, ids, owned, skin, first, second):
    """Pairs of rows nearer than R_i + R_j + skin; returns how many there are (more than len(first): enlarge, call again).

    x (n, d) are entries sorted by cell, `row` what each is an image of. Kept: pairs with an owned partner (row < owned) and
    a movable one (w > 0), each once, the partner with the lower id first. Nearly every test is a coin toss, so nothing
    branches on one: all is written, and the place to write at moves on by the truth of the test. Unsigned indices spare
    the test for a negative one.
    """
    n = len(x)
    widest = (2.0 * radius.max() + skin) ** 2
    around = np.empty(n + AT_ONCE, np.int32)
    near_a, near_b, near_r2 = np.empty(n + BLOCK, np.int32), np.empty(n + BLOCK, np.int32), np.empty(n + BLOCK)
    found = 0
    a = 0
    while a < n:
        near = 0
        while a < n and near < BLOCK:
            for p in range(list_around(a, cell[a], start, margin, offsets, around)):
                b = np.uint64(around[np.uint64(p)])
                r2 = 0.0
                for k in range(len(axes)):
                    r2 += (x[np.uint64(a), k] - x[b, k]) ** 2
                near_a[np.uint64(near)] = a
                near_b[np.uint64(near)] = b
                near_r2[np.uint64(near)] = r2
                near += r2 <= widest
            a += 1
        for p in range(near):
            i = np.uint64(row[np.uint64(near_a[p])])
            j = np.uint64(row[np.uint64(near_b[p])])
            cut = radius[i] + radius[j] + skin
            kept = (near_r2[p] <= cut * cut) & ((i < owned) | (j < owned)) & (i != j) & ((w[i] != 0.0) | (w[j] != 0.0))
            swapped = ids[i] > ids[j]
            if found < len(first):
                first[found] = j if swapped else i
                second[found] = i if swapped else j
            found += kept
    return found


def candidate_pairs(
    x: Array, radius: Array, w: Array, ids: Array, owned: int, skin: float, length: Array, expected: int
) -> tuple[Array, Array]:
    """(first, second): rows of all pairs nearer than R_i + R_j + skin of which one is owned (row < owned), each once.

    x (n, d); radius, w = 1/m and ids (n,); `length` (d,) is the box length of periodic axes, else 0; `expected` a guess of
    the number of pairs. On a periodic axis the box must be at least twice the longest reach.
    """
    none = np.empty(0, np.int32)
    if owned == 0 or len(x) < 2:
        return none, none
    cut = 2.0 * float(radius.max()) + skin
    own = x[:owned]
    low, high = bounds(own)
    entries, row = images(x, cut, low, high, length) if length.any() else (x, np.arange(len(x)))
    origin, per, margin, cells = grid(entries, cut)
    order, cell, start = cell_order(entries, origin, per, margin, cells)
    entries, row = take_rows(entries, row, order)
    offsets = forward_rows(cells)
    axes = (0,) * x.shape[1]
    capacity = expected + expected // 8 + 64
    while True:
        first, second = np.empty(capacity, np.int32), np.empty(capacity, np.int32)
        found = find_pairs(axes, entries, row, cell, start, FINE, offsets, radius, w, ids, owned, skin, first, second)
        if found <= capacity:
            break
        capacity = found
    first, second = first[:found], second[:found]
    return unique_pairs(first, second) if length.any() else (first, second)


def unique_pairs(first: Array, second: Array) -> tuple[Array, Array]:
    """A pair across a periodic face is met from both sides: keep one."""
    key = np.unique((first.astype(np.int64) << 32) | second)
    return (key >> 32).astype(np.int32), (key & 0xFFFFFFFF).astype(np.int32)


@njit(cache=True)
def furthest(axes, x, reference, v, h, length):
    """Largest |x - reference| + |v| h over rows: how far from where the pairs were found a particle can get in this drift."""
    most = 0.0
    for i in range(len(reference)):
        moved = 0.0
        speed = 0.0
        for k in range(len(axes)):
            r = x[i, k] - reference[i, k]
            if length[k] > 0.0:
                if r > 0.5 * length[k]:
                    r -= length[k]
                elif r < -0.5 * length[k]:
                    r += length[k]
            moved += r * r
            speed += v[i, k] * v[i, k]
        most = max(most, moved**0.5 + h * speed**0.5)
    return most


@njit(cache=True)
def fastest(axes, x, v):
    """Largest speed of the rows of v; not a number if a coordinate or velocity is not finite."""
    most = 0.0
    wrong = 0.0  # or nan
    for i in range(len(v)):
        v2 = 0.0
        for k in range(len(axes)):
            v2 += v[i, k] * v[i, k]
            wrong += x[i, k] * 0.0
        wrong += v2 * 0.0
        most = max(most, v2)
    return most**0.5 + wrong


def best_skin(travel: float, diameter: float, pairs: float, cut: float, spacing: float, dimension: int) -> float:
    """The skin that makes search plus upkeep cheapest.

    `travel`: how far the fastest particle gets a step; `pairs`: candidates a particle at the last cut-off `cut` (0: not
    known, guessed from the mean distance `spacing`). Costs in the time of one pair test in a list: finding pairs costs
    about 20 a particle and 0.7 a particle in the cells around it, and lasts skin/(2 travel) steps.
    """
    travel = max(travel, 1e-3 * diameter, 1e-9 * spacing)
    best, least = 2.1 * travel, inf
    for steps in (1, 2, 3, 4, 5, 6, 8, 10, 13, 16, 20, 25, 32, 40, 50, 64, 80, 100, 128, 200):
        skin = 2.1 * travel * steps
        reach = diameter + skin
        around = max(reach / spacing, 1.0) ** dimension * 14.0
        listed = pairs * (reach / cut) ** dimension if pairs > 0.0 else 2.0 * (reach / spacing) ** dimension
        cost = (20.0 + 0.7 * around) / steps + listed
        if cost < least:
            best, least = skin, cost
    return best
