"""Finds the contacts that may last: all half-edges that may be slow. See `operator`.

`push` (d,) of a row: SLOW_PUSH times the change of velocity by forces in a step. The radius of a row is enlarged by its *reach*,
the distance that it moves in a step at HELD times that speed: contacts within it may be slow. The reach of a sphere is at most
REACH radii, and in a crowd REACH_IN_CROWDS, so that none has more than some hundred contacts, whatever forces, speeds and steps
are.
"""

from math import sqrt
from typing import NamedTuple

import numpy as np

from particles_mpi.kernels.geometry import nearest
from particles_mpi.kernels.jit import in_place, kernel, lean_inner
from particles_mpi.particles import Array

SLOW_PUSH = 2.0  # times what forces do in a step: a ball that leaves a floor at e times that is back after 4 e steps
ROUND_UP = 1.000001  # times a distance within which rows or contacts are looked for: so none is lost, whatever is rounded
PRECISE = 1e-12  # of the slow speed: approach that does not matter
HELD = 5.0  # times the slow speed, where a partner is held already: else piles would rattle
REACH, REACH_IN_CROWDS = 1.0, 3.0  # radii that a sphere reaches at most, and in a crowd, however far it moves in a step


class Contacts(NamedTuple):
    """Half-edges of rows that may touch: those of row i are start[i] ... start[i + 1] - 1, walls first, then by partners' ids.

    start (n + 1,); partner (m,): a row or ghost, or `size`, which stands for all walls; slot (m,): its place in the arrays of
    impulses, e for half-edge e of the graph, which has m' of them, and m' + i walls + w for wall w of row i; normal (m, d),
    towards the row; gap (m,); larger_push (m,): the larger push of the two; crowd (m,): kept at any speed.
    """

    start: Array
    partner: Array
    slot: Array
    normal: Array
    gap: Array
    larger_push: Array
    crowd: Array


@lean_inner
def reach_of(radius, far, most):
    """Return the reach of a row that moves this `far`: at most `most` radii, unless it is a point."""
    return min(far, most * radius) if radius > 0.0 else far


@lean_inner
def length_of(vectors, i):
    """The length of row i of vectors (n, d)."""
    square = 0.0
    for k in range(vectors.shape[1]):
        square += vectors[i, k] * vectors[i, k]
    return sqrt(square)


@kernel
def widths(radius, vectors, scale, most):
    """Radii plus reaches (n,) of rows that go `scale` times the length of their vector (n, d), at most so many radii each."""
    found = np.empty(len(radius))
    for i in range(len(radius)):
        found[i] = radius[i] + reach_of(radius[i], scale * length_of(vectors, i), most)
    return found


@in_place
def contacts_with_walls(axes, row, body, reach, walls, made, contacts):
    """The contacts of a row with walls, behind the first `made` of the columns `contacts`; returns how many there are then.

    `body`: x (size + 1, d) of all; radius and push of the row, is it one of a crowd; `reach`: how far away a wall may be;
    `walls`: (faces, planes, which of them count, place of the row's first wall in the arrays of impulses).
    """
    x, radius, push, crowd = body
    (lower, upper, oblique), (point, normal), counts, first = walls
    partner, slot, normals, gaps, larger_push, any_speed = contacts
    i, near_face = np.uint64(row), bool(oblique)
    for k in range(len(axes)):  # most rows are near no face
        room = ROUND_UP * (radius + reach)
        near_face |= x[i, np.uint64(k)] - lower[k] < room or upper[k] - x[i, np.uint64(k)] < room
    for wall in range(len(point) if near_face else 0):
        distance = 0.0
        for k in range(len(axes)):
            distance += (x[i, np.uint64(k)] - point[wall, k]) * normal[wall, k]
        if counts[wall] and distance - radius <= reach:
            for k in range(len(axes)):
                normals[made, np.uint64(k)] = normal[wall, k]
            partner[made], larger_push[made], gaps[made] = len(x) - 1, push, distance - radius
            slot[made], any_speed[made] = first + wall, crowd
            made += np.uint64(1)
    return made


@in_place
def contacts_with_rows(axes, row, state, graph, inside, h, length, made, contacts):
    """The contacts of a row with others of the near pairs, behind the first `made`; see `contacts_with_walls`.

    `state`: as of `find_half_edges`, with the lengths of v and push.
    """
    x, speeds, pushes, radius, w, crowd = state
    near, other = graph
    partner, slot, normals, gaps, larger_push, any_speed = contacts
    i = np.uint64(row)
    for e in range(np.uint64(near[row]), np.uint64(near[row + 1])):
        j = np.uint64(other[e])
        wide = max(pushes[i], pushes[j])
        if not inside[j] or w[i] + w[j] == 0.0 or not wide > 0.0:
            continue
        of_crowd = crowd[i] or crowd[j]
        radius_i, radius_j = radius[i], radius[j]
        far_i, far_j = HELD * pushes[i] * h, HELD * pushes[j] * h
        reach = min(max(far_i, far_j), reach_of(radius_i, far_i, REACH) + reach_of(radius_j, far_j, REACH))
        if of_crowd:
            way_i, way_j = speeds[i] * h, speeds[j] * h
            reach = max(reach, reach_of(radius_i, way_i, REACH_IN_CROWDS) + reach_of(radius_j, way_j, REACH_IN_CROWDS))
        r2, both = 0.0, radius_i + radius_j
        for k in range(len(axes)):
            r = nearest(x[i, np.uint64(k)] - x[j, np.uint64(k)], length[k])
            normals[made, np.uint64(k)] = r
            r2 += r * r
        if r2 > (1.0 + 1e-9) * (both + reach) ** 2:
            continue
        distance = sqrt(r2)
        gap = distance - both
        if not distance > 0.0 or gap > reach:
            continue
        for k in range(len(axes)):
            normals[made, np.uint64(k)] /= distance
        partner[made], slot[made], larger_push[made], gaps[made], any_speed[made] = other[e], e, wide, gap, of_crowd
        made += np.uint64(1)
    return made


@kernel
def find_half_edges(axes, state, graph, inside, h, length, faces, planes, taking):
    """All half-edges between rows `inside` that may be slow, or that are among a crowd: the columns of `Contacts`.

    `state`: x, v, push (size + 1, d), radius, w, crowd (size + 1,) of rows, ghosts and a wall; `graph`: (start, other) of the
    near pairs; `faces`: see `near_walls`; `planes`: (points, normals) of the walls; `taking` (walls,): which keep a row that
    touches no other, too.
    """
    x, v, push, radius, w, crowd = state
    near, other = graph
    n, walls = len(near) - 1, len(planes[0])
    most = len(other)
    for row in range(n):
        most += walls * inside[row]
    start, partner, slot = np.zeros(n + 1, np.int64), np.empty(most, np.int32), np.empty(most, np.int64)
    normals, gaps, larger_push = np.empty((most, len(axes))), np.empty(most), np.empty(most)
    any_speed = np.empty(most, np.bool_)
    contacts = partner, slot, normals, gaps, larger_push, any_speed
    pushes, speeds = np.empty(len(x)), np.empty(len(x))
    for i in range(len(x)):
        pushes[i], speeds[i] = length_of(push, i), length_of(v, i)
    state = x, speeds, pushes, radius, w, crowd
    every, made = np.ones(walls, np.bool_), np.uint64(0)
    for row in range(n):
        start[row] = first = made
        if not inside[row]:
            continue
        body, reach = (x, radius[row], pushes[row], crowd[row]), max(HELD * pushes[row], speeds[row] * crowd[row]) * h
        of_row = len(other) + row * walls
        if w[row] > 0.0 and pushes[row] > 0.0:
            made = contacts_with_walls(axes, row, body, reach, (faces, planes, every, of_row), made, contacts)
        on_walls = made
        made = contacts_with_rows(axes, row, state, graph, inside, h, length, made, contacts)
        if first < made == on_walls:  # a sphere by itself bounces off walls that take no energy, however slowly
            made = contacts_with_walls(axes, row, body, reach, (faces, planes, taking, of_row), first, contacts)
    start[n] = made
    of = slice(0, start[n])
    return start, partner[of], slot[of], normals[of], gaps[of], larger_push[of], any_speed[of]
