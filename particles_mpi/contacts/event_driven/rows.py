"""What a rank knows of particles during a drift: a row for each of its own particles, and for each ghost of another rank's one.

The log of a window of time tells which rows were changed in it, and what they were before, so that changes can be sent or undone.
A record of a row is its segment without the radius, then the first SAVED columns of its state, in the same memory, and then its
spin, if spheres are rough.
"""

from math import sqrt
from typing import NamedTuple

import numpy as np

from particles_mpi.kernels.fingerprint import GOLDEN
from particles_mpi.kernels.geometry import into_box
from particles_mpi.kernels.jit import in_place, inner, lean
from particles_mpi.kernels.markers import CROWD, NO_PARTNER, RADIUS, START
from particles_mpi.particles import Array

LAST_PARTNER, RAPID_EVENTS, TRAJECTORY_HASH, LAST_CONTACT, VIRIAL, ID, EVENT_COUNT, OWNERSHIP = range(8)  # columns of `state`
SAVED = 5  # the first of these are in a record
NOT_HERE, GHOST, OWN, SHARED = range(4)  # OWNERSHIP: a free row, another rank's particle, an own one, an own one others know
# RAPID_EVENTS is three numbers: of quick contacts, in units of 1; of contacts that follow one another within t_c, MOST_FOLLOWING
# at most, in units of FOLLOWING; and of contacts in succession that got nowhere, in units of ZERO_TIME_EVENT
FOLLOWING, MOST_FOLLOWING, ZERO_TIME_EVENT = 2**20, 2**12 - 1, 2**32
SQUEEZED = 1000 * ZERO_TIME_EVENT  # from here on a particle is squeezed: it has no more contacts in this drift
JAMMED = 2**60  # from here on others that come to it stop there, as it does; its velocity is kept times HARDLY, exactly
HARDLY = 2.0**-200  # too little for a velocity to change a position


class Rows(NamedTuple):
    """The rows as the kernels take them; some of them are free.

    A particle's path in a drift is made of straight segments: x + v (t - START) from its last contact on. Its position is not
    computed for other times before the next contact, so that reading it leaves no trace in the bits. Of each row, in `state`:
    LAST_PARTNER in this drift is an id, -1 - wall, or NO_PARTNER; TRAJECTORY_HASH, a hash of all its segments in this drift;
    EVENT_COUNT, how often its path was changed: an event that was predicted with another count is void. In `reals`: the time of
    its LAST_CONTACT, and VIRIAL, the sum of r.J over its collisions (`law.collide_pair`).
    """

    segment: Array  # (n, 2 d + 2): x (d), v (d), START, RADIUS
    segment_bits: Array  # the same memory as int64
    state: Array  # (n, 8) int64: one line of the cache
    reals: Array  # the same memory as float64
    acceleration: Array  # (n, d), or no row where it is the same for all
    drag: Array  # (n,) rates of drag, or no row without drag
    spin: Array  # (n, d(d-1)/2), or no row where spheres are smooth
    inverse_inertia: Array  # (n,) inverse moments of inertia, likewise


@inner
def dimension(rows):
    """Return the dimension of space, in kernels that are compiled once for all dimensions."""
    return rows.segment.shape[1] // 2 - 1


@lean
def start_drift(axes, rows, x, v, radius, last_contact, virial, acceleration, spin, own_rows):
    """Start own rows on segments from (x, v) at time 0; particle p is row own_rows[p]. The last three fields may have no row.

    Returns (moved, speed): was a position or radius changed since `end_drift`, and the largest speed, inf if anything is not
    finite.
    """
    rows = Rows(*rows)
    segment, state, reals = rows.segment, rows.state, rows.reals
    d = len(axes)
    moved = False
    fastest = 0.0
    for p in range(len(x)):
        i = own_rows[p]
        speed = 0.0
        for k in range(d):
            moved |= segment[i, k] != x[p, k]
            segment[i, k] = x[p, k]
            segment[i, d + k] = v[p, k]
            speed += v[p, k] * v[p, k] + 0.0 * x[p, k]
        moved |= segment[i, 2 * d + RADIUS] != radius[p]
        fastest = max(fastest, speed) if speed < np.inf else np.inf
        segment[i, 2 * d + START] = 0.0
        state[i, LAST_PARTNER], state[i, RAPID_EVENTS], state[i, TRAJECTORY_HASH] = NO_PARTNER, 0, 0
        reals[i, LAST_CONTACT] = last_contact[p]
        reals[i, VIRIAL] = virial[p] if len(virial) else 0.0
        if len(acceleration) > 0:
            for k in range(d):
                rows.acceleration[i, k] = acceleration[p, k]
        for c in range(spin_width(rows)):
            rows.spin[i, c] = spin[p, c]
    return moved, sqrt(fastest)


@lean
def end_drift(axes, rows, h, reference, box, stops):
    """Move all rows to time h, in a periodic box with their `reference` positions. Returns how many own rows were squeezed.

    Jammed rows get their velocities back, or velocity 0 if the drift `stops` them.
    """
    rows = Rows(*rows)
    segment, state = rows.segment, rows.state
    lower, _, length = box
    d = len(axes)
    squeezed = 0
    for i in range(len(segment)):
        if state[i, OWNERSHIP] == NOT_HERE:
            continue
        if state[i, RAPID_EVENTS] >= SQUEEZED:
            squeezed += state[i, OWNERSHIP] >= OWN
            segment[i, 2 * d + START] = h  # it stays where its last contact was
            if state[i, RAPID_EVENTS] >= JAMMED:
                for k in range(d):
                    segment[i, d + k] = 0.0 if stops else segment[i, d + k] / HARDLY
        for k in range(d):
            at = segment[i, k] + segment[i, d + k] * (h - segment[i, 2 * d + START])
            if length[k] > 0.0 and not lower[k] <= at < lower[k] + length[k]:
                inside = into_box(at, lower[k], lower[k] + length[k], length[k])
                reference[i, k] += inside - at
                at = inside
            segment[i, k] = at
        segment[i, 2 * d + START] = 0.0
    return squeezed


@lean
def write_back(axes, rows, x, v, last_contact, virial, supported, spin, crowd_from, own_rows):
    """Copy row own_rows[p] to particle p. Rows with `crowd_from` quick contacts become CROWD in `supported`, if that has rows."""
    rows = Rows(*rows)
    segment, state, reals = rows.segment, rows.state, rows.reals
    d = len(axes)
    for p in range(len(x)):
        i = own_rows[p]
        for k in range(d):
            x[p, k] = segment[i, k]
            v[p, k] = segment[i, d + k]
        for c in range(spin_width(rows)):
            spin[p, c] = rows.spin[i, c]
        last_contact[p] = reals[i, LAST_CONTACT]
        if len(virial):
            virial[p] = reals[i, VIRIAL]
        if len(supported) and state[i, RAPID_EVENTS] % FOLLOWING >= crowd_from:
            supported[p] = CROWD


@inner(inline="always")
def spin_width(rows):
    """Numbers of a spin, 0 where spheres are smooth."""
    return rows.spin.shape[1] if len(rows.spin) > 0 else 0


@inner(inline="always")
def record_width(d, spins):
    """Numbers in a record, in d dimensions; `spins`: see `spin_width`."""
    return 2 * d + START + 1 + SAVED + spins


@inner(inline="always")
def hash_place(d):
    """Where TRAJECTORY_HASH stands in a record."""
    return 2 * d + START + 1 + TRAJECTORY_HASH


class Log(NamedTuple):
    """Changes of n rows in the present window of time."""

    window: Array  # (1,) number of the window, 0 while no log is needed
    changed_count: Array  # (1,) rows that were changed in the window
    changed: Array  # (n,) int32, these, in the order of their first changes
    stamp: Array  # (1,) grows from window to window, by more than the changes in it: so marks need not be cleared
    mark: Array  # (n,) of a row that was changed in this window: stamp + its place in `changed`; of others less than the stamp
    saved: Array  # (n * record_width,) records of these rows, as they were before
    saved_bits: Array  # the same memory as int64
    fastest2: Array  # (1,) the largest square of a speed that a contact gave
    moved_count: Array  # (1,) own rows that got new reference positions, since `reconcile` dealt with the last ones
    moved: Array  # (n,) int32, these
    is_moved: Array  # (n,) bool
    border_count: Array  # (1,) changed rows that more than one rank knows
    border: Array  # (n,) int32, places of these in `changed`


def new_log(n: int, d: int, spins: int) -> Log:
    """For n rows in d dimensions, whose spins have so many components, 0 where spheres are smooth."""
    saved = np.empty(n * record_width(d, spins))
    one = np.zeros((4, 1), np.int64)
    return Log(
        one[0], one[1], np.empty(n, np.int32), np.ones(1, np.int64), np.zeros(n, np.int64), saved, saved.view(np.int64),
        np.zeros(1), one[2], np.empty(n, np.int32), np.zeros(n, np.bool_), one[3], np.empty(n, np.int32),
    )  # fmt: skip


@in_place
def save_row(d, rows, i, out, out_bits, at):
    """Write the record of row i, in d dimensions, to `out` from place `at` on; returns where it ends."""
    segment, state = rows.segment, rows.state
    for k in range(2 * d + START + 1):
        out[at + k] = segment[i, k]
    at += 2 * d + START + 1
    for k in range(SAVED):
        out_bits[at + k] = state[i, k]
    at += SAVED
    for c in range(spin_width(rows)):
        out[at + c] = rows.spin[i, c]
    return at + spin_width(rows)


@in_place
def load_row(d, rows, i, record, bits, at):
    """Restore row i from the record at place `at`; raise its event count, so that queued events with it are void."""
    segment, state = rows.segment, rows.state
    for k in range(2 * d + START + 1):
        segment[i, k] = record[at + k]
    at += 2 * d + START + 1
    for k in range(SAVED):
        state[i, k] = bits[at + k]
    for c in range(spin_width(rows)):
        rows.spin[i, c] = record[at + SAVED + c]
    state[i, EVENT_COUNT] += 1


@in_place
def save_once(axes, rows, i, log):
    """Save row i before its first change in a window."""
    mark, count = log.mark, log.changed_count
    if mark[i] < log.stamp[0]:
        mark[i] = log.stamp[0] + count[0]
        log.changed[count[0]] = i
        if rows.state[i, OWNERSHIP] != OWN:
            log.border[log.border_count[0]] = count[0]
            log.border_count[0] += 1
        save_row(np.int64(len(axes)), rows, i, log.saved, log.saved_bits, count[0] * record_width(len(axes), spin_width(rows)))
        count[0] += 1


@in_place
def note_segment(axes, rows, i, log):
    """Row i has begun a new segment: add it to the row's hash, and its speed to the log."""
    segment, bits, state = rows.segment, rows.segment_bits, rows.state
    d = len(axes)
    speed2 = 0.0
    h = state[i, TRAJECTORY_HASH] ^ state[i, LAST_PARTNER]
    for k in range(d):
        speed2 += segment[i, d + k] * segment[i, d + k]
        h = (h ^ bits[i, d + k]) * GOLDEN
        h ^= h >> 29
    state[i, TRAJECTORY_HASH] = (h ^ bits[i, 2 * d + START]) * GOLDEN
    log.fastest2[0] = max(log.fastest2[0], speed2)


@in_place
def note_move(i, log):
    """Row i has a new reference position."""
    if not log.is_moved[i]:
        log.is_moved[i] = True
        log.moved[log.moved_count[0]] = i
        log.moved_count[0] += 1


@in_place
def has_new_segment(d, rows, log, p):
    """Has the row at place p of the log got a new segment in the window, or only a new reference position?"""
    return log.saved_bits[p * record_width(d, spin_width(rows)) + hash_place(d)] != rows.state[log.changed[p], TRAJECTORY_HASH]
