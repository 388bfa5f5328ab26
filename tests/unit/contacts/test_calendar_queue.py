"""The calendar queue gives events in the total order, and many at the same time do not make it search for each among all."""

import numpy as np
import pytest

from particles_mpi.contacts.event_driven import calendar_queue
from particles_mpi.contacts.event_driven.calendar_queue import (
    LIST_EXPIRY,
    NEXT,
    NO_EVENT,
    NODE,
    PARTNER,
    UNSORTED,
    Queue,
    cancel,
    earlier,
    push,
)
from particles_mpi.contacts.event_driven.rows import ID


def queue_of(times, partners, ids):
    n = len(times)
    node = np.zeros((n, NODE), np.int32)
    node[:, PARTNER] = NO_EVENT
    queue = Queue(node, node.view(np.float64), np.full(8, -1, np.int32), 8.0, np.zeros(2, np.int64))
    state = np.zeros((n, ID + 1), np.int64)
    state[:, ID] = ids
    for i in range(n):
        push(queue, state, i, times[i], partners[i], 0)
    return queue, state


def first_of(queue, state):
    """As in the event loop: empty buckets are passed over, and a full one is sorted."""
    while (i := calendar_queue.find_first(queue, state)) < 0:
        if i == UNSORTED:
            calendar_queue.sort_present(tuple(queue), state)
        elif not calendar_queue.advance(queue):
            break
    return i


def popped(queue, state, again=()):
    """Rows in the order in which they come; rows of `again` get one more event, at that time, when they first do."""
    rows, again = [], dict(again)
    while (i := first_of(queue, state)) >= 0:
        cancel(queue, i)
        rows.append(int(i))
        if i in again:
            push(queue, state, i, again.pop(i), LIST_EXPIRY, 0)
    return rows


@pytest.mark.parametrize("apart", [1.0, 0.0])
def test_events_come_in_the_order_of_time_and_then_of_ids(apart):
    random = np.random.default_rng(3)
    n = 700
    times = 0.5 + apart * np.round(0.4 * random.random(n), 2)  # in few buckets, and many of them at the same time
    ids = random.permutation(n)
    partners = np.where(random.random(n) < 0.5, LIST_EXPIRY, -1 - random.integers(0, 3, n))
    queue, state = queue_of(times, partners, ids)
    expected = sorted(range(n), key=lambda i: (times[i], ids[i], -partners[i]))
    assert popped(queue, state) == expected


def test_an_event_that_is_added_to_a_sorted_bucket_keeps_its_order():
    n = 200
    queue, state = queue_of(np.full(n, 0.30), [LIST_EXPIRY] * n, np.arange(n))
    again = {0: 0.31, 1: 0.30, 7: 0.9}
    assert popped(queue, state, again) == [0, 1, 1, *range(2, n), 0, 7]


def test_the_work_for_events_at_the_same_time_grows_as_n_log_n(monkeypatch):
    compared = 0

    def counting(*arguments):
        nonlocal compared
        compared += 1
        return earlier(*arguments)

    monkeypatch.setattr(calendar_queue, "earlier", counting)
    for name in ("find_first", "sort_present"):  # uncompiled, so that they call what stands in the module
        kernel = getattr(calendar_queue, name)
        monkeypatch.setattr(calendar_queue, name, getattr(kernel, "py_func", kernel))
    n = 2000
    queue, state = queue_of(np.full(n, 0.30), [LIST_EXPIRY] * n, np.random.default_rng(5).permutation(n))
    order = []
    while (i := first_of(queue, state)) >= 0:
        cancel(queue, i)
        order.append(int(state[i, ID]))
    assert order == list(range(n)) and (queue.node[:, NEXT] < n).all()
    assert compared < 2 * n * np.log2(n)
