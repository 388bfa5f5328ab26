"""The next event of every row, in buckets of time: a calendar queue, which finds the first of all without comparing them all.

Rows whose events are in the same bucket are linked; the present bucket is searched for the first event under the total order:
time, pair before wall, lower id, higher id or wall.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from particles_mpi.contacts.event_driven.rows import ID
from particles_mpi.kernels.jit import lean_inner
from particles_mpi.particles import Array

PARTNER, PARTNER_COUNT, NEXT, PREVIOUS, BUCKET = range(5)  # columns of `node`
NODE, TIME = 8, 3  # width of a node, half a line of the cache; column of `times`
NO_EVENT = -(2**30)  # values of PARTNER: nothing happens before the end of the drift
LIST_EXPIRY = NO_EVENT + 1  # it gets to its skin, where its neighbour list expires; -1 - w is wall w, and rows are >= 0


class Queue(NamedTuple):
    """The queue as the kernels take it."""

    node: Array  # (n, NODE) int32: PARTNER, his EVENT_COUNT when that was foreseen, NEXT and PREVIOUS row of the BUCKET or -1
    times: Array  # the same memory as float64: TIME of the event
    first: Array  # (buckets,) int32: a row of each bucket, or -1
    per_time: float  # buckets in a unit of time
    present: Array  # (1,) the present bucket


@lean_inner
def push(queue, i, t, partner, count):
    """Give row i, which has no event, one at time t with the partner of this event count; never before the present bucket."""
    node, first = queue.node, queue.first
    bucket = max(min(np.int64(max(t, 0.0) * queue.per_time), len(first) - 1), queue.present[0])
    after = first[bucket]
    queue.times[i, TIME] = t
    node[i, PARTNER], node[i, PARTNER_COUNT] = partner, count
    node[i, NEXT], node[i, PREVIOUS], node[i, BUCKET] = after, -1, bucket
    if after >= 0:
        node[after, PREVIOUS] = i
    first[bucket] = i


@lean_inner
def cancel(queue, i):
    """Row i loses its event, if it has one."""
    node = queue.node
    if node[i, PARTNER] == NO_EVENT:
        return
    after, before = node[i, NEXT], node[i, PREVIOUS]
    if before >= 0:
        node[before, NEXT] = after
    else:
        queue.first[node[i, BUCKET]] = after
    if after >= 0:
        node[after, PREVIOUS] = before
    node[i, PARTNER] = NO_EVENT


@lean_inner
def comes_before(i, partner_i, j, partner_j, state):
    """Does the event of row i with its partner come before that of row j with its own at the same time?"""
    if partner_i < 0 or partner_j < 0:
        if partner_i >= 0 or partner_j >= 0:
            return partner_i >= 0
        return (state[i, ID], -partner_i) < (state[j, ID], -partner_j)
    a, b, c, d = state[i, ID], state[partner_i, ID], state[j, ID], state[partner_j, ID]
    return (min(a, b), max(a, b)) < (min(c, d), max(c, d))


@lean_inner
def find_first(queue, state):
    """The row with the first event of all, or -1. Moves the present on to its bucket."""
    node, times, first, present = queue.node, queue.times, queue.first, queue.present
    while present[0] < len(first):
        best = np.int64(first[present[0]])
        if best >= 0:
            i = np.int64(node[best, NEXT])
            while i >= 0:
                if times[i, TIME] < times[best, TIME] or (
                    times[i, TIME] == times[best, TIME] and comes_before(i, node[i, PARTNER], best, node[best, PARTNER], state)
                ):
                    best = i
                i = np.int64(node[i, NEXT])
            return best
        present[0] += 1
    return -1
