"""Spheres that overlap at the start: found, and pushed apart where the scene allows them."""

from itertools import chain

import numpy as np

from particles_mpi.errors import MOST_NAMED, listed
from particles_mpi.initial.faults import Faults
from particles_mpi.initial.room import Room
from particles_mpi.initial.sphere_cells import CLASSES, class_of
from particles_mpi.initial.sphere_grid import SphereGrid
from particles_mpi.kernels.geometry import image_shift, image_shifts, wrap
from particles_mpi.kernels.jit import inner, kernel
from particles_mpi.neighbours.candidates import touching
from particles_mpi.neighbours.cells import bulk
from particles_mpi.neighbours.halo_region import fetch_near_rows
from particles_mpi.neighbours.trajectories import AT_REST
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.decomposition import bisect, to_owners
from particles_mpi.parallel.exchange import allgather_rows
from particles_mpi.particles import Array, Particles, rows_of

MOST_SWEEPS = 1000
TOUCH = 1e-12  # relative overlap that still counts as touching


def check_overlaps(particles: Particles, room: Room, allowed: bool, before: int, judged: Array, faults: Faults) -> list[str]:
    """Find overlapping spheres: a fault, or, where the scene allows it, pushed apart; returns warnings. Collective.

    The first `before` rows existed already, and rows that are not `judged` (n,) overlap no others.
    """
    ranks, rows = faults.ranks, np.flatnonzero(judged)
    if not ranks.total(len(rows))[0]:
        return []
    near = {"id": particles.id[rows], "position": particles.position[rows], "radius": particles.radius[rows]}
    near |= {"fixed": particles.fixed[rows], "old": (rows < before).astype(np.uint8)}
    first, second, depth = overlapping_ids(ranks, near, room.length)
    pairs = listed_pairs(ranks, first, second)
    if not pairs:
        return []
    verb, deepest = "overlap" if pairs.startswith("pairs") else "overlaps", ranks.largest(depth.max(initial=0.0))[0]
    text = f"effects.collisions: {pairs} {verb} (deepest by {deepest:.3g})"
    if not allowed:
        faults.add(f"{text}; move them, or set allow_overlap = true")
        return []
    return [f"{text}; pushed apart", *push_apart(ranks, particles, room)]


def overlapping_ids(ranks: Communicator, columns: dict[str, Array], length: Array) -> tuple[Array, Array, Array]:
    """(lower ids, higher ids, depths) of spheres that overlap and are neither both fixed nor both old. Collective.

    Each pair is found by one rank, in whose part of space the one with the lower id is.
    """
    owned = len(columns["id"])
    if ranks.size > 1:
        columns = to_owners(ranks, columns, bisect(ranks, columns["position"], 1.0))
        owned, x = len(columns["id"]), columns["position"]
        state = x, np.zeros_like(x), columns["radius"]
        ghosts = fetch_near_rows(ranks, columns, state, AT_REST, length)[3]
        columns = {name: np.concatenate([columns[name], ghosts[name]]) for name in columns}
    rows = in_contact(columns["position"], columns["radius"], length)
    columns = rows_of(columns, rows)
    first, second, depth = overlapping_pairs(columns["position"], columns["radius"], columns["fixed"] != 0, columns["id"], length)
    mine = (rows[first] < owned) & ~((columns["old"][first] != 0) & (columns["old"][second] != 0))
    return columns["id"][first[mine]], columns["id"][second[mine]], depth[mine]


def in_contact(x: Array, radius: Array, length: Array) -> Array:
    """The rows of spheres at x (n, d) that touch another one: few, as a rule."""
    if len(x) < 2 or not radius.any():
        return np.empty(0, np.int64)
    lower, upper = bulk(x, x.min(axis=0), x.max(axis=0))
    extent = np.where(length > 0.0, length, np.maximum(upper - lower, np.finfo(float).tiny))
    kind = class_of(radius, float(radius.max()))
    largest_radii = np.array([radius[kind == k].max(initial=-1.0) for k in range(CLASSES)])
    grid = SphereGrid(lower, extent, length, np.bincount(kind, minlength=CLASSES), largest_radii)
    order = grid.order(x, radius)
    first, last = grid.append(x[order], radius[order], np.arange(len(x)))
    return np.sort(order[~grid.open_points(grid.x[:last], grid.radius[:last], 1.0 - 0.1 * TOUCH, np.arange(first, last))])


def overlapping_pairs(x: Array, radius: Array, fixed: Array, ids: Array, length: Array) -> tuple[Array, Array, Array]:
    """(first, second, depth): pairs of rows that overlap and are not both fixed, by their ids, and how deep."""
    if len(x) < 2 or not radius.any():
        return np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0)
    first, second = touching(x, radius, np.where(fixed, 0.0, 1.0), ids, length)
    order = np.lexsort((ids[second], ids[first]))
    first, second = first[order].astype(np.int64), second[order].astype(np.int64)
    r = x[first] - x[second]
    r -= image_shifts(r, length)
    sum_of_radii = radius[first] + radius[second]
    depth = sum_of_radii - np.sqrt((r**2).sum(axis=1))
    deep = depth > TOUCH * sum_of_radii
    return first[deep], second[deep], depth[deep]


def push_apart(ranks: Communicator, particles: Particles, room: Room) -> list[str]:
    """Move overlapping spheres apart, in place; returns warnings of those that still overlap. Collective.

    They are moved one after the other, in the order of their ids, by every rank: each holds the places of all.
    """
    names = ("id", "position", "radius", "mass", "fixed")
    arrived = allgather_rows(ranks, {name: particles[name] for name in names})
    spheres = Particles(particles.dimension, rows_of(arrived, np.argsort(arrived["id"])))
    x, radius, w = spheres.position, spheres.radius, spheres.inverse_mass
    line = line_of(spheres, room.length) if particles.dimension == 1 else None
    ends = (room.lower, room.upper) if not room.length[0] else (np.full(1, -np.inf), np.full(1, np.inf))  # of a line
    for sweep in range(MOST_SWEEPS + 1):
        if line:
            first, second, depth = crowded_on_line(x, radius, w, line)
        else:
            first, second, depth = overlapping_pairs(x, radius, spheres.fixed != 0, spheres.id, room.length)
        if not len(first) or sweep == MOST_SWEEPS:
            break
        if line:
            separate_on_line(x, radius, w, *line, *ends, np.zeros(1), room.point, room.normal)
        else:
            separate(x, radius, w, first, second, room.lower, room.upper, room.length, room.point, room.normal)
    if line:
        wrap(x, room.lower, room.upper, room.length)
    particles.position[...] = x[np.searchsorted(spheres.id, particles.id)]
    if not len(first):
        return []
    pairs = listed_pairs(Communicator.alone(), spheres.id[first], spheres.id[second])
    left = f"{pairs} still overlap after {MOST_SWEEPS} sweeps"
    return [f"effects.collisions: {left} (deepest by {depth.max():.3g})"]


def line_of(p: Particles, length: Array) -> tuple[Array, Array, Array]:
    """Neighbours on a line, which stay neighbours: (rows, the next row at larger x of each, what is added to the x of that).

    (m,) each; the length of a periodic line is added for the pair across its end, and 0 for all others.
    """
    order = np.lexsort((p.id, p.position[:, 0]))
    behind, ahead, shift = order, np.roll(order, -1), np.zeros(len(order))
    shift[-1:] = length[0]
    neighbours = len(order) if length[0] > 0.0 else len(order) - 1
    return behind[:neighbours], ahead[:neighbours], shift[:neighbours]


def crowded_on_line(x: Array, radius: Array, w: Array, line: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
    """(first, second, depth) of neighbours on a line that overlap, or have changed places, and are not both fixed."""
    first, second, shift = line
    sum_of_radii = radius[first] + radius[second]
    depth = sum_of_radii - (x[second, 0] + shift - x[first, 0])
    deep = (depth > TOUCH * sum_of_radii) & (w[first] + w[second] > 0.0)
    return first[deep], second[deep], depth[deep]


def listed_pairs(ranks: Communicator, first: Array, second: Array) -> str:
    """ "pairs 0-1 and 3-4" of any rank, the lowest ids first; "" if there are none. Collective."""
    total = ranks.total(len(first))[0]
    order = np.lexsort((second, first))[:MOST_NAMED]
    mine = list(zip(first[order].tolist(), second[order].tolist()))
    lowest = sorted(chain.from_iterable(ranks.allgather(mine)))
    return listed([f"{i}-{j}" for i, j in lowest], "pair", total) if total else ""


@kernel
def separate(x, radius, w, first, second, lower, upper, length, point, normal):
    """Move the two spheres of each pair that overlap apart, in place on x; they stay inside walls and box.

    x (n, d); radius (n,); w (n,): inverse masses, 0 of fixed ones, by which the two share the way; first, second (m,): rows of
    the pairs; lower, upper, length (d,): the box; point, normal (walls, d).
    """
    d = x.shape[1]
    r = np.zeros(d)
    for i, j in zip(first, second):
        if w[i] + w[j] == 0.0:
            continue
        r2 = 0.0
        for k in range(d):
            r[k] = x[i, k] - x[j, k]
            r[k] -= image_shift(r[k], length[k])
            r2 += r[k] * r[k]
        distance = r2**0.5
        diameter = (radius[i] + radius[j]) * (1.0 + 1e-9)
        push = diameter - distance
        if push <= 0.0:
            continue
        if distance < 1e-9 * diameter:  # coincident centres have no direction: take one from their numbers
            r2 = 0.0
            for k in range(d):
                r[k] = (i * 7919 + j * 104729 + (k + 1) * 1299709) % 1021 - 510.5
                r2 += r[k] * r[k]
            distance = r2**0.5
        for k in range(d):
            step = push * r[k] / (distance * (w[i] + w[j]))
            x[i, k] += step * w[i]
            x[j, k] -= step * w[j]
        for row in (i, j):
            if w[row] > 0.0:
                hold_inside(x, row, radius[row], lower, upper, length, point, normal)


@kernel
def separate_on_line(x, radius, w, first, second, shift, lower, upper, length, point, normal):
    """As `separate`, of neighbours on a line, `second` being the next one at larger x: they never change places.

    A periodic line is given without ends and length: what is brought back into the box would seem to be behind others.
    """
    for p in range(len(first)):
        i, j = first[p], second[p]
        push = (radius[i] + radius[j]) * (1.0 + 1e-9) - (x[j, 0] + shift[p] - x[i, 0])
        if push <= 0.0 or w[i] + w[j] == 0.0:
            continue
        x[i, 0] -= push * w[i] / (w[i] + w[j])
        x[j, 0] += push * w[j] / (w[i] + w[j])
        for row in (i, j):
            if w[row] > 0.0:
                hold_inside(x, row, radius[row], lower, upper, length, point, normal)


@inner
def hold_inside(x, i, radius, lower, upper, length, point, normal):
    """Bring row i back inside each wall, and into the box."""
    for w in range(len(point)):
        gap = -radius
        for k in range(x.shape[1]):
            gap += (x[i, k] - point[w, k]) * normal[w, k]
        if gap < 0.0:
            for k in range(x.shape[1]):
                x[i, k] -= gap * normal[w, k]
    for k in range(x.shape[1]):
        if length[k] > 0.0:
            if x[i, k] < lower[k]:
                x[i, k] += length[k]
            elif x[i, k] >= upper[k]:
                x[i, k] -= length[k]
        x[i, k] = min(max(x[i, k], lower[k]), upper[k])
