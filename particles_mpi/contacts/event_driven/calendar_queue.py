"""The next event of every row, in buckets of time: a calendar queue, which finds the first event without comparing all of them.

Rows whose events are in the same bucket are linked. The present bucket is searched for the first event under the total order:
time, pair before wall, fewest repetitions, lower id, higher id or wall. If it has many events (spheres that fall side by side
reach their skins at the same time) it is sorted first, and stays sorted.

*Repetitions* are the contacts in which a partner has got nowhere so far, beyond ORDERED of them. In the order of ids alone, the
first three of a row of spheres that touch, with e = 0, would meet one another without end, and the blow would never reach the
others. With this order it passes through all spheres again and again, until they have one velocity.
"""

from typing import NamedTuple

import numpy as np

from particles_mpi.contacts.event_driven.rows import ID, RAPID_EVENTS, ZERO_TIME_EVENT
from particles_mpi.kernels.jit import in_place, lean, lean_inner
from particles_mpi.particles import Array

PARTNER, PARTNER_COUNT, NEXT, PREVIOUS, BUCKET, REPETITIONS = range(6)  # columns of `node`
NODE = 8  # width of a node, half a line of the cache
TIME = 3  # column of `times`
# Values of PARTNER: a row, which is >= 0; -1 - w for wall w; or
NO_EVENT = -(2**30)  # nothing happens before the end of the drift
LIST_EXPIRY = NO_EVENT + 1  # it gets to its skin, where its neighbour list expires
CROWDED_BUCKET = 64  # events in a bucket: to search it for each of them would take longer than to sort it
ORDERED = 32  # contacts at one place and time that are in the order of ids: with e >= 0.5 eight spheres in a row have up to 24
EMPTY, UNSORTED = -1, -2  # what `find_first` returns for a bucket without events, and for one with CROWDED_BUCKET


class Queue(NamedTuple):
    """The queue as the kernels take it."""

    node: Array  # (n, NODE) int32: PARTNER, its EVENT_COUNT then, NEXT and PREVIOUS row of the BUCKET or -1, REPETITIONS
    times: Array  # the same memory as float64: TIME of the event
    first: Array  # (buckets,) int32: a row of each bucket, or -1
    per_time: float  # buckets in a unit of time
    present: Array  # (2,) the present bucket; is it sorted?


@lean_inner
def repetitions(i, partner, state):
    """Return how many contacts beyond ORDERED got nowhere, for that of row i and its partner which had more of them."""
    most = state[i, RAPID_EVENTS]
    if partner >= 0:
        most = max(most, state[partner, RAPID_EVENTS])
    return most // ZERO_TIME_EVENT - ORDERED if most >= ORDERED * ZERO_TIME_EVENT else 0


@lean_inner
def comes_before(i, partner_i, repeated_i, j, partner_j, repeated_j, state):
    """Does the event of row i with its partner come before that of row j with its own at the same time?"""
    if partner_i < 0 or partner_j < 0:
        if partner_i >= 0 or partner_j >= 0:
            return partner_i >= 0
        return (repeated_i, state[i, ID], -partner_i) < (repeated_j, state[j, ID], -partner_j)
    a, b, c, d = state[i, ID], state[partner_i, ID], state[j, ID], state[partner_j, ID]
    return (repeated_i, min(a, b), max(a, b)) < (repeated_j, min(c, d), max(c, d))


@lean_inner
def earlier(queue, i, j, state):
    """Is the event of row i before that of row j?"""
    one, other, node = queue.times[i, TIME], queue.times[j, TIME], queue.node
    if one != other:
        return one < other
    return comes_before(i, node[i, PARTNER], node[i, REPETITIONS], j, node[j, PARTNER], node[j, REPETITIONS], state)


@in_place
def push(queue, state, i, t, partner, count):
    """Queue an event at time t of row i, which has none, with this partner and event count; not before the present bucket."""
    node, first, present = queue.node, queue.first, queue.present
    bucket = max(min(np.int64(max(t, 0.0) * queue.per_time), len(first) - 1), present[0])
    queue.times[i, TIME] = t
    node[i, PARTNER], node[i, PARTNER_COUNT], node[i, REPETITIONS] = partner, count, repetitions(i, partner, state)
    before, after = np.int64(-1), np.int64(first[bucket])
    if present[1] and bucket == present[0]:
        while after >= 0 and earlier(queue, after, i, state):
            before, after = after, np.int64(node[after, NEXT])
    node[i, NEXT], node[i, PREVIOUS], node[i, BUCKET] = after, before, bucket
    if after >= 0:
        node[after, PREVIOUS] = i
    if before >= 0:
        node[before, NEXT] = i
    else:
        first[bucket] = i


@in_place
def cancel(queue, i):
    """Remove the event of row i from the queue, if it has one."""
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


@lean
def sort_present(queue, state):
    """Sort the present bucket: runs of 1, 2, 4 ... linked rows are merged, two at a time. `queue` as a plain tuple."""
    queue = Queue(*queue)
    node, bucket = queue.node, queue.present[0]
    length, merges = 1, 2
    while merges > 1:
        rest, end, merges = np.int64(queue.first[bucket]), np.int64(-1), 0
        while rest >= 0:
            merges += 1
            one, other, ones, others = rest, rest, 0, length
            while ones < length and other >= 0:
                ones, other = ones + 1, np.int64(node[other, NEXT])
            while ones > 0 or (others > 0 and other >= 0):
                if ones > 0 and (others == 0 or other < 0 or earlier(queue, one, other, state)):
                    i, one, ones = one, np.int64(node[one, NEXT]), ones - 1
                else:
                    i, other, others = other, np.int64(node[other, NEXT]), others - 1
                node[i, PREVIOUS] = end
                if end >= 0:
                    node[end, NEXT] = i
                else:
                    queue.first[bucket] = i
                end = i
            rest = other
        node[end, NEXT] = -1
        length *= 2
    queue.present[1] = 1


@in_place
def find_first(queue, state):
    """Return the row with the first event in the present bucket; EMPTY: call `advance`; UNSORTED: call `sort_present`."""
    node, present = queue.node, queue.present
    best = np.int64(queue.first[present[0]])
    if best < 0 or present[1]:
        return best
    i, count = np.int64(node[best, NEXT]), 1
    while i >= 0 and count < CROWDED_BUCKET:
        if earlier(queue, i, best, state):
            best = i
        i, count = np.int64(node[i, NEXT]), count + 1
    return best if i < 0 else np.int64(UNSORTED)


@lean_inner
def advance(queue):
    """Make the next bucket the present one. Returns False if there is none."""
    present = queue.present
    if present[0] + 1 == len(queue.first):
        return False
    present[0] += 1
    present[1] = 0
    return True
