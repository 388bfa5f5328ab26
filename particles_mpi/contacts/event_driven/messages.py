"""What ranks send one another after a window of time: compiled parts of `windows`. `arrivals` is what they do with it.

A message is a series of float64, or of int64 in their place, each part beginning with its kind and a particle's id:

- UPDATE: the record (see `rows`) of a row that was changed, to all ranks that hold it as a ghost.
- ADD_GHOST: the record, R, 1/m, reference position, the acceleration where it differs from row to row, the drag if there is
  any, and 1/I where spheres are rough, of a row that comes near the receiver's region.
- TRANSFER: rank and place of the particle's fields, the rank that had it, and the reference position, of a row that the receiver
  owns from now on. Who holds it the receiver finds as the sender did.
- DROP_GHOST: a row that has gone away from the receiver's region.
"""

from typing import NamedTuple

import numpy as np

from particles_mpi.contacts.event_driven.regions import Moves, Regions
from particles_mpi.contacts.event_driven.rows import (
    ID,
    OWNERSHIP,
    SHARED,
    Log,
    Rows,
    dimension,
    has_new_segment,
    record_width,
    save_row,
)
from particles_mpi.kernels.jit import inner, lean, lean_inner, prefetch
from particles_mpi.kernels.markers import RADIUS
from particles_mpi.neighbours.verlet_kernels import INVERSE_MASS
from particles_mpi.particles import Array, spin_components

UPDATE, ADD_GHOST, TRANSFER, DROP_GHOST = range(4)
HEAD = 2  # numbers at the beginning of a part: its kind, the id
HOLDER, PLACE = range(2)  # columns of `fields_at`


class Directory(NamedTuple):
    """Which ranks hold a particle, and where it is here."""

    table: Array  # (places, 2) the rows by id, see `id_table`
    holders: Array  # (n, k) bool, of an own row: which of the known ranks hold it, this one too
    fields_at: Array  # (n, 2) of an own row: HOLDER, the rank that holds the fields of the particle until the end of the drift
    updated: Array  # (n,) the last window in which an owner sent an UPDATE of this row
    free: Array  # (n,) int32, rows that are not in use
    free_count: Array  # (1,) how many these are


@inner
def part_width(kind, d, record, extra):
    """Numbers in a part of a message, records having so many; `extra`: see `extra_width`."""
    if kind == UPDATE:
        return HEAD + record
    if kind == ADD_GHOST:
        return HEAD + record + 2 + d + extra
    if kind == TRANSFER:
        return HEAD + 3 + d
    return HEAD


def widest_part(dimension: int) -> int:
    """Numbers in the longest part of a message, of rough spheres that velocity flows act on."""
    record = record_width(dimension, spin_components(dimension))
    return max(part_width(kind, dimension, record, dimension + 2) for kind in (UPDATE, ADD_GHOST, TRANSFER, DROP_GHOST))


@inner
def extra_width(rows):
    """Numbers a row of what changes velocities and differs from row to row."""
    return rows.acceleration.shape[1] + (len(rows.drag) > 0) + (len(rows.inverse_inertia) > 0)


@lean_inner
def save_extra(rows, i, out, at):
    """Write what changes the velocity of row i, and its 1/I, to `out` from place `at` on; returns where it ends."""
    for k in range(rows.acceleration.shape[1]):
        out[at] = rows.acceleration[i, k]
        at += 1
    if len(rows.drag) > 0:
        out[at] = rows.drag[i]
        at += 1
    if len(rows.inverse_inertia) > 0:
        out[at] = rows.inverse_inertia[i]
        at += 1
    return at


@lean_inner
def load_extra(rows, i, numbers, at):
    """What `save_extra` wrote."""
    for k in range(rows.acceleration.shape[1]):
        rows.acceleration[i, k] = numbers[at]
        at += 1
    if len(rows.drag) > 0:
        rows.drag[i] = numbers[at]
        at += 1
    if len(rows.inverse_inertia) > 0:
        rows.inverse_inertia[i] = numbers[at]


@lean
def pack_changes(rows, reference, directory, log, moves, regions, number, message):
    """What the known rank of that number must know of the window of own rows; returns the length. `message` has room for it."""
    rows, directory, log, moves = Rows(*rows), Directory(*directory), Log(*log), Moves(*moves)
    rank, me = Regions(*regions).known[number], Regions(*regions).rank
    bits = message.view(np.int64)
    segment, state, holders = rows.segment, rows.state, directory.holders
    d = dimension(rows)
    size = 0
    for p in log.border[: log.border_count[0]]:
        prefetch(state, log.changed[p])
        prefetch(holders, log.changed[p])
        prefetch(segment, log.changed[p])
    for p in log.border[: log.border_count[0]]:
        i = np.int64(log.changed[p])
        if state[i, OWNERSHIP] == SHARED and holders[i, number] and has_new_segment(d, rows, log, p):
            bits[size], bits[size + 1] = UPDATE, state[i, ID]
            size = save_row(d, rows, i, message, size + HEAD)
    for m in range(log.moved_count[0]):
        i = np.int64(log.moved[m])
        if moves.holders[m, number] and not holders[i, number]:
            bits[size], bits[size + 1] = ADD_GHOST, state[i, ID]
            size = save_row(d, rows, i, message, size + HEAD)
            message[size], message[size + 1] = segment[i, 2 * d + RADIUS], reference[i, d + INVERSE_MASS]
            for k in range(d):
                message[size + 2 + k] = reference[i, k]
            size = save_extra(rows, i, message, size + 2 + d)
        if moves.owner[m] == rank:
            bits[size], bits[size + 1] = TRANSFER, state[i, ID]
            size += HEAD
            bits[size], bits[size + 1], bits[size + 2] = directory.fields_at[i, HOLDER], directory.fields_at[i, PLACE], me
            for k in range(d):
                message[size + 3 + k] = reference[i, k]
            size += 3 + d
    for m in range(log.moved_count[0]):
        i = np.int64(log.moved[m])
        if holders[i, number] and not moves.holders[m, number]:
            bits[size], bits[size + 1] = DROP_GHOST, state[i, ID]
            size += HEAD
    return size
