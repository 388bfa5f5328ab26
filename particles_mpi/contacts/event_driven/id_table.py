"""The rows of this rank by the ids of their particles: a hash table whose size depends on the rows here, not on all ids.

Each id has a home place in the table, and stands there or in one of the following places (linear probing: D. Knuth, The Art of
Computer Programming 3, 6.4). At least half of the places are free, so that every search ends.
"""

import numpy as np

from particles_mpi.kernels.fingerprint import GOLDEN
from particles_mpi.kernels.jit import kernel, lean_inner
from particles_mpi.particles import Array

ID, ROW = range(2)  # columns of a table
FREE = -1  # in place of an id
NO_ROW = -1  # in place of a row: there is none with this id
SPREAD = -GOLDEN  # consecutive ids get places far apart


def table_of(ids: Array, rows: Array, room: int) -> Array:
    """A table (places, 2) with the ids (n,) and rows (n,), and room for `room` ids."""
    table = np.full((1 << max(2 * room - 1, 1).bit_length(), 2), FREE)
    put_all(table, ids, rows.astype(np.int64))
    return table


@lean_inner
def home(table, particle):
    """The place at which the search for an id begins."""
    return ((particle * np.int64(SPREAD)) >> 20) & (len(table) - 1)


@lean_inner
def row_of(table, particle):
    """The row of the particle with this id, NO_ROW if it is not here."""
    at = home(table, particle)
    while table[at, ID] != particle:
        if table[at, ID] == FREE:
            return np.int64(NO_ROW)
        at = (at + 1) & (len(table) - 1)
    return table[at, ROW]


@lean_inner
def put(table, particle, row):
    """Enter the row of an id that is not in the table."""
    at = home(table, particle)
    while table[at, ID] != FREE:
        at = (at + 1) & (len(table) - 1)
    table[at, ID], table[at, ROW] = particle, row


@lean_inner
def drop(table, particle):
    """Remove an id that is in the table; those behind it move up if they would no longer be found."""
    last = len(table) - 1
    hole = home(table, particle)
    while table[hole, ID] != particle:
        hole = (hole + 1) & last
    at = (hole + 1) & last
    while table[at, ID] != FREE:
        if (at - home(table, table[at, ID])) & last >= (at - hole) & last:
            table[hole, ID], table[hole, ROW] = table[at, ID], table[at, ROW]
            hole = at
        at = (at + 1) & last
    table[hole, ID] = FREE


@kernel
def put_all(table, ids, rows):
    """Enter many."""
    for p in range(len(ids)):
        put(table, ids[p], rows[p])


@kernel
def rows_of_ids(table, ids):
    """The rows (n,) of the ids (n,), NO_ROW where one is not here."""
    rows = np.empty(len(ids), np.int64)
    for p in range(len(ids)):
        rows[p] = row_of(table, ids[p])
    return rows
