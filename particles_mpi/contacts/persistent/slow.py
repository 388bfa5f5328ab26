"""Which contacts last: what presses each of them, and below which speed it is slow. See `operator`. Plain arrays.

The speed that *presses* a contact with the normal n is the larger of two. One is the change of velocity along n that forces and
the other contacts give its partners in a step. The other is n S n, with the sum S of the stresses of both partners; the stress of
a row is the sum of n' n' times what each of its contacts gives to it, which is w/(w + w') of the contact's load. A contact is
slow below that speed, or below HELD times it where one partner is held already. So a ball that rolls on a floor meets another
one, or a wall, with restitution at any speed: the floor has no load along that normal.
"""

from math import inf

import numpy as np

from particles_mpi.contacts.persistent.detection import HELD, PRECISE
from particles_mpi.kernels.jit import kernel

SLOW_MARGIN = 1e-3  # of the widest slow gap: closer nothing gets, so that round-off makes no contact
RETURN = 0.2  # of the deviation from the gap that contacts keep is corrected in a step
PUSH = 0.01  # of the larger push of the two: so fast contacts that are nearer than their margin are moved apart
CROWD_GAP = 0.5  # of the gap, up to the margin, may errors in crowds close: so what is left is no hit in this step
MOST_RETURN = 5.0  # allowed errors: what is further off its margin returns no faster


@kernel
def approach(axes, start, partner, normal, v):
    """Return the speed (m,) at which each half-edge closes, at velocities v (size + 1, d)."""
    closing, one = np.empty(len(partner)), np.uint64(1)
    for i in range(np.uint64(len(start) - 1)):
        for e in range(np.uint64(start[i]), np.uint64(start[i + one])):
            j, speed = np.uint64(partner[e]), 0.0
            for k in range(len(axes)):
                speed -= (v[i, np.uint64(k)] - v[j, np.uint64(k)]) * normal[e, np.uint64(k)]
            closing[e] = speed
    return closing


@kernel
def loads(axes, start, partner, normal, w, load, push, net_push, stress):
    """Compute the net push (n, d) of each row, with what contacts under this `load` give it, and its stress (n, d, d)."""
    one = np.uint64(1)
    for i in range(np.uint64(len(start) - 1)):
        for k in range(len(axes)):
            net_push[i, np.uint64(k)] = push[i, np.uint64(k)]
            for m in range(len(axes)):
                stress[i, np.uint64(k), np.uint64(m)] = 0.0
        for e in range(np.uint64(start[i]), np.uint64(start[i + one])):
            given = w[i] / (w[i] + w[np.uint64(partner[e])]) * load[e]
            for k in range(len(axes)):
                part = given * normal[e, np.uint64(k)]
                net_push[i, np.uint64(k)] += part
                for m in range(len(axes)):
                    stress[i, np.uint64(k), np.uint64(m)] += part * normal[e, np.uint64(m)]


@kernel
def pressing(axes, start, partner, normal, load, before, push, net_push, stress):
    """The speed (m,) that presses each contact: the largest of `before`, of what the net pushes of both partners, but for this
    contact itself, are along its normal, and of what their stress is along it.

    Where the pushes of forces alone (`push`) pull the partners apart, net pushes count only as far as they press them. Elsewhere
    those that pull count by their size too: in a pile they press again soon.
    """
    speeds, one = np.empty(len(partner)), np.uint64(1)
    for i in range(np.uint64(len(start) - 1)):
        for e in range(np.uint64(start[i]), np.uint64(start[i + one])):
            along, others, forces, j = 0.0, 0.0, 0.0, np.uint64(partner[e])
            for k in range(len(axes)):
                of = np.uint64(k)
                others += (net_push[i, of] - net_push[j, of]) * normal[e, of]
                forces += (push[i, of] - push[j, of]) * normal[e, of]
                for m in range(len(axes)):
                    also = np.uint64(m)
                    along += normal[e, of] * normal[e, also] * (stress[i, of, also] + stress[j, of, also])
            pressed = load[e] - others
            speeds[e] = max(before[e], pressed if forces > 0.0 else abs(pressed), along)
    return speeds


@kernel
def slow(contacts, closing, last_impulses, of_rows, pressed, h, tolerance, margin, slight):
    """Return which contacts are slow, and the targets of these (`may_close`, `per_allowed`, `per_round_off`), 0 for the others.

    `of_rows`: which rows are held already, and radii. A contact that had one of the `last_impulses` is held too. Errors are
    allowed up to `tolerance` radii of the smaller sphere in a step, or PRECISE times the speed below which a contact is slow, or
    times `slight` of the larger push of the two where that is more. Contacts keep a gap of `margin` tolerances, to which they
    return in some steps; otherwise errors of one step would be the work of the next one.
    """
    start, partner, _, _, gap, larger_push, crowd = contacts
    supported, radius = of_rows
    m = len(gap)
    chosen, may_close, per_allowed, per_round_off = np.zeros(m, np.bool_), np.zeros(m), np.zeros(m), np.zeros(m)
    for i in range(np.uint64(len(start) - 1)):
        for e in range(np.uint64(start[i]), np.uint64(start[i + np.uint64(1)])):
            j = np.uint64(partner[e])
            held = last_impulses[e] > 0.0 or supported[i] or supported[j]
            most = HELD * larger_push[e]
            speed = min((HELD if held else 1.0) * pressed[e], most)
            if crowd[e] or (speed > 0.0 and gap[e] <= speed * h and abs(closing[e]) <= speed):
                one, other = radius[i], radius[j]
                size = min(one, other) if one > 0.0 and other > 0.0 else max(one, other)
                allowed = tolerance * size if size < inf else 0.0  # else a point is on a wall
                apart = margin * allowed
                room = gap[e] - apart - SLOW_MARGIN * most * h
                if apart > 0.0:
                    room = max(room - (1.0 - RETURN) * min(room, MOST_RETURN * allowed), -PUSH * larger_push[e] * h)
                else:
                    room = max(room, 0.0)
                chosen[e], may_close[e] = True, room / h
                speed = most if crowd[e] else max(speed, slight * larger_push[e])
                left = CROWD_GAP * min(gap[e] / h, SLOW_MARGIN * most) if crowd[e] else 0.0
                per_round_off[e] = 1.0 / max(PRECISE * speed, left)
                per_allowed[e] = min(h / allowed, per_round_off[e]) if allowed > 0.0 else per_round_off[e]
    return chosen, may_close, per_allowed, per_round_off


@kernel
def felt_push(start, partner, w, larger_push, normal_impulses):
    """Return the largest push (n,) of the contacts by which each row bears a load; only the part that moves the row.

    That is w_i/(w_i + w_j) of it, which is little for a heavy row on which a light one lies. w (size + 1,): inverse masses.
    """
    found = np.zeros(len(start) - 1)
    for i in range(len(found)):
        for e in range(start[i], start[i + 1]):
            if normal_impulses[e] > 0.0:
                found[i] = max(found[i], w[i] / (w[i] + w[partner[e]]) * larger_push[e])
    return found


@kernel
def carried(start, impulses):
    """Which rows have a half-edge with an impulse; (n,) uint8."""
    rows = np.zeros(len(start) - 1, np.uint8)
    for i in range(len(rows)):
        for e in range(start[i], start[i + 1]):
            rows[i] |= impulses[e] > 0.0
    return rows
