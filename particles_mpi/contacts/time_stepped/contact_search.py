"""The compiled loops of the operator `rewind` that find contacts on the present segments, and overlaps.

All times count from the beginning of the drift, over a time h.
"""

import numpy as np

from particles_mpi.contacts.law import contact_time, may_come_near, overlap, separation
from particles_mpi.contacts.walls import may_hit, wall_contact
from particles_mpi.kernels.geometry import nearest
from particles_mpi.kernels.jit import in_place, lean, lean_inner
from particles_mpi.kernels.markers import NEVER, NO_PARTNER

NOTICEABLE = 1e-6  # of a radius: an overlap that is no round-off


@lean_inner(error_model="numpy")
def approaching(axes, x, v, radius, pairs, drift, length, periodic, a, b):
    """Candidate pairs whose segments, all from now, may touch in a drift = (time since the search, h); into a and b, returns
    how many.

    Most candidates are not near yet, or no longer: their rows are not looked at. Left out, too, are partners that move apart,
    or are clear of each other when they are nearest, at h or before. Nothing branches: each pair is written, and the next one
    over it if it does not count. Unsigned indices spare the test for a negative one.
    """
    first, second, begin, end = pairs
    time, h = drift
    near = 0
    for p in range(len(first)):
        b[near] = p
        near += (begin[p] <= time + h) & (end[p] >= time)
    found = 0
    for q in range(near):
        pair = np.uint64(b[q])
        i = np.uint64(first[pair])
        j = np.uint64(second[pair])
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
def with_active_row(start, last_partner, spheres, active, first, second, a, b):
    """Candidate pairs (first, second) of which one row is active; into a and b, returns how many.

    Partners whose segments both began when they met each other are left out: round-off must not make them meet twice. A fixed
    partner has the same segment all the time.
    """
    _, w, ids, _ = spheres
    found = 0
    for p in range(len(first)):
        i = np.int64(first[p])
        j = np.int64(second[p])
        if not (active[np.uint64(i)] | active[np.uint64(j)]):
            continue
        fixed_i, fixed_j = w[i] == 0.0, w[j] == 0.0
        met = (fixed_i or last_partner[i] == ids[j]) and (fixed_j or last_partner[j] == ids[i])
        if not (met and (fixed_i or fixed_j or start[i] == start[j])):
            a[found] = i
            b[found] = j
            found += 1
    return found


@lean
def find_contacts(axes, segments, spheres, pairs, drift, length, everything, active, hits):
    """Candidate `pairs` that touch on their segments in a drift = (time since the search, h), into `hits`; returns how many.

    In the first pass, in which all segments begin at time 0, with `everything`; later of the pairs with an active row only.
    """
    x, v, start, last_partner = segments
    radius, _, _, _ = spheres
    a, b, time = hits
    h = drift[1]
    if everything:
        periodic = length[0] > 0.0
        for k in range(1, len(axes)):
            periodic |= length[k] > 0.0
        likely = approaching(axes, x, v, radius, pairs, drift, length, periodic, a, b)
    else:
        likely = with_active_row(start, last_partner, spheres, active, pairs[0], pairs[1], a, b)
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
    a, b, time = hits
    for p in range(len(rows)):
        i = np.int64(rows[p])
        if (everything or active[i]) and may_hit(axes, x, v, np.int64(0), start[i], i, radius[i], h, planes):
            t, w = wall_contact(axes, x, v, np.int64(0), start[i], i, radius[i], last_partner[i], h, planes)
            if w >= 0:
                a[found] = i
                b[found] = -1 - w
                time[found] = t
                found += 1
    return found


@lean
def deepest_overlap(segments, radius, first, second, time, length):
    """The largest overlap of the pairs of rows (first, second) at their times, in units of the smaller radius; 0 if none."""
    most = 0.0
    for p in range(len(first)):
        i, j = np.int64(first[p]), np.int64(second[p])
        most = max(most, overlap_at(segments, radius, i, j, time[p], length))
    return most


@lean
def brushed_pairs(segments, spheres, first, second, h, length):
    """Return how many pairs of rows overlap at h of which both have had contacts; the owner of the first row counts a pair.

    If one was turned into the path of another that was computed before, they may part again before they are found to meet.
    """
    _, _, _, last_partner = segments
    radius, _, _, owned = spheres
    brushed = 0
    for p in range(len(first)):
        i, j = np.int64(first[p]), np.int64(second[p])
        if i < owned and last_partner[i] != NO_PARTNER and last_partner[j] != NO_PARTNER:
            brushed += overlap_at(segments, radius, i, j, h, length) > NOTICEABLE
    return brushed


@in_place
def overlap_at(segments, radius, i, j, t, length):
    """How far rows i and j overlap at t, in units of the smaller radius that is not 0; 0 if they do not."""
    x, v, start, _ = segments
    r2 = 0.0
    for k in range(len(length)):
        r = separation(x, v, start, i, j, k, t, length)
        r2 += r * r
    return overlap(r2, radius[i], radius[j])
