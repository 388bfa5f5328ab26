"""The compiled loops of the operator `rewind`. A hit is (a, b, time): rows a, b of a pair, or row a and wall -1 - b."""

import numpy as np

from particles_mpi.contacts.law import contact_time, may_come_near, meet, separation
from particles_mpi.contacts.walls import bounce, bounce_until, may_hit, wall_contact
from particles_mpi.kernels.geometry import nearest
from particles_mpi.kernels.jit import kernel, lean, lean_inner
from particles_mpi.kernels.markers import NEVER, NOBODY
from particles_mpi.kernels.motion import move_to


@lean_inner(error_model="numpy")
def approaching(axes, x, v, radius, first, second, h, length, periodic, a, b):
    """Candidates whose legs, all from now, may touch within h; into a and b, returns how many. All but certain no's.

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
def changed(met, s, ids, live, first, second, a, b):
    """Candidates with a live row; into a and b, returns how many.

    Partners whose legs both began when they met each other are left out: round-off must not make them meet twice.
    """
    found = 0
    for p in range(len(first)):
        i = np.int64(first[p])
        j = np.int64(second[p])
        if live[np.uint64(i)] | live[np.uint64(j)] and not (met[i] == ids[j] and met[j] == ids[i] and s[i] == s[j]):
            a[found] = i
            b[found] = j
            found += 1
    return found


@lean
def find_contacts(axes, x, v, s, met, ids, radius, first, second, h, length, everything, live, a, b, time):
    """Candidate pairs that touch on their present legs; with `everything` False only those with a live row. Returns how many.

    `everything` is for the first pass, in which all legs begin at time 0.
    """
    if everything:
        periodic = length[0] > 0.0
        for k in range(1, len(axes)):
            periodic |= length[k] > 0.0
        likely = approaching(axes, x, v, radius, first, second, h, length, periodic, a, b)
    else:
        likely = changed(met, s, ids, live, first, second, a, b)
    found = 0
    for p in range(likely):
        i = np.int64(a[p])
        j = np.int64(b[p])
        t = contact_time(axes, x, v, s, i, j, radius[i] + radius[j], h, length)
        if t != NEVER:
            a[found] = i
            b[found] = j
            time[found] = t
            found += 1
    return found


@lean
def find_wall_hits(
    axes, x, v, s, met, radius, rows, h, everything, live, point, normal, lower, upper, oblique, a, b, time, found
):
    """Adds the earliest wall contact of each of the (live) rows' legs; returns the number of hits then."""
    for p in range(len(rows)):
        i = np.int64(rows[p])
        if (everything or live[i]) and may_hit(axes, x, v, np.int64(0), s[i], i, radius[i], h, lower, upper, oblique):
            t, w = wall_contact(axes, x, v, np.int64(0), s[i], i, radius[i], met[i], h, point, normal)
            if w >= 0:
                a[found] = i
                b[found] = -1 - w
                time[found] = t
                found += 1
    return found


@lean
def deepest(x, v, s, radius, a, b, time, length):
    """The largest overlap of the pairs among the hits when they meet, in smaller radii: somebody came in between too late."""
    most = 0.0
    for p in range(len(a)):
        i = np.int64(a[p])
        j = np.int64(b[p])
        if j >= 0:
            r2 = 0.0
            for k in range(x.shape[1]):
                r = separation(x, v, s, i, j, k, time[p], length)
                r2 += r * r
            most = max(most, (radius[i] + radius[j] - r2**0.5) / min(radius[i], radius[j]))
    return most


@lean
def deepest_at(x, v, s, radius, first, second, supported, end, length):
    """The largest overlap at time `end` of candidate pairs with a supported own row (the first rows), in smaller radii."""
    most = 0.0
    for p in range(len(first)):
        i = np.int64(first[p])
        j = np.int64(second[p])
        if not (i < len(supported) and supported[i]) and not (j < len(supported) and supported[j]):
            continue
        r2 = 0.0
        for k in range(x.shape[1]):
            r = separation(x, v, s, i, j, k, end, length)
            r2 += r * r
        if r2 < (radius[i] + radius[j]) ** 2:
            most = max(most, (radius[i] + radius[j] - r2**0.5) / min(radius[i], radius[j]))
    return most


@lean_inner
def prefer(row, t, wall, low, high, choice, best):
    """Make (t, wall or pair, low, high) the choice of `row` if it comes before what is chosen; `best` holds (t, low, high)."""
    if choice[row] != NOBODY:
        if t != best[row, 0]:
            if t > best[row, 0]:
                return False
        elif wall != (choice[row] < 0):
            if wall:
                return False
        elif low != best[row, 1]:
            if low > best[row, 1]:
                return False
        elif high > best[row, 2]:
            return False
    best[row, 0] = t
    best[row, 1] = low
    best[row, 2] = high
    return True


@lean
def choose(ids, owned, a, b, time, choice, best):
    """For every owned row with a hit the partner of its earliest one, as id or as wall -1, -2, ...; in place on `choice`."""
    for p in range(len(a)):
        i = np.int64(a[p])
        j = np.int64(b[p])
        if j < 0:
            if prefer(i, time[p], True, ids[i], -1 - j, choice, best):
                choice[i] = j
            continue
        if i < owned and prefer(i, time[p], False, ids[i], ids[j], choice, best):
            choice[i] = ids[j]
        if j < owned and prefer(j, time[p], False, ids[i], ids[j], choice, best):
            choice[j] = ids[i]


@kernel
def take_place(
    axes, x, v, s, met, w, ids, owned, a, b, time, choice, restitution, keep, length,
    normal, wall_restitution, wall_keep, rates, live, touched, log, log_x, log_v, logged, counts, virial,
):  # fmt: skip
    """Let the hits that both partners chose take place; returns (rows in `touched`, owned rows in the log of starts).

    Rows that changed, and rows with a hit that has to wait, are `live` in the next pass, and listed in `touched`.
    counts += (collisions, wall hits), each collision counted by the owner of the lower id; so is
    its virial, where that is wanted: `virial` (owned,) += -r.dp, else it is empty.
    """
    found = 0
    r = np.empty(len(axes))
    for p in range(len(a)):
        i = np.int64(a[p])
        j = np.int64(b[p])
        found = touch(i, live, touched, found)
        if j < 0:
            if choice[i] != j:
                continue
            logged = remember(x, v, met, i, owned, log, log_x, log_v, logged)
            move_to(axes, x, v, s, i, time[p])
            wall = -1 - j
            bounce(axes, v, np.int64(0), i, wall, normal, wall_restitution[wall], wall_keep[wall], w[i], time[p], rates)
            met[i] = j
            counts[1] += 1
            continue
        found = touch(j, live, touched, found)
        if choice[i] != ids[j] or choice[j] != ids[i]:
            continue
        logged = remember(x, v, met, i, owned, log, log_x, log_v, logged)
        logged = remember(x, v, met, j, owned, log, log_x, log_v, logged)
        given = meet(axes, x, v, s, w, i, j, time[p], restitution, keep, length, rates, r)
        met[i] = ids[j]
        met[j] = ids[i]
        if i < owned:
            counts[0] += 1
            if len(virial):
                virial[i] += given
    for p in range(found):
        choice[touched[p]] = NOBODY
    return found, logged


@lean_inner
def touch(i, live, touched, found):
    """Make row i live, and list it once; returns how many are listed."""
    if not live[i]:
        live[i] = True
        touched[found] = i
        found += 1
    return found


@lean_inner
def remember(x, v, met, i, owned, log, log_x, log_v, logged):
    """Before the first contact of an owned row in this drift: log where it started."""
    if i >= owned or met[i] != NOBODY:
        return logged
    log[logged] = i
    for k in range(x.shape[1]):
        log_x[logged, k] = x[i, k]
        log_v[logged, k] = v[i, k]
    return logged + 1


@lean
def finish_walls(axes, x, v, s, met, radius, w, a, b, h, point, normal, restitution, keep, rates):
    """Take the rows of the wall hits through all their wall contacts, blind to other particles; returns the number."""
    hits = 0
    for p in range(len(a)):
        if b[p] < 0:
            i = np.int64(a[p])
            hits += bounce_until(axes, x, v, s, met[i], i, radius[i], w[i], h, point, normal, restitution, keep, rates)
    return hits
