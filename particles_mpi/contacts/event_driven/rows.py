"""What a rank knows of particles during a drift: a row each, its own ones and ghosts, which are copies of other ranks' ones."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from particles_mpi.kernels.geometry import into_box
from particles_mpi.kernels.jit import inner, lean
from particles_mpi.kernels.markers import CROWD, NOBODY
from particles_mpi.particles import Array

START, RADIUS = 0, 1  # columns of `segment`, after 2 d
ID, LAST_PARTNER, EVENT_COUNT, RAPID_EVENTS, TRAJECTORY_HASH, OWNERSHIP, LAST_CONTACT, VIRIAL = range(8)  # columns of `state`
NOT_HERE, GHOST, OWN, SHARED = range(4)  # OWNERSHIP: a free row, another rank's particle, an own one, an own one others know
ZERO_TIME_EVENT = 2**32  # RAPID_EVENTS counts contacts in a row without time passing in units of this; below it, quick ones
SQUEEZED = 1000 * ZERO_TIME_EVENT  # from here on a particle is squeezed: it has no more contacts in this drift


class Rows(NamedTuple):
    """The rows as the kernels take them, some of them free.

    A particle's path in a drift is made of straight segments: x + v (t - START) from its last contact on. Its position is not
    brought to other times before the next contact, so that no look at it leaves a trace in the bits.

    `state` holds, of each row: the particle's ID; its LAST_PARTNER in this drift, an id, -1 - wall, or NOBODY; EVENT_COUNT, how
    often its path was changed: an event that was foreseen with another count is void; RAPID_EVENTS, its contacts in a row
    without time passing and its quick contacts (see ZERO_TIME_EVENT); TRAJECTORY_HASH, a hash of all its segments in this
    drift; OWNERSHIP; and, float64 in `reals`, the time of its LAST_CONTACT and the sum of its -r.dp, VIRIAL.
    """

    segment: Array  # (n, 2 d + 2): x (d), v (d), START, RADIUS
    segment_bits: Array  # the same memory as int64
    state: Array  # (n, 8) int64: one line of the cache
    reals: Array  # the same memory as float64
    acceleration: Array  # (n, d), or no row where it is the same for all
    drag: Array  # (n,), or no row where it is the same for all


@inner
def dimension(rows):
    """Of space, in kernels that are compiled for all dimensions at once."""
    return rows.segment.shape[1] // 2 - 1


@lean
def start_drift(axes, rows, x, v, radius, last_contact, virial, acceleration, own_rows):
    """Own rows on segments from (x, v) at time 0; particle p is row own_rows[p]. `virial`, `acceleration`: may have no row.

    Returns (moved, speed): did anyone change a position or radius since `end_drift`, and the largest speed, inf if
    anything is not finite.
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
        state[i, LAST_PARTNER], state[i, RAPID_EVENTS], state[i, TRAJECTORY_HASH] = NOBODY, 0, 0
        reals[i, LAST_CONTACT] = last_contact[p]
        reals[i, VIRIAL] = virial[p] if len(virial) else 0.0
        if len(acceleration) > 0:
            for k in range(d):
                rows.acceleration[i, k] = acceleration[p, k]
    return moved, sqrt(fastest)


@lean
def end_drift(axes, rows, h, reference, box):
    """All rows to time h, in a periodic box with their `reference` positions. Returns how many own ones were squeezed."""
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
def write_back(axes, rows, x, v, last_contact, virial, supported, crowded, own_rows):
    """Particle p as row own_rows[p] is; those with `crowded` quick contacts are marked CROWD in `supported` if that has rows."""
    rows = Rows(*rows)
    segment, state, reals = rows.segment, rows.state, rows.reals
    d = len(axes)
    for p in range(len(x)):
        i = own_rows[p]
        for k in range(d):
            x[p, k] = segment[i, k]
            v[p, k] = segment[i, d + k]
        last_contact[p] = reals[i, LAST_CONTACT]
        if len(virial):
            virial[p] = reals[i, VIRIAL]
        if len(supported) and state[i, RAPID_EVENTS] % ZERO_TIME_EVENT >= crowded:
            supported[p] = CROWD
