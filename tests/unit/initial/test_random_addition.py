"""Random sequential addition against spheres that are put one after the other, by hand."""

import numpy as np
import pytest

from particles_mpi.initial import random_addition
from particles_mpi.initial.random_addition import RandomAddition, points_of
from particles_mpi.initial.random_numbers import LOW_HALF
from particles_mpi.initial.room import Room
from particles_mpi.parallel.communicator import Communicator

KEY = 0x123456789ABCDEF
NONE = np.empty((0, 2))


def room(periodic=False, walls=(), d=2):
    lower, upper = np.zeros(d), np.full(d, 2.0)
    point, normal = (np.array(part, float).reshape(-1, d) for part in (walls or ((), ())))
    return Room(lower, upper, 2.0 * np.full(d, float(periodic)), point, normal, True, True)


def one_after_the_other(room, x, radius, count, new_radius):
    """Spheres of one class of radius: throw after throw, in each the larger first, then the lower numbers."""
    places, radii, found = list(x), list(radius), {}
    key = np.array([KEY >> 32 * k & int(LOW_HALF) for k in range(2)], np.uint64)
    order = np.lexsort((np.arange(count), -new_radius))
    for throw in range(10_000):
        points, clear = points_of(key, np.arange(count), np.array([throw]), new_radius, room)
        for i in order:
            if i in found or not clear[i]:
                continue
            gap = np.array(places).reshape(-1, len(room.lower)) - points[i]
            gap -= room.length * np.rint(gap / np.where(room.length > 0.0, room.length, np.inf))
            if (np.sqrt((gap**2).sum(axis=1)) >= np.array(radii) + new_radius[i]).all():
                found[i] = points[i]
                places.append(points[i])
                radii.append(new_radius[i])
        if len(found) == count:
            return np.array([found[i] for i in range(count)])
    raise AssertionError


@pytest.mark.parametrize(("few", "points"), [(0, 1), (10_000, 1), (10_000, 100_000), (30, 1000)])
@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("spread", [0.0, 0.4])
def test_all_at_once_is_one_after_the_other(monkeypatch, few, points, periodic, spread):
    """However many are thrown at once, and whether each rank throws all or not. Radii of one class: above half of the largest."""
    monkeypatch.setattr(random_addition, "FEW_LEFT", few)
    monkeypatch.setattr(random_addition, "POINTS_AT_ONCE", points)
    count, d = 150, 2
    radius = 0.06 * (1.0 - spread * np.random.default_rng(1).random(count))
    x, known = np.array([[1.0, 1.0], [0.1, 1.9]]), np.array([0.05, 0.058])
    walls = ([[0.3, 0.3]], [[np.sqrt(0.5)] * 2])
    where = room(periodic, walls, d)
    expected = one_after_the_other(where, x, known, count, radius)
    addition = RandomAddition(Communicator.alone(), where, x, known, [radius])
    found, missing = addition.place(KEY, np.arange(count), radius)
    assert not missing and np.array_equal(found, expected)


def test_numbers_and_not_rows_decide():
    """Some spheres of many, with the numbers that they have among all."""
    where, none = room(d=3), np.empty((0, 3))
    addition = RandomAddition(Communicator.alone(), where, none, np.empty(0), [np.full(20, 0.01)])
    all_, _ = addition.place(KEY, np.arange(20), np.full(20, 0.01))
    some = RandomAddition(Communicator.alone(), where, none, np.empty(0), [np.full(5, 0.01)])
    assert np.array_equal(some.place(KEY, np.arange(15, 20), np.full(5, 0.01))[0], all_[15:])
