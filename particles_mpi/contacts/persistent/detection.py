"""Which contacts last: see `operator`. Plain arrays.

`push` (d,) of a row is the speed that forces give it in a step, times SLOW. What *presses* a contact is a speed of the same
kind, and belongs to the direction of its normal n: forces and all other contacts together, if they press it; and the part of
what contacts of its partners bear that lies along n. That of a partner is n S n with its stress S, the sum of borne n' n'
over its contacts n'. A contact is slow below the speed that presses it, or HELD times that between those who are held. So a
ball that rolls along a floor meets another one, or a wall, at any speed: the floor does not bear along that normal.
"""

from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from particles_mpi.kernels.geometry import nearest
from particles_mpi.kernels.jit import kernel, lean_inner
from particles_mpi.kernels.markers import PRESSED
from particles_mpi.particles import Array

SLOW = 2.0  # times what forces do in a step: a bounce that is over in about two steps
HELD = 5.0  # times as fast may it be among those that are held, who would rattle between one another
MARGIN = 1e-3  # of the widest slow gap: closer nothing gets, so that round-off makes no contact
RETURN = 0.2  # of what contacts are off their margin is mended in a step
PUSH = 0.01  # of what forces do in a step: so fast contacts that are nearer than their margin are moved apart


class Contacts(NamedTuple):
    """Half-edges of rows that may touch: those of row i are start[i] ... start[i + 1] - 1, walls first, then by partners' ids.

    start (n + 1,); partner (m,): a row or ghost, or `size`, which stands for all walls; slot (m,): where the half-edge is in the
    graph, or the graph's half-edges and then i walls + wall; normal (m, d), towards the row; gap (m,); widest (m,): the larger
    push of the two; crowd (m,): kept at any speed.
    """

    start: Array
    partner: Array
    slot: Array
    normal: Array
    gap: Array
    widest: Array
    crowd: Array


@lean_inner
def wall_push(x, v, push, radius, i, w, point, normal):
    """Of row i, which has the given push, at wall w: (push onto it, approach, gap)."""
    pressed, closing, distance = 0.0, 0.0, 0.0
    for k in range(x.shape[1]):
        pressed -= push[k] * normal[w, k]
        closing -= v[i, k] * normal[w, k]
        distance += (x[i, k] - point[w, k]) * normal[w, k]
    return pressed, closing, distance - radius[i]


@lean_inner
def has_slow_wall(x, v, a, radius, i, h, push, point, normal):
    """Has row i a slow contact with a wall, which forces press? push (d,): room for its push."""
    slow = False
    for k in range(x.shape[1]):
        push[k] = SLOW * h * a[i, k]
    for wall in range(len(point)):
        pressed, closing, gap = wall_push(x, v, push, radius, i, wall, point, normal)
        slow |= pressed > 0.0 and gap <= pressed * h and abs(closing) <= pressed
    return slow


@kernel
def near_walls(x, v, a, radius, fixed, supported, h, lower, upper, oblique, point, normal):
    """Rows that are fixed or supported, or have a slow contact with a wall.

    `lower`, `upper`: faces beyond which the first walls are.
    """
    d = x.shape[1]
    rows, found = np.empty(len(x), np.int64), 0
    push, low, high = np.empty(d), np.empty(d), np.empty(d)
    most = 0.0
    for i in range(len(x)):
        a2 = 0.0
        for k in range(d):
            a2 += a[i, k] * a[i, k]
        most = max(most, a2)
    for k in range(d):  # within these no sphere is near a face, whatever its push: most rows need no closer look
        far = 1.000001 * SLOW * h * h * sqrt(most)
        low[k] = lower[k] + far + 1e-12 * max(lower[k], -lower[k]) if lower[k] > -inf else -inf
        high[k] = upper[k] - far - 1e-12 * max(upper[k], -upper[k]) if upper[k] < inf else inf
    for i in range(len(x)):
        here = (supported[i] != 0) | (fixed[i] != 0)
        inside = not oblique
        for k in range(d):
            inside &= (x[i, k] >= low[k] + radius[i]) & (x[i, k] <= high[k] - radius[i])
        if inside & (not here):
            continue
        if here or has_slow_wall(x, v, a, radius, i, h, push, point, normal):
            rows[found] = i
            found += 1
    return rows[:found]


@kernel
def near_walls_among(rows, x, v, a, radius, supported, h, point, normal):
    """Those of `rows` that are supported, or have a slow contact with a wall."""
    chosen, found, push = np.empty(len(rows), np.int64), 0, np.empty(x.shape[1])
    for i in rows:
        chosen[found] = i
        found += supported[i] != 0 or has_slow_wall(x, v, a, radius, i, h, push, point, normal)
    return chosen[:found]


@kernel
def widths(radius, a, h, out):
    """Of rows with accelerations a (n, d): two with a slow contact are no further apart than the sum of theirs. To out (n,)."""
    for i in range(len(radius)):
        a2 = 0.0
        for k in range(a.shape[1]):
            a2 += a[i, k] * a[i, k]
        out[i] = radius[i] + HELD * SLOW * h * h * sqrt(a2)


@kernel
def gather(rows, position, velocity, a, supported, scale, x, v, push, held):
    """The state of `rows` of the particles, pushes being accelerations times `scale`; the last row is that of a wall."""
    d, last = x.shape[1], len(x) - 1
    for n in range(len(rows)):
        i = rows[n]
        for k in range(d):
            x[n, k], v[n, k], push[n, k] = position[i, k], velocity[i, k], scale * a[i, k]
        held[n] = supported[i]
    x[last], v[last], push[last], held[last] = 0.0, 0.0, 0.0, 0.0


@kernel
def hand_over(rows, v, held, velocity, supported):
    """Velocities v (n, d) and who is `held` (n,) to the particles' `rows`; returns the rows that changed, and by how much."""
    changed, by, found = np.empty(len(rows), np.int64), np.empty(v.shape), 0
    for n in range(len(rows)):
        i, differs = rows[n], False
        supported[i] = PRESSED * held[n]
        for k in range(v.shape[1]):
            by[found, k] = v[n, k] - velocity[i, k]
            differs |= by[found, k] != 0.0
            velocity[i, k] = v[n, k]
        changed[found] = i
        found += differs
    return changed[:found], by[:found]


@kernel
def find_contacts(axes, state, graph, inside, h, length, faces, planes):
    """All half-edges between rows `inside` that may be slow, or that are among a crowd: the columns of `Contacts`.

    `state`: x, v, push (size + 1, d), radius, w, crowd (size + 1,) of rows, ghosts and a wall; `graph`: (start, other) of the
    near pairs; `faces`: see `near_walls`; `planes`: (points, normals) of the walls.
    """
    x, v, push, radius, w, crowd = state
    near, other = graph
    lower, upper, oblique = faces
    point, normal = planes
    n, d, walls, size = len(near) - 1, len(axes), len(point), len(x) - 1
    most = len(other)
    for row in range(n):
        most += walls * inside[row]
    start, partner, slot = np.zeros(n + 1, np.int64), np.empty(most, np.int32), np.empty(most, np.int64)
    normals, gaps, widest = np.empty((most, d)), np.empty(most), np.empty(most)
    any_speed = np.empty(most, np.bool_)
    pushes, speeds = np.empty(len(x)), np.empty(len(x))
    for row in range(len(x)):
        push2, speed2 = 0.0, 0.0
        for k in range(d):
            push2 += push[row, k] * push[row, k]
            speed2 += v[row, k] * v[row, k]
        pushes[row], speeds[row] = sqrt(push2), sqrt(speed2)
    made = np.uint64(0)
    for row in range(n):
        start[row] = made
        if not inside[row]:
            continue
        i = np.uint64(row)
        reach = max(HELD * pushes[i], speeds[i] * crowd[i]) * h
        by_wall = bool(oblique)
        for k in range(len(axes)):  # most rows are near no face
            room = 1.000001 * (radius[i] + reach)
            by_wall |= x[i, np.uint64(k)] - lower[k] < room or upper[k] - x[i, np.uint64(k)] < room
        for wall in range(walls if by_wall else 0):
            distance = 0.0
            for k in range(len(axes)):
                distance += (x[i, np.uint64(k)] - point[wall, k]) * normal[wall, k]
            wide, gap = pushes[i], distance - radius[i]
            if w[i] > 0.0 and wide > 0.0 and gap <= reach:
                for k in range(len(axes)):
                    normals[made, np.uint64(k)] = normal[wall, k]
                partner[made], widest[made], gaps[made] = size, wide, gap
                slot[made], any_speed[made] = len(other) + row * walls + wall, crowd[i]
                made += np.uint64(1)
        for e in range(np.uint64(near[row]), np.uint64(near[row + 1])):
            j = np.uint64(other[e])
            wide = max(pushes[i], pushes[j])
            if not inside[j] or w[i] + w[j] == 0.0 or not wide > 0.0:
                continue
            of_crowd = crowd[i] or crowd[j]
            reach = HELD * wide * h
            if of_crowd:
                reach = max(reach, (speeds[i] + speeds[j]) * h)
            r2, both = 0.0, radius[i] + radius[j]
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
            partner[made], slot[made], widest[made], gaps[made] = other[e], e, wide, gap
            any_speed[made] = of_crowd
            made += np.uint64(1)
    start[n] = made
    of = slice(0, start[n])
    return start, partner[of], slot[of], normals[of], gaps[of], widest[of], any_speed[of]


@kernel
def approach(axes, start, partner, normal, v):
    """The speed at which each half-edge closes, (m,), at velocities v (size + 1, d)."""
    closing, one = np.empty(len(partner)), np.uint64(1)
    for i in range(np.uint64(len(start) - 1)):
        for e in range(np.uint64(start[i]), np.uint64(start[i + one])):
            j, speed = np.uint64(partner[e]), 0.0
            for k in range(len(axes)):
                speed -= (v[i, np.uint64(k)] - v[j, np.uint64(k)]) * normal[e, np.uint64(k)]
            closing[e] = speed
    return closing


@kernel
def loads(axes, start, partner, normal, w, borne, push, left, stress):
    """Of each row with pushes (n, d) whose half-edges bear `borne`: what is left (n, d) of its push, and its stress (n, d, d)."""
    one = np.uint64(1)
    for i in range(np.uint64(len(start) - 1)):
        for k in range(len(axes)):
            left[i, np.uint64(k)] = push[i, np.uint64(k)]
            for m in range(len(axes)):
                stress[i, np.uint64(k), np.uint64(m)] = 0.0
        for e in range(np.uint64(start[i]), np.uint64(start[i + one])):
            given = w[i] / (w[i] + w[np.uint64(partner[e])]) * borne[e]
            for k in range(len(axes)):
                part = given * normal[e, np.uint64(k)]
                left[i, np.uint64(k)] += part
                for m in range(len(axes)):
                    stress[i, np.uint64(k), np.uint64(m)] += part * normal[e, np.uint64(m)]


@kernel
def pressing(axes, start, partner, normal, borne, before, left, stress):
    """The speed that presses each contact: by forces and other contacts along its normal, or as `before` (m,)."""
    speeds, one = np.empty(len(partner)), np.uint64(1)
    for i in range(np.uint64(len(start) - 1)):
        for e in range(np.uint64(start[i]), np.uint64(start[i + one])):
            along, others, j = 0.0, 0.0, np.uint64(partner[e])
            for k in range(len(axes)):
                of = np.uint64(k)
                others += (left[i, of] - left[j, of]) * normal[e, of]
                for m in range(len(axes)):
                    also = np.uint64(m)
                    along += normal[e, of] * normal[e, also] * (stress[i, of, also] + stress[j, of, also])
            speeds[e] = max(before[e], abs(others - borne[e]), along)
    return speeds


@kernel
def slow(contacts, closing, took, of_rows, pressed, h, tolerance, margin, precise):
    """Which contacts are slow, and what is asked of them (`may_close`, `loose`, `tight`), 0 for the others.

    `of_rows`: who is held already, and radii. A contact that `took` something is held too. Errors are allowed up to `tolerance`
    radii of the smaller sphere in a step, or `precise` times the speed below which a contact is slow; contacts keep a gap of
    `margin` tolerances, to which they return in some steps, or errors of one step would be the work of the next one.
    """
    start, partner, _, _, gap, widest, crowd = contacts
    supported, radius = of_rows
    m = len(gap)
    chosen, may_close, loose, tight = np.zeros(m, np.bool_), np.zeros(m), np.zeros(m), np.zeros(m)
    for i in range(np.uint64(len(start) - 1)):
        for e in range(np.uint64(start[i]), np.uint64(start[i + np.uint64(1)])):
            j = np.uint64(partner[e])
            held = took[e] > 0.0 or supported[i] or supported[j]
            most = HELD * widest[e]
            speed = min((HELD if held else 1.0) * pressed[e], most)
            if crowd[e] or (speed > 0.0 and gap[e] <= speed * h and abs(closing[e]) <= speed):
                one, other = radius[i], radius[j]
                allowed = tolerance * (min(one, other) if one > 0.0 and other > 0.0 else max(one, other))
                apart = margin * allowed
                room = gap[e] - apart - MARGIN * most * h
                if apart > 0.0:
                    room = max(room - (1.0 - RETURN) * min(room, 5.0 * allowed), -PUSH * widest[e] * h)
                else:
                    room = max(room, 0.0)
                chosen[e], may_close[e] = True, room / h
                tight[e] = 1.0 / (precise * (most if crowd[e] else speed))
                loose[e] = min(h / allowed, tight[e]) if allowed > 0.0 else tight[e]
    return chosen, may_close, loose, tight


@kernel
def spread(start, other, x, wide, length, crowd):
    """Who touches one of a crowd, widths taken together, belongs to it: marks rows; returns whether any was new. In place."""
    new = False
    more = True
    while more:
        more = False
        for i in range(len(start) - 1):
            if crowd[i]:
                continue
            for e in range(start[i], start[i + 1]):
                j = other[e]
                if not crowd[j]:
                    continue
                r2 = 0.0
                for k in range(x.shape[1]):
                    r2 += nearest(x[i, k] - x[j, k], length[k]) ** 2
                if r2 <= (wide[i] + wide[j]) ** 2:
                    crowd[i] = new = more = True
                    break
    return new


@kernel
def carried(start, taken):
    """Which rows have a half-edge that took something; (n,) uint8."""
    rows = np.zeros(len(start) - 1, np.uint8)
    for i in range(len(rows)):
        for e in range(start[i], start[i + 1]):
            rows[i] |= taken[e] > 0.0
    return rows


@lean_inner
def touches(x, i, wide, zone):
    """Does the sphere of row i, of the radius `wide`, touch the box `zone` (2, d)?"""
    inside = True
    for k in range(x.shape[1]):
        inside &= (x[i, k] + wide >= zone[0, k]) & (x[i, k] - wide <= zone[1, k])
    return inside


@kernel
def inside_zone(x, push, radius, h, zone):
    """Which rows and ghosts touch the zone (2, d), with their widths."""
    inside = np.empty(len(x), np.bool_)
    for i in range(len(x)):
        push2 = 0.0
        for k in range(x.shape[1]):
            push2 += push[i, k] * push[i, k]
        inside[i] = touches(x, i, radius[i] + HELD * h * sqrt(push2), zone)
    return inside


@kernel
def zone_around(x, wide, rows):
    """-low and high (2 d,) of the box around these rows with their widths; -inf if there are none."""
    d = x.shape[1]
    ends = np.full(2 * d, -inf)
    for i in rows:
        for k in range(d):
            ends[k] = max(ends[k], wide[i] - x[i, k])
            ends[d + k] = max(ends[d + k], wide[i] + x[i, k])
    return ends
