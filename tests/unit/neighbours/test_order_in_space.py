"""Rows that are near in space are near in memory, however many there are."""

import numpy as np
import pytest

from particles_mpi.neighbours.cells import SLAB, bounds, order_in_space


@pytest.mark.parametrize("shape", [(30, 7), (12, 9, 10), (20, 8 * SLAB + 5, 20), (4, 8 * SLAB, 4, 2)])
def test_neighbours_are_within_a_slab_of_one_another(shape):
    """Points of a lattice, one in a cell: on the last axis the next row, on the first one those of a slab further on."""
    x = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, len(shape)) + 0.5
    order = order_in_space(x, bounds(x))
    assert np.array_equal(np.sort(order), np.arange(len(x)))
    row_of = np.argsort(order).reshape(shape)
    slab = min(shape[1], SLAB) if len(shape) > 2 else 1
    furthest = np.abs(np.diff(row_of, axis=0)).max()
    assert furthest <= 3 * slab * np.prod(shape[2 if len(shape) > 2 else 1 :])
