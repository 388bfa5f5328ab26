"""Lattices by formula: any part is that of the whole."""

from itertools import product
from math import prod

import numpy as np
import pytest

from particles_mpi.initial.lattices import every_second, lattice, thinned
from particles_mpi.initial.room import Room


def room(d, periodic, edge=1.0):
    lower, upper = np.zeros(d), edge * (1.0 + 0.1 * np.arange(d))
    none = np.empty((0, d))
    return Room(lower, upper, (upper - lower) * periodic, none, none, True, True)


@pytest.mark.parametrize("layers", [*product(range(1, 5), repeat=3), *product(range(1, 7), repeat=2), (7,)])
def test_every_second_point_of_a_grid(layers):
    """Against all points, of which every second one is taken."""
    points = np.indices(layers).reshape(len(layers), -1).T
    assert np.array_equal(every_second(layers, np.arange((prod(layers) + 1) // 2)), points[points.sum(axis=1) % 2 == 0])


def test_sites_are_thinned_evenly_and_beyond_64_bits():
    for sites, count in [(7, 3), (100, 99), (5, 5), (1, 1)]:
        assert thinned(sites, count, 0, count).tolist() == [k * sites // count for k in range(count)]
    for sites, count in [(10**13 + 7, 10**13), (8 * 10**9 - 1, 4 * 10**9), (2**62, 2**61 + 1)]:
        assert thinned(sites, count, count - 3, count).tolist() == [k * sites // count for k in range(count - 3, count)]


@pytest.mark.parametrize("periodic", [0.0, 1.0])
@pytest.mark.parametrize(
    ("d", "count", "radius"), [(1, 40, 0.01), (2, 700, 0.015), (2, 700, 0.019), (3, 3000, 0.02), (3, 3000, 0.035)]
)
def test_parts_of_a_lattice_are_those_of_the_whole(d, count, radius, periodic):
    whole = lattice(count, radius, room(d, periodic), 0, count)
    assert whole.shape == (count, d)
    for first, last in [(0, 1), (5, 5), (count // 3, count // 2), (count - 1, count)]:
        assert np.array_equal(lattice(count, radius, room(d, periodic), first, last), whole[first:last])
