"""Candidates are a superset of what can touch: against all pairs, at the search and after turns; with images and giants."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from with_all import with_all

from particles_mpi.kernels.motion import Segments
from particles_mpi.kernels.planes import no_planes
from particles_mpi.neighbours.candidates import Candidates, Pairs, touching
from particles_mpi.neighbours.halo_region import everywhere
from particles_mpi.neighbours.pair_search import LEAVING, TURNED
from particles_mpi.neighbours.trajectories import Horizon, Spheres


def closest(x, v, start, end, length):
    """Smallest distance of straight paths from x at `start` (n,) with v, over [start, end], by nearest images; (n, n)."""
    at = lambda t: x[:, None] + v[:, None] * (t - start[:, None, None]) - x[None] - v[None] * (t - start[None, :, None])  # noqa: E731
    begin = np.maximum(start[:, None], start[None])
    least = np.full(begin.shape, np.inf)
    for share in np.linspace(0.0, 1.0, 31):
        r = at((begin + share * (end - begin))[:, :, None])
        r -= np.where(length > 0.0, length * np.rint(r / np.where(length > 0.0, length, 1.0)), 0.0)
        least = np.minimum(least, np.sqrt((r**2).sum(axis=2)))
    return least


def listed(c):
    first, second = c.pairs[:2]
    return set(zip(first.tolist(), second.tolist(), strict=True))


def told_too_late_or_early(c, x, v, start, until, length):
    """How often candidates on straight paths from x at `start` (n,) touch at a time when they are not said to be near."""
    first, second, begin, end = c.pairs
    wrong = 0
    for t in np.linspace(start.max(), until, 41):
        r = (x + v * (t - start)[:, None])[first] - (x + v * (t - start)[:, None])[second]
        r -= np.where(length > 0.0, length * np.rint(r / np.where(length > 0.0, length, 1.0)), 0.0)
        touch = np.sqrt((r**2).sum(axis=1)) <= c.spheres.radius[first] + c.spheres.radius[second]
        wrong += np.count_nonzero(touch & ~((begin <= t) & (t <= end)))
    return wrong


def at_start(c):
    """All rows on segments that begin now."""
    return Segments(c.x, c.v, np.zeros(len(c.x)), np.full(len(c.x), -1))


@settings(max_examples=25)
@given(
    seed=st.integers(0, 10**6),
    d=st.sampled_from([2, 3]),
    n=st.sampled_from([2, 7, 60, 160]),
    periodic=st.booleans(),
    giant=st.booleans(),
    crowded=st.booleans(),
    fast=st.booleans(),
    why=st.sampled_from([LEAVING, TURNED]),
)
def test_every_pair_whose_paths_come_near_is_listed_once(seed, d, n, periodic, giant, crowded, fast, why):
    random = np.random.default_rng(seed)
    side, end, half = (3.0 if crowded else 10.0) * (n / 60) ** (1 / d), 0.5, 0.02
    x, v = random.random((n, d)) * side, random.normal(size=(n, d))
    radius, ids = random.random(n) * (0.05 if crowded else 0.2), random.permutation(n).astype(np.int64)
    if giant:
        radius[0] = 1.5
    if fast:
        v *= random.choice([0.1, 1.0, 4.0], (n, 1), p=[0.85, 0.1, 0.05])
    w = np.where(random.random(n) < 0.9, 1.0, 0.0)
    v[w == 0.0] = 0.0
    owned = n if periodic else max(1, 2 * n // 3)
    length = np.full(d, side if periodic else 0.0)
    bound = 1.1 * end * float(np.sqrt((v**2).sum(axis=1)).max()) + half
    if periodic and 4.0 * (radius.max() + bound + half) > side:  # what the caller sees to
        assume(4.0 * radius.max() < side)
        end = bound = half = 0.0
    horizon = Horizon(end, half, bound)
    c = Candidates(x, v, Spheres(radius, w, ids, owned), length, tuple(no_planes(d)), horizon, everywhere(d), 0)

    def check(x, v, start):
        near = closest(x, v, start, np.maximum(end, start[:, None]), length) <= (radius[:, None] + radius[None]) * (1.0 - 1e-12)
        found = listed(c)
        assert len(found) == c.pair_count
        assert told_too_late_or_early(c, x, v, start, end, length) == 0
        for i, j in np.argwhere(np.triu(near, 1)).tolist():
            kept = (i < owned or j < owned) and (w[i] > 0.0 or w[j] > 0.0) and radius[i] + radius[j] > 0.0
            first, second = (i, j) if ids[i] < ids[j] else (j, i)
            assert ((first, second) in found) == kept or not kept

    start = np.zeros(n)
    check(x, v, start)
    if not end:
        return
    # Some rows turn on the way, others fly on: those that turn later look for those that turned before.
    x0, begun = x.copy(), np.zeros(n)
    for now in (0.1, 0.2, 0.3):
        turning = np.flatnonzero((random.random(n) < 0.3) & (w > 0.0)).astype(np.int32)
        c.x[:] = x0 + (now - begun)[:, None] * c.v
        c.v[turning] = random.permutation(c.v[turning])
        c.time = now
        c.room = Pairs(*(column.copy() for column in c.pairs))  # no room left
        if c.follow(turning.copy(), why, at_start(c), 0.01) != 0.0:
            return
        x0[turning], begun[turning] = c.x[turning], now
        end = c.horizon.valid_until
        check(c.x, c.v, np.full(n, now))


@pytest.mark.parametrize("speed", [0.1, 0.5, 1.4, 5.0])
def test_a_row_that_turns_is_found_where_it_goes(speed):
    """One that was slow gets fast, and before it is there, another one turns in its way: many cells from where it was sorted."""
    random, n = np.random.default_rng(1), 10_000
    x, v = random.random((n, 2)) * 10.0, random.normal(size=(n, 2)) * 0.05
    x[:2] = (2.0, 5.0), (2.0 + 0.45 * speed, 5.0)
    v[1] = 0.0
    horizon = Horizon(0.5, 0.02, np.inf)
    spheres = Spheres(np.full(n, 1e-3), np.ones(n), np.arange(n), n)
    c = Candidates(x, v, spheres, np.zeros(2), tuple(no_planes(2)), horizon, everywhere(2), 0)
    for now, row, turned in ((0.05, 0, (speed, 0.0)), (0.1, 1, (0.0, 0.01))):
        c.x[:] = x + now * v
        c.x[0, 0] = x[0, 0] + 0.05 * v[0, 0] + (now - 0.05) * speed
        c.x[0, 1] = x[0, 1] + 0.05 * v[0, 1]
        c.v[row] = turned
        c.time = now
        assert c.follow(np.array([row], np.int32), LEAVING, at_start(c), 0.01) == 0.0
    assert (0, 1) in listed(c)


def test_a_search_that_needs_more_room_goes_on_where_it_stopped():
    """The same pairs in the same order, and as many tests, whatever room there is at the start."""
    random = np.random.default_rng(5)
    x, v, n = random.random((900, 3)), random.normal(size=(900, 3)), 900
    spheres = Spheres(np.full(n, 0.05), np.ones(n), np.arange(n), n)
    horizon = Horizon(0.05, 0.01, np.inf)
    small, large = (
        Candidates(x, v, spheres, np.zeros(3), tuple(no_planes(3)), horizon, everywhere(3), room) for room in (0, 100_000)
    )
    assert large.pair_count > 3000 and small.tests == large.tests
    assert all(map(np.array_equal, small.pairs, large.pairs))


@pytest.mark.parametrize("n", [1, 5])
def test_points_at_one_place_have_cells(n):
    """Cells of no size; warnings are errors here."""
    none = touching(np.full((n, 2), 0.3), np.zeros(n), np.ones(n), np.arange(n), np.zeros(2))
    assert len(none[0]) == len(none[1]) == 0


@pytest.mark.parametrize("why", [LEAVING, TURNED])
def test_no_room_for_the_first_pair(why):
    """A row that is turned towards another, when there is room for no pair at all: its way begins once, and the pair is found."""
    x, v, horizon = np.array([[0.0, 0.0], [1.0, 0.0]]), np.zeros((2, 2)), Horizon(1.0, 0.01, np.inf)
    spheres = Spheres(np.full(2, 0.1), np.ones(2), np.arange(2), 2)
    c = Candidates(x, v, spheres, np.zeros(2), tuple(no_planes(2)), horizon, everywhere(2), 0)
    assert c.pair_count == 0
    c.room = c.pairs
    c.v[0] = 2.0, 0.0
    assert c.follow(np.array([0], np.int32), why, at_start(c), 0.01) == 0.0
    assert listed(c) == {(0, 1)} and not c.marked.any()


def test_touching_spheres_against_all_pairs():
    random = np.random.default_rng(1)
    x, radius = random.random((400, 3)) * 4.0, random.random(400) * 0.2
    radius[3] = 1.0  # one large among small
    length = np.array([4.0, 0.0, 4.0])
    r = x[:, None] - x[None]
    r -= np.where(length > 0.0, length * np.rint(r / 4.0), 0.0)
    near = np.triu((r**2).sum(axis=2) <= (radius[:, None] + radius[None]) ** 2, 1)
    first, second = touching(x, radius, np.ones(400), np.arange(400), length)
    assert set(zip(first.tolist(), second.tolist(), strict=True)) >= set(map(tuple, np.argwhere(near).tolist()))
    assert len(first) == near.sum()


@pytest.mark.parametrize("d", [1, 2, 3, *with_all(4)])
@pytest.mark.parametrize("unit", [1.0, 1e-25, 1e25])
@pytest.mark.parametrize("far", [1.0, 1e3, 1e9])
def test_screening_in_float32_loses_no_pair(d, unit, far):
    """Spheres that only just touch, in a box that is small or large beside them, in any unit of length."""
    random = np.random.default_rng(d)
    direction = random.normal(size=(300, d))
    direction /= np.sqrt((direction**2).sum(axis=1))[:, None]
    radius = random.uniform(0.1, 1.0, (300, 2))
    place = random.random((300, d)) + 5.0 * np.arange(300)[:, None]  # in a row along the diagonal
    x = np.stack((place, place + direction * radius.sum(axis=1)[:, None] * (1.0 - 1e-10)), axis=1).reshape(600, d)
    x = np.append(x, np.full((1, d), far * 1500.0), axis=0) * unit
    radius = np.append(radius.ravel(), 0.0) * unit
    first, second = touching(x, radius, np.ones(601), np.arange(601), np.zeros(d))
    assert set(zip(first.tolist(), second.tolist(), strict=True)) >= {(2 * k, 2 * k + 1) for k in range(300)}


@pytest.mark.parametrize("wall", [0, 1])
def test_only_rows_near_a_wall_are_listed(wall):
    x = np.array([[0.5, 5.0], [5.0, 5.0], [9.8, 5.0], [5.0, 0.1]])
    v = np.array([[-1.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]])
    point, normal = np.array([[0.0, 0.0], [10.0, 10.0]]), np.array([[1.0, 0.0], [-1.0, 0.0]])
    spheres, horizon = Spheres(np.full(4, 0.1), np.ones(4), np.arange(4), 4), Horizon(0.5, 0.01, 2.0)
    lower, upper = np.array([[0.0, -np.inf], [-np.inf, -np.inf]]), np.array([[np.inf, np.inf], [10.0, np.inf]])
    planes = (point[[wall]], normal[[wall]], np.ones(1), np.ones(1), lower[wall], upper[wall], False)
    c = Candidates(x, v, spheres, np.zeros(2), planes, horizon, everywhere(2), 0)
    assert c.near_wall.tolist() == [[0], [2]][wall]


@pytest.mark.parametrize("length", [0.5, 0.7, 0.9])
def test_who_touches_through_two_images_is_found_once(length):
    first, second = touching(
        np.array([[0.1, 0.1], [0.3, 0.1]]), np.full(2, 0.2), np.ones(2), np.arange(2), np.array([length, 0.0])
    )
    assert (first.tolist(), second.tolist()) == ([0], [1])
