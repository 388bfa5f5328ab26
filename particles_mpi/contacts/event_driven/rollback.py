"""The state of a row besides its leg, and the log of rows that something happened to, so that it can be undone or told.

A row of `state` (n, 8) int64, one line of the cache, is (id, met, turns, stuck, history, mine, last, virial), the last two
float64 and seen through `reals`: whom it met last, how often it was turned (which tells others that what they foresaw of it
is void), contacts in a row without time passing, a hash of all its legs in this drift, whether this rank answers for it,
when its last contact was, and the sum of its -r.dp.

A record of a row is (leg without R, met, stuck, history, last, virial), as float64 or, through `words`, int64.
"""

from __future__ import annotations

import numpy as np

from particles_mpi.kernels.jit import inner, lean_inner
from particles_mpi.particles import Array

ID, MET, TURNS, STUCK, HISTORY, MINE, LAST, VIRIAL = range(8)
NOT_HERE, GHOST, OWN, KNOWN = (
    0,
    1,
    2,
    3,
)  # values of MINE: a free row; another rank answers for it; this one does, and others know it
ODD = -7046029254386353131  # an odd number with many bits, to multiply with


@inner(inline="always")
def record_width(dimension):
    """Numbers in a record."""
    return 2 * dimension + 6


@inner(inline="always")
def history_place(dimension):
    """Where the history stands in a record."""
    return 2 * dimension + 3


class Log:
    """Rows in the order in which something first happened to them in the present window, and what they were before.

    `window` (1,) is the number of the window, 0 while nobody needs a log; `mark` (n, 2) the last one a row was noted in, and
    at which place.
    `fastest` (1,) is the largest square of a speed that a contact gave. `moved`: own rows that got new homes. `border`: places
    of the rows that more than one rank knows.
    """

    def __init__(self, rows: int, dimension: int):
        self.window, self.count, self.fastest = np.zeros(1, np.int64), np.zeros(1, np.int64), np.zeros(1)
        self.mark, self.rows = np.zeros((rows, 2), np.int64), np.empty(rows, np.int32)
        self.saved = np.empty((rows, record_width(dimension)))
        self.moved, self.movers, self.is_mover = np.zeros(1, np.int64), np.empty(rows, np.int32), np.zeros(rows, np.bool_)
        self.shared, self.border = np.zeros(1, np.int64), np.empty(rows, np.int32)

    def grow(self) -> None:
        """For twice as many rows."""
        for name in ("mark", "rows", "saved", "movers", "is_mover", "border"):
            old = getattr(self, name)
            setattr(self, name, np.concatenate((old, np.zeros_like(old))))

    def arrays(self) -> tuple[Array, ...]:
        """What the kernels take; records one after the other."""
        return (
            self.window, self.mark, self.rows, self.count, self.saved.ravel(), self.saved.ravel().view(np.int64),
            self.fastest, self.moved, self.movers, self.is_mover, self.shared, self.border,
        )  # fmt: skip


@lean_inner
def save_row(d, leg, state, i, out, words, at):
    """The record of row i, in d dimensions, to `out` from place `at` on; returns where it ends."""
    for k in range(2 * d + 1):
        out[at + k] = leg[i, k]
    at += 2 * d + 1
    words[at], words[at + 1], words[at + 2] = state[i, MET], state[i, STUCK], state[i, HISTORY]
    words[at + 3], words[at + 4] = state[i, LAST], state[i, VIRIAL]
    return at + 5


@lean_inner
def load_row(leg, state, i, out, words, at):
    """Row i as the record at place `at` of `out` says. What others foresaw of it is void."""
    last = leg.shape[1] - 1  # where the radius is
    for k in range(last):
        leg[i, k] = out[at + k]
    at += last
    state[i, MET], state[i, STUCK], state[i, HISTORY] = words[at], words[at + 1], words[at + 2]
    state[i, LAST], state[i, VIRIAL] = words[at + 3], words[at + 4]
    state[i, TURNS] += 1


@lean_inner
def remember(axes, leg, state, i, log):
    """Something is about to happen to row i."""
    window, mark, rows, count, saved, words, _, _, _, _, shared, border = log
    if mark[i, 0] != window[0]:
        mark[i, 0], mark[i, 1] = window[0], count[0]
        rows[count[0]] = i
        if state[i, MINE] != OWN:
            border[shared[0]] = count[0]
            shared[0] += 1
        save_row(np.int64(len(axes)), leg, state, i, saved, words, count[0] * record_width(len(axes)))
        count[0] += 1


@lean_inner
def note_leg(axes, leg, leg_words, state, i, log):
    """Row i has begun a new leg: into its history, and was it ever so fast?"""
    d = len(axes)
    fastest = log[6]
    speed = 0.0
    h = state[i, HISTORY] ^ state[i, MET]
    for k in range(d):
        speed += leg[i, d + k] * leg[i, d + k]
        h = (h ^ leg_words[i, d + k]) * ODD
        h ^= h >> 29
    state[i, HISTORY] = (h ^ leg_words[i, 2 * d]) * ODD
    fastest[0] = max(fastest[0], speed)


@lean_inner
def note_home(i, log):
    """Row i has a new home."""
    moved, movers, is_mover = log[7], log[8], log[9]
    if not is_mover[i]:
        is_mover[i] = True
        movers[moved[0]] = i
        moved[0] += 1
