"""The order in which contacts stand in their equations: those of neighbours next to one another."""

import numpy as np

from particles_mpi.kernels.jit import inner


@inner
def contacts_by_row(rows, size):
    """(start (size + 1,), of_row (2 m,)): the contacts of row i, among rows (m, 2), are of_row[start[i]:start[i + 1]]."""
    start, of_row = np.zeros(size + 1, np.int64), np.empty(rows.size, np.int64)
    for i in rows.flat:
        start[i + 1] += 1
    for i in range(size):
        start[i + 1] += start[i]
    end = start[:size].copy()
    for c in range(len(rows)):
        for i in rows[c]:
            of_row[end[i]] = c
            end[i] += 1
    return start, of_row


@inner
def visit_from(first, done, start, of_row, rows, w, place, queue):
    """Rows that contacts lead to from row `first`, the nearest ones first: to queue[done:], and their places there to `place`.

    start (len(w) + 1,), of_row: see `contacts_by_row`. Returns how far the queue reaches.
    """
    queue[done], place[first], end = first, done, done + 1
    while done < end:
        i = queue[done]
        done += 1
        for n in range(start[i], start[i + 1]):
            c = of_row[n]
            j = rows[c, 1] if rows[c, 0] == i else rows[c, 0]
            if w[j] > 0.0 and place[j] < 0:
                queue[end], place[j] = j, end
                end += 1
    return end


@inner
def order_of_contacts(rows, w):
    """The contacts (m,) in an order in which those of neighbours are near one another: from one end of a pile to the other.

    Then all elements of their matrix, and of its factor, are near the diagonal (E. Cuthill and J. McKee, Proc. 24th Nat. Conf.
    ACM, 157, 1969).
    """
    start, of_row = contacts_by_row(rows, len(w))
    place, queue, done = np.full(len(w), -1, np.int64), np.empty(len(w), np.int64), 0
    for first in range(len(w)):
        if place[first] < 0 and w[first] > 0.0:
            last = visit_from(first, done, start, of_row, rows, w, place, queue)
            for i in queue[done:last]:
                place[i] = -1
            done = visit_from(queue[last - 1], done, start, of_row, rows, w, place, queue)
    keys = np.empty(len(rows), np.int64)
    for c in range(len(rows)):
        keys[c] = max(place[rows[c, 0]], place[rows[c, 1]])
    return np.argsort(keys, kind="mergesort")
