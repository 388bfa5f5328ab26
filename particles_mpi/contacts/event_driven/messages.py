"""Compiled parts of `windows`: the messages that ranks send one another after a window of time. `arrivals` handles them.

A message is a series of numbers, in parts that begin with their kind and a particle's id:

- UPDATE: the record (see `rows`) of a row that was changed, for all ranks that hold it as a ghost.
- ADD_GHOST: the record, R, 1/m, reference position, the acceleration where it differs from row to row, the drag if there is any,
  and 1/I where spheres are rough, of a row that comes near the receiver's region.
- TRANSFER: rank and place of the particle's fields, the rank that had it, and the reference position, of a row that the receiver
  owns from now on. The receiver finds out which ranks hold it, by the sender's rule.
- DROP_GHOST: a row that has left the neighbourhood of the receiver's region.
"""

from typing import NamedTuple

import numpy as np

from particles_mpi.contacts.event_driven.regions import Moves, Regions
from particles_mpi.contacts.event_driven.rows import (
    ID,
    OWN,
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
    """Which ranks hold a particle, and where it is here. A set of ranks is a bit mask, of one int64 for 64 known ranks."""

    table: Array  # (places, 2) the rows by id, see `id_table`
    holders: Array  # (n, masks) of an own row: the known ranks that hold it, this one too
    fields_at: Array  # (n, 2) of an own row: HOLDER, the rank that holds the fields of the particle until the end of the drift
    updated: Array  # (n,) the last window in which an owner sent an UPDATE of this row
    free: Array  # (n,) int32, rows that are not in use
    free_count: Array  # (1,) how many these are


def message_of(numbers: Array) -> tuple[Array, Array]:
    """A message as kernels take it: the numbers, and the same memory as int64."""
    return numbers, numbers.view(np.int64)


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
    return (
        (rows.acceleration.shape[1] if len(rows.acceleration) > 0 else 0)
        + (1 if len(rows.drag) > 0 else 0)
        + (1 if len(rows.inverse_inertia) > 0 else 0)
    )


@lean_inner
def save_extra(d, rows, i, out, at):
    """Write what changes the velocity of row i, and its 1/I, to `out` from place `at` on; returns where it ends."""
    if len(rows.acceleration) > 0:
        for k in range(d):
            out[at + k] = rows.acceleration[i, k]
        at += d
    if len(rows.drag) > 0:
        out[at] = rows.drag[i]
        at += 1
    if len(rows.inverse_inertia) > 0:
        out[at] = rows.inverse_inertia[i]
        at += 1
    return at


@lean_inner
def load_extra(d, rows, i, numbers, at):
    """What `save_extra` wrote."""
    if len(rows.acceleration) > 0:
        for k in range(d):
            rows.acceleration[i, k] = numbers[at + k]
        at += d
    if len(rows.drag) > 0:
        rows.drag[i] = numbers[at]
        at += 1
    if len(rows.inverse_inertia) > 0:
        rows.inverse_inertia[i] = numbers[at]


@lean_inner
def holds(masks, i, bit):
    """Is this bit set in row i?"""
    return (masks[i, bit >> 6] >> (bit & 63)) & 1 == 1


@lean_inner
def add_holder(masks, i, bit):
    """Set this bit in row i."""
    masks[i, bit >> 6] |= np.int64(1) << (bit & 63)


@lean_inner
def ownership(holders, i, here):
    """Of own row i: SHARED if another rank than that of bit `here` holds it, else OWN."""
    others = holders[i, here >> 6] & ~(np.int64(1) << (here & 63))
    for b in range(holders.shape[1]):
        if b != here >> 6:
            others |= holders[i, b]
    return SHARED if others != 0 else OWN


@lean
def pack_changes(rows, reference, directory, log, moves, regions, bit, message):
    """Write to `message`, which has room, the changes of own rows that the known rank of a bit must know; returns the length."""
    rows, directory, log, moves = Rows(*rows), Directory(*directory), Log(*log), Moves(*moves)
    rank, me = Regions(*regions).known[bit], Regions(*regions).rank
    out, bits = message
    segment, state, holders = rows.segment, rows.state, directory.holders
    d = dimension(rows)
    size = 0
    for p in log.border[: log.border_count[0]]:
        prefetch(state, log.changed[p])
        prefetch(holders, log.changed[p])
        prefetch(segment, log.changed[p])
    for p in log.border[: log.border_count[0]]:
        i = np.int64(log.changed[p])
        if state[i, OWNERSHIP] == SHARED and holds(holders, i, bit) and has_new_segment(d, rows, log, p):
            bits[size], bits[size + 1] = UPDATE, state[i, ID]
            size = save_row(d, rows, i, out, bits, size + HEAD)
    for m in range(log.moved_count[0]):
        i = np.int64(log.moved[m])
        if holds(moves.holders, m, bit) and not holds(holders, i, bit):
            bits[size], bits[size + 1] = ADD_GHOST, state[i, ID]
            size = save_row(d, rows, i, out, bits, size + HEAD)
            out[size], out[size + 1] = segment[i, 2 * d + RADIUS], reference[i, d + INVERSE_MASS]
            for k in range(d):
                out[size + 2 + k] = reference[i, k]
            size = save_extra(d, rows, i, out, size + 2 + d)
        if moves.owner[m] == rank:
            bits[size], bits[size + 1] = TRANSFER, state[i, ID]
            size += HEAD
            bits[size], bits[size + 1], bits[size + 2] = directory.fields_at[i, HOLDER], directory.fields_at[i, PLACE], me
            for k in range(d):
                out[size + 3 + k] = reference[i, k]
            size += 3 + d
    for m in range(log.moved_count[0]):
        i = np.int64(log.moved[m])
        if holds(holders, i, bit) and not holds(moves.holders, m, bit):
            bits[size], bits[size + 1] = DROP_GHOST, state[i, ID]
            size += HEAD
    return size
