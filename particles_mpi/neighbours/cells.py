"""Linked cells on at most three axes, and the candidate pairs in them. Plain arrays; periodic boxes by image entries.

A cell grid has an empty margin of one cell, so that a neighbour cell is a constant offset away and needs no test. Cells
along the last gridded axis are contiguous in the sorted order: three of them are one range of entries.
"""

from __future__ import annotations

from itertools import product
from math import inf

import numpy as np
from numba import njit

from particles_mpi.particles import Array

GRIDDED = 3  # axes with cells; more would cost 3^d cells to visit, and the others are tested by distance anyway


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


def grid(x: Array, side: float) -> tuple[tuple[float, ...], float, tuple[int, ...]]:
    """(origin, side, cells an axis with margin) of cells of at least `side` over x (n, d), about one a particle at most."""
    low, high = bounds(x)
    origin = low[:GRIDDED]
    extent = high[:GRIDDED] - origin
    side = max(side, np.finfo(float).tiny, float(extent.max()) * 1e-6)
    while np.prod(np.floor(extent / side) + 1.0) > max(len(x), 64):
        side *= 1.25
    return tuple(origin.tolist()), side, tuple((np.floor(extent / side).astype(int) + 3).tolist())


@njit(cache=True)
def bounds(x):
    """(lowest, highest) coordinates of the rows of x (n, d), n > 0."""
    low = x[0].copy()
    high = x[0].copy()
    for i in range(x.shape[0]):
        for k in range(x.shape[1]):
            low[k] = min(low[k], x[i, k])
            high[k] = max(high[k], x[i, k])
    return low, high


@njit(cache=True, error_model="numpy")
def cell_order(x, origin, side, cells):
    """(order, start): rows sorted by cell, rows in order within one, and where each cell starts; a counting sort.

    `origin`, `cells`: tuples over the gridded axes, as `grid` gives them.
    """
    n = len(x)
    count = 1
    for k in range(len(cells)):
        count *= cells[k]
    per = 1.0 / side
    cell = np.empty(n, np.int64)
    start = np.zeros(count + 1, np.int64)
    for i in range(n):
        c = 0
        for k in range(len(cells)):
            place = int((x[i, k] - origin[k]) * per) + 1
            c = c * cells[k] + min(place, cells[k] - 2)
        cell[i] = c
        start[c + 1] += 1
    for c in range(count):
        start[c + 1] += start[c]
    place_of = start[:-1].copy()
    order = np.empty(n, np.int64)
    for i in range(n):
        order[place_of[cell[i]]] = i
        place_of[cell[i]] += 1
    return order, start


def forward_rows(cells: tuple[int, ...]) -> Array:
    """Offsets of the rows of cells (runs along the last axis) that follow a cell's own: half of its neighbourhood."""
    strides = np.append(np.cumprod(cells[::-1])[::-1][1:], 1)
    steps = [s for s in product((-1, 0, 1), repeat=len(cells) - 1) if s > (0,) * (len(cells) - 1)]
    return np.array([np.dot(s, strides[:-1]) for s in steps], np.int64)


@njit(cache=True)
def find_pairs(axes, x, row, start, offsets, radius, w, ids, owned, skin, first, second):
    """Pairs of rows nearer than R_i + R_j + skin; returns how many there are (more than len(first): enlarge, call again).

    x (n, d) are entries sorted by cell, `row` what each is an image of. Kept: pairs with an owned partner (row < owned) and
    a movable one (w > 0), each once, the partner with the lower id first.
    """
    found = 0
    widest = (2.0 * radius.max() + skin) ** 2
    for c in range(1, len(start) - 2):
        for a in range(start[c], start[c + 1]):
            for run in range(-1, len(offsets)):
                if run < 0:
                    begin, end = a + 1, start[c + 2]
                else:
                    begin, end = start[c + offsets[run] - 1], start[c + offsets[run] + 2]
                for b in range(begin, end):
                    r2 = 0.0
                    for k in range(len(axes)):
                        r2 += (x[a, k] - x[b, k]) ** 2
                    if r2 > widest:
                        continue
                    i = row[a]
                    j = row[b]
                    cut = radius[i] + radius[j] + skin
                    if r2 > cut * cut or (i >= owned and j >= owned) or i == j or (w[i] == 0.0 and w[j] == 0.0):
                        continue
                    if ids[i] > ids[j]:
                        i, j = j, i
                    if found < len(first):
                        first[found] = i
                        second[found] = j
                    found += 1
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
    entries, row = images(x, cut, *bounds(own), length)
    origin, side, cells = grid(entries, cut)
    order, start = cell_order(entries, origin, side, cells)
    entries, row = entries[order], row[order].astype(np.int32)
    offsets = forward_rows(cells)
    axes = (0,) * x.shape[1]
    capacity = expected + expected // 8 + 64
    while True:
        first, second = np.empty(capacity, np.int32), np.empty(capacity, np.int32)
        found = find_pairs(axes, entries, row, start, offsets, radius, w, ids, owned, skin, first, second)
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
