"""The next event of every particle, in buckets of time: what happens first is found without comparing all of them.

A slot is (partner, stamp, next, before, bucket) of a row, `when` its time. Rows of one bucket are linked; the bucket of the
present is searched for the first event under the total order: time, pair before wall, lower id, higher id or wall.
"""

from __future__ import annotations

import numpy as np

from particles_mpi.lean import lean

PARTNER, STAMP, NEXT, BEFORE, BUCKET = 0, 1, 2, 3, 4
SLOT = 8  # int32 numbers a row: half a cache line
NOTHING = -(2**30)  # no event before the end
LEAVING = NOTHING + 1  # it gets to its shell; walls are -1, -2, ...


@lean
def put(slot, when, heads, per, clock, i, t, partner, stamp):
    """Row i, which has no event, gets one; never before the present bucket."""
    bucket = max(min(np.int64(max(t, 0.0) * per), len(heads) - 1), clock[0])
    after = heads[bucket]
    when[i] = t
    slot[i, PARTNER], slot[i, STAMP] = partner, stamp
    slot[i, NEXT], slot[i, BEFORE], slot[i, BUCKET] = after, -1, bucket
    if after >= 0:
        slot[after, BEFORE] = i
    heads[bucket] = i


@lean
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


@lean
def before_other(i, one, j, other, ids):
    """Does the event of row i with `one` come before that of row j with `other` at the same time?"""
    if one < 0 or other < 0:
        if one >= 0 or other >= 0:
            return one >= 0
        return (ids[i], -one) < (ids[j], -other)
    return (min(ids[i], ids[one]), max(ids[i], ids[one])) < (min(ids[j], ids[other]), max(ids[j], ids[other]))


@lean
def first(slot, when, heads, clock, ids):
    """The row with the first event of all, or -1. `clock` (1,) is the present bucket."""
    while clock[0] < len(heads):
        best = np.int64(heads[clock[0]])
        if best >= 0:
            i = np.int64(slot[best, NEXT])
            while i >= 0:
                if when[i] < when[best] or (
                    when[i] == when[best] and before_other(i, slot[i, PARTNER], best, slot[best, PARTNER], ids)
                ):
                    best = i
                i = np.int64(slot[i, NEXT])
            return best
        clock[0] += 1
    return -1
