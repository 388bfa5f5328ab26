"""The compiled loops of the operator `rewind`: find contacts, select those that come first, apply them.

All times count from the beginning of the drift, over a time h. `axes` is a tuple with one entry an axis.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from particles_mpi.contacts.law import Loss, collide_pair, contact_time, may_come_near, separation
from particles_mpi.contacts.velocity_flow import Rates
from particles_mpi.contacts.walls import bounce, bounce_until, may_hit, wall_contact
from particles_mpi.kernels.geometry import nearest
from particles_mpi.kernels.jit import kernel, lean, lean_inner
from particles_mpi.kernels.markers import NEVER, NOBODY
from particles_mpi.kernels.motion import move_to
from particles_mpi.particles import Array

COLLISIONS, WALL_HITS, MISSED = 0, 1, 2  # what `counts` counts
TIME, LOW, HIGH = 0, 1, 2  # columns of `Selection.order`


class ContactRules(NamedTuple):
    """What a contact does to velocities: loss between particles, walls, how forces act meanwhile, periodic lengths (d,)."""

    loss: Loss
    planes: tuple[Any, ...]  # `Planes`, as a plain tuple
    rates: Rates
    length: Array


class Selection(NamedTuple):
    """Of each row its earliest contact in this pass.

    partner (n,) int64: the id of its partner, a wall as -1 - wall, or NOBODY. order (owned, 3): the time of the contact, the
    lower id and the higher one (or the wall), by which contacts at the same time are told apart; of rows with a partner only.
    """

    partner: Array
    order: Array


class UndoLog(NamedTuple):
    """Where owned rows were at the beginning of the drift, of those that have had a contact since.

    rows (owned,) int32, x, v (owned, d); the first number[0] of them are filled.
    """

    rows: Array
    x: Array
    v: Array
    number: Array


@lean_inner(error_model="numpy")
def approaching(axes, x, v, radius, first, second, h, length, periodic, a, b):
    """Candidate pairs (first, second) whose segments, all from now, may touch within h; into a and b, returns how many.

    Left out: partners that move apart, or are clear of each other when they are nearest, at h or before. Nothing branches:
    each pair is written, and the next one over it if it does not count. Unsigned indices spare the test for a negative one.
    """
    found = 0
    for p in range(len(first)):
        i = np.uint64(first[p])
        j = np.uint64(second[p])
        u2 = 0.0
        ru = 0.0
        r2 = 0.0
        for k in range(len(axes)):
            r = x[i, k] - x[j, k]
            if periodic:
                r = nearest(r, length[k])
            u = v[i, k] - v[j, k]
            u2 += u * u
            ru += r * u
            r2 += r * r
        a[found] = i
        b[found] = j
        found += may_come_near(u2, ru, r2, radius[i] + radius[j], h)
    return found


@lean_inner
def with_active_row(start, last_partner, ids, active, first, second, a, b):
    """Candidate pairs (first, second) of which one row is active; into a and b, returns how many.

    Partners whose segments both began when they met each other are left out: round-off must not make them meet twice.
    """
    found = 0
    for p in range(len(first)):
        i = np.int64(first[p])
        j = np.int64(second[p])
        if active[np.uint64(i)] | active[np.uint64(j)] and not (
            last_partner[i] == ids[j] and last_partner[j] == ids[i] and start[i] == start[j]
        ):
            a[found] = i
            b[found] = j
            found += 1
    return found


@lean
def find_contacts(axes, segments, spheres, first, second, h, length, everything, active, hits):
    """Candidate pairs (first, second) that touch on their present segments, into `hits`; returns how many.

    In the first pass, in which all segments begin at time 0, with `everything`; later of the pairs with an active row only.
    """
    x, v, start, last_partner = segments
    radius, _, ids, _ = spheres
    a, b, time = hits
    if everything:
        periodic = length[0] > 0.0
        for k in range(1, len(axes)):
            periodic |= length[k] > 0.0
        likely = approaching(axes, x, v, radius, first, second, h, length, periodic, a, b)
    else:
        likely = with_active_row(start, last_partner, ids, active, first, second, a, b)
    found = 0
    for p in range(likely):
        i = np.int64(a[p])
        j = np.int64(b[p])
        t = contact_time(axes, x, v, start, i, j, radius[i] + radius[j], h, length)
        if t != NEVER:
            a[found] = i
            b[found] = j
            time[found] = t
            found += 1
    return found


@lean
def find_wall_hits(axes, segments, radius, rows, h, everything, active, planes, hits, found):
    """Add to the first `found` hits the earliest wall contact of each of `rows`, or of the active ones among them.

    Returns the number of hits then.
    """
    x, v, start, last_partner = segments
    point, normal, _, _, lower, upper, oblique = planes
    a, b, time = hits
    for p in range(len(rows)):
        i = np.int64(rows[p])
        if (everything or active[i]) and may_hit(axes, x, v, np.int64(0), start[i], i, radius[i], h, lower, upper, oblique):
            t, w = wall_contact(axes, x, v, np.int64(0), start[i], i, radius[i], last_partner[i], h, point, normal)
            if w >= 0:
                a[found] = i
                b[found] = -1 - w
                time[found] = t
                found += 1
    return found


@lean_inner(error_model="numpy")
def overlap_in_radii(segments, radius, i, j, t, length):
    """How far rows i and j overlap at time t, in units of the smaller radius; 0 if they do not."""
    x, v, start, _ = segments
    r2 = 0.0
    for k in range(len(length)):
        r = separation(x, v, start, i, j, k, t, length)
        r2 += r * r
    sum_of_radii = radius[i] + radius[j]
    return (sum_of_radii - r2**0.5) / min(radius[i], radius[j]) if r2 < sum_of_radii**2 else 0.0


@lean
def deepest_hit(segments, radius, hits, length):
    """The largest overlap, in smaller radii, of the partners of any hit when they meet: a third one came between them late."""
    a, b, time = hits
    most = 0.0
    for p in range(len(a)):
        if b[p] >= 0:
            i, j = np.int64(a[p]), np.int64(b[p])
            most = max(most, overlap_in_radii(segments, radius, i, j, time[p], length))
    return most


@lean
def deepest_supported(segments, radius, first, second, supported, t, length):
    """The largest overlap, in smaller radii, at time t of candidate pairs with a supported row; `supported`: of owned rows."""
    most = 0.0
    for p in range(len(first)):
        i, j = np.int64(first[p]), np.int64(second[p])
        if (i < len(supported) and supported[i]) or (j < len(supported) and supported[j]):
            most = max(most, overlap_in_radii(segments, radius, i, j, t, length))
    return most


@lean_inner
def comes_first(row, t, wall, low, high, selection):
    """Note the contact (t, wall or pair, low, high) for `row` if it comes before the one selected for it; returns whether."""
    partner, order = selection
    if partner[row] != NOBODY:
        if t != order[row, TIME]:
            if t > order[row, TIME]:
                return False
        elif wall != (partner[row] < 0):
            if wall:
                return False
        elif low != order[row, LOW]:
            if low > order[row, LOW]:
                return False
        elif high > order[row, HIGH]:
            return False
    order[row, TIME] = t
    order[row, LOW] = low
    order[row, HIGH] = high
    return True


@lean
def select_contacts(ids, owned, hits, selection):
    """For every owned row with a hit the partner of its earliest one, in place on `selection`."""
    a, b, time = hits
    partner, _ = selection
    for p in range(len(a)):
        i = np.int64(a[p])
        j = np.int64(b[p])
        if j < 0:
            if comes_first(i, time[p], True, ids[i], -1 - j, selection):
                partner[i] = j
            continue
        if i < owned and comes_first(i, time[p], False, ids[i], ids[j], selection):
            partner[i] = ids[j]
        if j < owned and comes_first(j, time[p], False, ids[i], ids[j], selection):
            partner[j] = ids[i]


@kernel
def apply_contacts(axes, segments, spheres, hits, selected_partner, rules, active, log, counts, virial):
    """Apply the hits that both partners selected.

    Rows that changed, and rows with a hit that has to wait, are active in the next pass. `log` gets the owned rows of which
    this was the first contact. `counts` (3,) += collisions and wall hits, each collision counted by the owner of the lower
    id; so is its virial, where that is wanted: `virial` (owned,) += -r.dp, else it is empty.
    """
    x, v, start, last_partner = segments
    _, w, ids, owned = spheres
    a, b, time = hits
    loss, planes, rates, length = rules
    _, normal, wall_restitution, wall_factor, _, _, _ = planes
    is_active, active_rows, active_number = active
    r = np.empty(len(axes))
    found = 0
    for p in range(len(a)):
        i = np.int64(a[p])
        j = np.int64(b[p])
        found = activate(i, is_active, active_rows, found)
        if j < 0:
            if selected_partner[i] != j:
                continue
            note_start(segments, i, owned, log)
            move_to(axes, x, v, start, i, time[p])
            wall = -1 - j
            bounce(axes, v, np.int64(0), i, wall, normal, wall_restitution[wall], wall_factor[wall], w[i], time[p], rates)
            last_partner[i] = j
            counts[WALL_HITS] += 1
            continue
        found = activate(j, is_active, active_rows, found)
        if selected_partner[i] != ids[j] or selected_partner[j] != ids[i]:
            continue
        note_start(segments, i, owned, log)
        note_start(segments, j, owned, log)
        given = collide_pair(axes, segments, w, i, j, time[p], loss, length, rates, r)
        last_partner[i] = ids[j]
        last_partner[j] = ids[i]
        if i < owned:
            counts[COLLISIONS] += 1
            if len(virial):
                virial[i] += given
    for p in range(found):
        selected_partner[active_rows[p]] = NOBODY
    active_number[0] = found


@lean_inner
def activate(i, is_active, active_rows, found):
    """Make row i active, and list it once behind the first `found`; returns how many are listed."""
    if not is_active[i]:
        is_active[i] = True
        active_rows[found] = i
        found += 1
    return found


@lean_inner
def note_start(segments, i, owned, log):
    """Before the first contact of an owned row in this drift: log where it started."""
    x, v, _, last_partner = segments
    rows, log_x, log_v, number = log
    if i >= owned or last_partner[i] != NOBODY:
        return
    p = number[0]
    rows[p] = i
    for k in range(x.shape[1]):
        log_x[p, k] = x[i, k]
        log_v[p, k] = v[i, k]
    number[0] = p + 1


@lean
def finish_walls(axes, segments, spheres, hits, h, planes, rates):
    """Take the rows of the wall hits through all their wall contacts, blind to other particles; returns the number."""
    x, v, start, last_partner = segments
    radius, w, _, _ = spheres
    a, b, _ = hits
    count = 0
    for p in range(len(a)):
        if b[p] < 0:
            i = np.int64(a[p])
            count += bounce_until(axes, x, v, start, last_partner[i], i, radius[i], w[i], h, planes, rates)
    return count
