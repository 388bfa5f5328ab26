"""Rows are found by id in tables whose size depends on the rows here, and ranks that hold a row by bits of the known ones."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numba import njit

from particles_mpi.contacts.event_driven.id_table import NO_ROW, drop, put, row_of, rows_of_ids, table_of
from particles_mpi.contacts.event_driven.messages import add_holder, holds, ownership
from particles_mpi.contacts.event_driven.regions import Regions, mark_holders
from particles_mpi.contacts.event_driven.rows import OWN, SHARED
from particles_mpi.kernels.geometry import Box
from particles_mpi.neighbours.verlet_kernels import SIZE

IDS = st.integers(0, 30) | st.integers(2**62, 2**62 + 10)


@njit
def take_turns(table, names, row):
    """Every id that is there leaves, every one that is not enters, with the next row."""
    for name in names:
        if row_of(table, name) == NO_ROW:
            put(table, name, row)
        else:
            drop(table, name)
        row += 1


@given(st.lists(IDS, max_size=20, unique=True), st.lists(IDS, max_size=60))
def test_a_table_finds_what_is_in_it(first, then):
    """As a dictionary, whatever comes and goes: an id that is there leaves, another one enters."""
    expected = {name: row for row, name in enumerate(first)}
    table = table_of(np.array(first, np.int64), np.arange(len(first)), 50)
    assert len(table) <= 4 * 50
    take_turns(table, np.array(then, np.int64), 100)
    for row, name in enumerate(then, 100):
        if expected.pop(name, None) is None:
            expected[name] = row
    names = np.array([*first, *then], np.int64)
    assert rows_of_ids(table, names).tolist() == [expected.get(name, NO_ROW) for name in names.tolist()]


def test_more_known_ranks_than_bits_in_a_word():
    """100 regions of width 1 in a row: a particle is known to those within reach, on either side of the 64th."""
    ranks, d, depth = 100, 1, 2.0
    low = np.arange(ranks, dtype=float)[:, None]
    me = 40
    known = np.array([*(rank for rank in range(ranks) if rank != me), me])
    box = tuple(Box(np.array([0.0]), np.array([100.0]), np.array([0.0])))
    regions = tuple(Regions(low, low + 1.0, box, me, known, 1.0, 0.1, depth))
    reference = np.zeros((3, d + SIZE + 1))
    reference[:, 0] = [10.5, 64.5, 99.5]
    holders = np.zeros((3, ranks // 64 + 1), np.int64)
    mark_holders(reference, np.arange(3, dtype=np.int32), regions, holders)
    found = [{int(known[bit]) for bit in range(ranks) if holds(holders, row, bit)} for row in range(3)]
    assert found == [{8, 9, 10, 11, 12}, {62, 63, 64, 65, 66}, {97, 98, 99}]
    alone = np.zeros((1, 2), np.int64)
    here = len(known) - 1
    add_holder(alone, 0, here)
    assert ownership(alone, 0, here) == OWN
    add_holder(alone, 0, 3)
    assert ownership(alone, 0, here) == SHARED
