"""The log of a window of time: which rows were changed, and what they were before, so that changes can be sent or undone.

A record of a row is a series of numbers: its segment without the radius and, of its state, LAST_PARTNER, RAPID_EVENTS,
TRAJECTORY_HASH, LAST_CONTACT and VIRIAL. The segment is float64, the state int64 in the same memory.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from particles_mpi.contacts.event_driven.rows import (
    EVENT_COUNT,
    LAST_CONTACT,
    LAST_PARTNER,
    OWN,
    OWNERSHIP,
    RAPID_EVENTS,
    START,
    TRAJECTORY_HASH,
    VIRIAL,
)
from particles_mpi.kernels.jit import inner, lean_inner
from particles_mpi.particles import Array

WINDOW, PLACE = 0, 1  # columns of `mark`
ODD = -7046029254386353131  # an odd number with many bits, to multiply with


@inner(inline="always")
def record_width(d):
    """Numbers in a record, in d dimensions."""
    return 2 * d + 6


@inner(inline="always")
def hash_place(d):
    """Where TRAJECTORY_HASH stands in a record."""
    return 2 * d + 3


class Log(NamedTuple):
    """Changes of n rows in the present window of time."""

    window: Array  # (1,) number of the window, 0 while no log is needed
    changed_count: Array  # (1,) rows that were changed in the window
    changed: Array  # (n,) int32, these, in the order of their first changes
    mark: Array  # (n, 2): the last WINDOW in which a row was changed, and its PLACE in `changed`
    saved: Array  # (n * record_width,) records of these rows, as they were before
    saved_bits: Array  # the same memory as int64
    fastest2: Array  # (1,) the largest square of a speed that a contact gave
    moved_count: Array  # (1,) own rows that got new reference positions, since `reconcile` last dealt with them
    moved: Array  # (n,) int32, these
    is_moved: Array  # (n,) bool
    border_count: Array  # (1,) changed rows that more than one rank knows
    border: Array  # (n,) int32, places of these in `changed`


def new_log(n: int, d: int) -> Log:
    """For n rows in d dimensions."""
    saved = np.empty(n * record_width(d))
    one = np.zeros((4, 1), np.int64)
    return Log(
        one[0], one[1], np.empty(n, np.int32), np.zeros((n, 2), np.int64), saved, saved.view(np.int64), np.zeros(1),
        one[2], np.empty(n, np.int32), np.zeros(n, np.bool_), one[3], np.empty(n, np.int32),
    )  # fmt: skip


def enlarged_log(log: Log) -> Log:
    """For twice as many rows."""
    per_row = {name: getattr(log, name) for name in ("changed", "mark", "saved", "moved", "is_moved", "border")}
    doubled = {name: np.concatenate((old, np.zeros_like(old))) for name, old in per_row.items()}
    return log._replace(**doubled, saved_bits=doubled["saved"].view(np.int64))


@lean_inner
def save_row(d, rows, i, out, out_bits, at):
    """Write the record of row i, in d dimensions, to `out` from place `at` on; returns where it ends."""
    segment, state = rows.segment, rows.state
    for k in range(2 * d + START + 1):
        out[at + k] = segment[i, k]
    at += 2 * d + START + 1
    out_bits[at], out_bits[at + 1], out_bits[at + 2] = state[i, LAST_PARTNER], state[i, RAPID_EVENTS], state[i, TRAJECTORY_HASH]
    out_bits[at + 3], out_bits[at + 4] = state[i, LAST_CONTACT], state[i, VIRIAL]
    return at + 5


@lean_inner
def load_row(d, rows, i, record, bits, at):
    """Restore row i from the record at place `at`; raise its event count, so that queued events with it are void."""
    segment, state = rows.segment, rows.state
    for k in range(2 * d + START + 1):
        segment[i, k] = record[at + k]
    at += 2 * d + START + 1
    state[i, LAST_PARTNER], state[i, RAPID_EVENTS], state[i, TRAJECTORY_HASH] = (
        bits[at],
        bits[at + 1],
        bits[at + 2],
    )
    state[i, LAST_CONTACT], state[i, VIRIAL] = bits[at + 3], bits[at + 4]
    state[i, EVENT_COUNT] += 1


@lean_inner
def save_once(axes, rows, i, log):
    """Row i is about to change: save it, once in a window."""
    mark, count = log.mark, log.changed_count
    if mark[i, WINDOW] != log.window[0]:
        mark[i, WINDOW], mark[i, PLACE] = log.window[0], count[0]
        log.changed[count[0]] = i
        if rows.state[i, OWNERSHIP] != OWN:
            log.border[log.border_count[0]] = count[0]
            log.border_count[0] += 1
        save_row(np.int64(len(axes)), rows, i, log.saved, log.saved_bits, count[0] * record_width(len(axes)))
        count[0] += 1


@lean_inner
def note_segment(axes, rows, i, log):
    """Row i has begun a new segment: add it to the row's hash, and its speed to the log."""
    segment, bits, state = rows.segment, rows.segment_bits, rows.state
    d = len(axes)
    speed2 = 0.0
    h = state[i, TRAJECTORY_HASH] ^ state[i, LAST_PARTNER]
    for k in range(d):
        speed2 += segment[i, d + k] * segment[i, d + k]
        h = (h ^ bits[i, d + k]) * ODD
        h ^= h >> 29
    state[i, TRAJECTORY_HASH] = (h ^ bits[i, 2 * d + START]) * ODD
    log.fastest2[0] = max(log.fastest2[0], speed2)


@lean_inner
def note_move(i, log):
    """Row i has a new reference position."""
    if not log.is_moved[i]:
        log.is_moved[i] = True
        log.moved[log.moved_count[0]] = i
        log.moved_count[0] += 1


@lean_inner
def has_new_segment(d, rows, log, p):
    """Has the row at place p of the log got a new segment in the window, or only a new reference position?"""
    return log.saved_bits[p * record_width(d) + hash_place(d)] != rows.state[log.changed[p], TRAJECTORY_HASH]
