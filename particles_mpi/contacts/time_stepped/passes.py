"""The compiled loops of the operator `rewind` that select, of the contacts found, those that come first, and apply them."""

from typing import NamedTuple

import numpy as np

from particles_mpi.contacts.law import collide_pair, overlap
from particles_mpi.contacts.rough import Rough
from particles_mpi.contacts.time_stepped.contact_search import NOTICEABLE
from particles_mpi.contacts.walls import bounce_until, meet_wall
from particles_mpi.kernels.jit import in_place, kernel, lean
from particles_mpi.kernels.markers import NO_PARTNER
from particles_mpi.kernels.motion import move_to
from particles_mpi.particles import Array

COLLISIONS, WALL_HITS, MISSED, LATE = 0, 1, 2, 3  # what `counts` counts
TIME, LOW, HIGH = 0, 1, 2  # columns of `Selection.order`


class Selection(NamedTuple):
    """The earliest contact of each row in this pass."""

    partner: Array  # (n,) int64: the id of its partner, a wall as -1 - wall, or NO_PARTNER
    order: Array  # (owned, 3), of rows with a partner: TIME of the contact, LOW id, HIGH id or wall


class UndoLog(NamedTuple):
    """The state at the beginning of the drift of owned rows that have had a contact since."""

    rows: Array  # (owned,) int32, of which the first number[0] are filled
    x: Array  # (owned, d)
    v: Array  # (owned, d)
    spin: Array  # (owned, d(d-1)/2), no row where spheres are smooth
    number: Array


@in_place
def comes_first(row, t, wall, low, high, selection):
    """Note the contact (t, wall or pair, low, high) for `row` if it comes before the one selected for it; returns whether."""
    partner, order = selection
    before = order[row, TIME], partner[row] < 0, order[row, LOW], order[row, HIGH]
    if partner[row] != NO_PARTNER and before < (t, wall, low, high):
        return False
    order[row, TIME], order[row, LOW], order[row, HIGH] = t, low, high
    return True


@lean
def select_contacts(spheres, hits, selection):
    """Select the partner of the earliest hit of every owned row that has one, in place on `selection`.

    Fixed rows, whose inverse mass is 0, select none: a contact does not change them, so that they may have any number of contacts
    in a pass, as walls may.
    """
    _, w, ids, owned = spheres
    a, b, time = hits
    partner, _ = selection
    for p in range(len(a)):
        i = np.int64(a[p])
        j = np.int64(b[p])
        if j < 0:
            if comes_first(i, time[p], True, ids[i], -1 - j, selection):
                partner[i] = j
            continue
        if i < owned and w[i] > 0.0 and comes_first(i, time[p], False, ids[i], ids[j], selection):
            partner[i] = ids[j]
        if j < owned and w[j] > 0.0 and comes_first(j, time[p], False, ids[i], ids[j], selection):
            partner[j] = ids[i]


@kernel
def apply_contacts(axes, segments, spheres, hits, selected_partner, rules, active, log, counts, virial):
    """Apply the hits that both partners selected, or, if one is fixed, the other one.

    `rules`: loss of a pair, planes, `Rates`, `Rough`, periodic lengths (d,).

    Rows that changed, and rows with a hit that has to wait, are active in the next pass, and no others. `log` gets the owned rows
    of which this was the first contact. `counts` (4,) += collisions, wall hits and collisions that came late, each collision
    counted by the owner of the lower id. Its virial r.J is added to the row of the lower id, or to the other one if that is
    fixed; `virial` (owned,) is empty where it is not wanted.
    """
    x, v, start, last_partner = segments
    radius, w, ids, owned = spheres
    a, b, time = hits
    loss, planes, rates, rough, length = rules
    rough = Rough(*rough)
    _, normal, wall_restitution, wall_factor, _, _, _ = planes
    is_active, active_rows, active_number = active
    r = np.empty(len(axes))
    deactivate(is_active, active_rows, active_number)
    found = 0
    for p in range(len(a)):
        i = np.int64(a[p])
        j = np.int64(b[p])
        if w[i] > 0.0:
            found = activate(i, is_active, active_rows, found)
        if j < 0:
            if selected_partner[i] != j:
                continue
            note_start(segments, rough.spin, i, owned, log)
            move_to(axes, x, v, start, i, time[p])
            wall = -1 - j
            taken = wall_restitution[wall], wall_factor[wall]
            meet_wall(axes, v, np.int64(0), i, wall, radius[i], w[i], time[p], taken, normal, rates, rough)
            last_partner[i] = j
            counts[WALL_HITS] += 1
            continue
        if w[j] > 0.0:
            found = activate(j, is_active, active_rows, found)
        if (w[i] > 0.0 and selected_partner[i] != ids[j]) or (w[j] > 0.0 and selected_partner[j] != ids[i]):
            continue
        if w[i] > 0.0:
            note_start(segments, rough.spin, i, owned, log)
        if w[j] > 0.0:
            note_start(segments, rough.spin, j, owned, log)
        given = collide_pair(axes, segments, spheres, i, j, time[p], loss, length, rates, rough, r)
        for one, other in ((i, j), (j, i)):
            if w[one] > 0.0:
                last_partner[one] = ids[other]
            else:  # its segment is that of the whole drift: others may meet it earlier, and be found later
                start[one] = 0.0
        if i < owned:
            counts[COLLISIONS] += 1
            counts[LATE] += is_late(time[p], r, radius[i], radius[j])
        credited = i if w[i] > 0.0 else j  # of a pass, it has one contact only: no order changes a bit
        if credited < owned and len(virial):
            virial[credited] += given
    for p in range(found):
        selected_partner[active_rows[p]] = NO_PARTNER
    active_number[0] = found


@in_place
def is_late(t, r, one, other):
    """Did spheres of two radii that meet at t, r (d,) apart, overlap already when one of them was turned in this drift?

    A pass may do a contact of one pair before an earlier one of another pair.
    """
    r2 = 0.0
    for k in range(len(r)):
        r2 += r[k] * r[k]
    return t > 0.0 and overlap(r2, one, other) > NOTICEABLE


@in_place
def deactivate(is_active, active_rows, active_number):
    """Make all rows inactive."""
    for p in range(active_number[0]):
        is_active[active_rows[p]] = False
    active_number[0] = 0


@in_place
def activate(i, is_active, active_rows, found):
    """Make row i active, and list it once behind the first `found`; returns how many are listed."""
    if not is_active[i]:
        is_active[i] = True
        active_rows[found] = i
        found += 1
    return found


@in_place
def note_start(segments, spin, i, owned, log):
    """Before the first contact of an owned row in this drift: log where it started."""
    x, v, _, last_partner = segments
    rows, log_x, log_v, log_spin, number = log
    if i >= owned or last_partner[i] != NO_PARTNER:
        return
    p = number[0]
    rows[p] = i
    for k in range(x.shape[1]):
        log_x[p, k] = x[i, k]
        log_v[p, k] = v[i, k]
    if len(spin) > 0:
        for c in range(spin.shape[1]):
            log_spin[p, c] = spin[i, c]
    number[0] = p + 1


@lean
def finish_walls(axes, segments, spheres, hits, h, rules, active, log):
    """Take the rows of the wall hits through all their wall contacts until h, whatever other particles are in the way.

    Returns how many contacts there were, and how many of these rows got nowhere. `rules`, `active`, `log`: as in
    `apply_contacts`. All rows with a hit are active then.
    """
    x, v, start, last_partner = segments
    radius, w, _, owned = spheres
    a, b, _ = hits
    _, planes, rates, rough, _ = rules
    rough = Rough(*rough)
    is_active, active_rows, active_number = active
    deactivate(is_active, active_rows, active_number)
    count = missed = found = 0
    for p in range(len(a)):
        i = np.int64(a[p])
        found = activate(i, is_active, active_rows, found)
        if b[p] >= 0:
            found = activate(np.int64(b[p]), is_active, active_rows, found)
            continue
        note_start(segments, rough.spin, i, owned, log)
        more, stuck, last_partner[i] = bounce_until(
            axes, x, v, start, last_partner[i], i, radius[i], w[i], h, planes, rates, rough
        )
        count, missed = count + more, missed + stuck
    active_number[0] = found
    return count, missed
