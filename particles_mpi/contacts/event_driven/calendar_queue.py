"""The next event of every particle, in buckets of time: what happens first is found without comparing all of them.

A slot is (partner, stamp, next, before, bucket) of a row, and at its end, seen through `when`, the time. Rows of one bucket
are linked; the bucket of the present is searched for the first event under the total order: time, pair before wall, lower
id, higher id or wall. `state` holds the ids, in its column ID.
"""

from __future__ import annotations

import numpy as np

from particles_mpi.kernels.jit import lean_inner

PARTNER, STAMP, NEXT, BEFORE, BUCKET = 0, 1, 2, 3, 4
SLOT, WHEN = 8, 3  # int32 numbers a row: half a cache line; place of the time among its float64
ID = 0
NOTHING = -(2**30)  # no event before the end
LEAVING = NOTHING + 1  # it gets to its shell; walls are -1, -2, ...


@lean_inner
def put(slot, when, heads, per, clock, i, t, partner, stamp):
    """Row i, which has no event, gets one; never before the present bucket."""
    bucket = max(min(np.int64(max(t, 0.0) * per), len(heads) - 1), clock[0])
    after = heads[bucket]
    when[i, WHEN] = t
    slot[i, PARTNER], slot[i, STAMP] = partner, stamp
    slot[i, NEXT], slot[i, BEFORE], slot[i, BUCKET] = after, -1, bucket
    if after >= 0:
        slot[after, BEFORE] = i
    heads[bucket] = i


@lean_inner
def take(slot, heads, i):
    """Row i loses its event, if it has one."""
    if slot[i, PARTNER] == NOTHING:
        return
    after, before = slot[i, NEXT], slot[i, BEFORE]
    if before >= 0:
        slot[before, NEXT] = after
    else:
        heads[slot[i, BUCKET]] = after
    if after >= 0:
        slot[after, BEFORE] = before
    slot[i, PARTNER] = NOTHING


@lean_inner
def before_other(i, one, j, other, state):
    """Does the event of row i with `one` come before that of row j with `other` at the same time?"""
    if one < 0 or other < 0:
        if one >= 0 or other >= 0:
            return one >= 0
        return (state[i, ID], -one) < (state[j, ID], -other)
    a, b, c, d = state[i, ID], state[one, ID], state[j, ID], state[other, ID]
    return (min(a, b), max(a, b)) < (min(c, d), max(c, d))


@lean_inner
def first(slot, when, heads, clock, state):
    """The row with the first event of all, or -1. `clock` (1,) is the present bucket."""
    while clock[0] < len(heads):
        best = np.int64(heads[clock[0]])
        if best >= 0:
            i = np.int64(slot[best, NEXT])
            while i >= 0:
                if when[i, WHEN] < when[best, WHEN] or (
                    when[i, WHEN] == when[best, WHEN] and before_other(i, slot[i, PARTNER], best, slot[best, PARTNER], state)
                ):
                    best = i
                i = np.int64(slot[i, NEXT])
            return best
        clock[0] += 1
    return -1
