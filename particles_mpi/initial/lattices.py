"""Positions for `position = "lattice"`: centres by a formula of the number of the sphere, so that any part can be made alone."""

from itertools import product
from math import exp, floor, inf, log, prod

import numpy as np

from particles_mpi.initial.room import Room
from particles_mpi.particles import Array


def lattice(count: int, radius: float, room: Room, first: int, last: int) -> Array | None:
    """The centres first ... last - 1 of a lattice of `count` in the box: simple cubic if spheres fit, else face-centred.

    In two dimensions the latter is hexagonal. None if they fit in neither. Shape (last - first, d).
    """
    if count == 0:
        return np.empty((0, len(room.lower)))
    cubic = simple_cubic(count, 2.0 * radius if room.solid else 0.0, room, radius if room.bounded else 0.0, first, last)
    return cubic if cubic is not None or len(room.lower) not in (2, 3) else face_centred(count, radius, room, first, last)


def thinned(sites: int, count: int, first: int, last: int) -> Array:
    """The numbers first ... last - 1 of `count` of the sites 0 ... sites - 1, evenly spread."""
    if sites <= (2**63 - 1) // max(last, 1):
        return np.arange(first, last, dtype=np.int64) * sites // max(count, 1)
    numbers = (number * sites // count for number in range(first, last))  # Python's integers have no end
    return np.fromiter(numbers, np.int64, last - first)


def simple_cubic(count: int, diameter: float, room: Room, margin: float, first: int, last: int) -> Array | None:
    """Centres of `count` of the equal cells of the box, first ... last - 1; None if a cell would be narrower than `diameter`."""
    extent = (room.upper - room.lower).tolist()
    closed = [length == 0.0 for length in room.length.tolist()]
    least = [max(diameter, 2.0 * margin if c else 0.0) for c in closed]
    most = [floor(e / s * (1.0 + 1e-12)) if s > 0.0 else inf for e, s in zip(extent, least)]
    if min(most) < 1:
        return None
    scale = exp((log(count) - sum(map(log, extent))) / len(extent))
    cells = [int(min(max(1, floor(e * scale)), m)) for e, m in zip(extent, most)]
    while prod(cells) < count:
        widths = [e / c if c < m else 0.0 for e, c, m in zip(extent, cells, most)]
        k = int(np.argmax(widths))
        if widths[k] == 0.0:
            return None
        cells[k] += 1
    site = thinned(prod(cells), count, first, last)
    x = np.empty((len(site), len(extent)))
    for k in reversed(range(len(extent))):
        x[:, k] = room.lower[k] + (site % cells[k] + 0.5) * (extent[k] / cells[k])
        site //= cells[k]
    return x


def face_centred(count: int, radius: float, room: Room, first: int, last: int) -> Array | None:
    """Every second point of a grid with q_k layers at spacing h_k on axis k: neighbours are sqrt(h_k^2 + h_m^2) or 2 h_k apart.

    Equal spacings give the fcc lattice in 3D; h_1 = sqrt(3) h_0 gives the hexagonal lattice in 2D. Of all numbers of layers near
    those of the ideal lattice, the ones with the largest distance between neighbours are taken. None if spheres do not fit.
    """
    extent, closed = room.upper - room.lower, room.length == 0.0
    free = np.where(closed, extent - 2.0 * radius, extent)
    if (free < -1e-12 * extent).any():
        return None
    free, d = np.maximum(free, 0.0), len(extent)
    ideal = extent / (prod(extent.tolist()) / (2.0 * count)) ** (1.0 / d)
    choices = []
    for q, shut in zip(ideal, closed, strict=True):
        near = np.unique(np.concatenate([np.arange(-20, 21) + round(q), np.linspace(0.5, 2.0, 30) * q]).astype(np.int64))
        choices.append([int(m) for m in near if m >= 1 and (shut or m % 2 == 0)])
    best: tuple[float, tuple[int, ...], Array] | None = None
    for head in product(*choices[:-1]):
        rest = max(1, -(-2 * count // prod(head)) - 1)
        while (prod(head) * rest + 1) // 2 < count or (not closed[-1] and rest % 2):
            rest += 1
        layers = (*head, rest)
        gaps = np.array([q - 1 if shut else q for q, shut in zip(layers, closed, strict=True)])
        h = np.divide(free, gaps, out=np.full(d, 1e100), where=gaps > 0)
        near = np.partition(h, 1)
        apart = min(float(np.hypot(near[0], near[1])), 2.0 * float(h[gaps > 1].min(initial=inf)))
        if best is None or apart > best[0] * (1.0 + 1e-12):
            best = apart, layers, h
    if best is None or best[0] < 2.0 * radius * (1.0 - 1e-12):
        return None
    _, layers, h = best
    site = every_second(layers, thinned((prod(layers) + 1) // 2, count, first, last))
    single = (np.array(layers) == 1) & closed
    start = room.lower + np.where(closed, radius, 0.25 * h)
    return np.where(single, 0.5 * (room.lower + room.upper), start + site * h)


def every_second(layers: tuple[int, ...], number: Array) -> Array:
    """The points of a grid (layers[k] on axis k) the sum of whose indices is even: those with these numbers, (n, d).

    They are counted with the last axis as the fastest. A plane of m points has m/2 of them; of an odd number (m + 1)/2 if the
    index of the plane is even, and (m - 1)/2 otherwise: two planes in a row have m.
    """
    index = np.empty((len(number), len(layers)), np.int64)
    odd = np.zeros(len(number), np.int64)  # the sum of the indices so far, mod 2
    left = number.copy()
    for k in range(len(layers)):
        plane = prod(layers[k + 1 :])
        pairs, left = left // plane, left % plane
        in_first = (plane + 1 - odd) // 2
        second = left >= in_first
        left = np.where(second, left - in_first, left)
        index[:, k] = 2 * pairs + second
        odd = (odd + index[:, k]) % 2
    return index
