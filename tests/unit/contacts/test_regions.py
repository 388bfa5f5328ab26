"""Which ghosts can have touched an own row: as all pairs say."""

from types import SimpleNamespace

import numpy as np
import pytest
from numba import njit
from with_all import with_all

from particles_mpi.contacts.event_driven.engine import Engine
from particles_mpi.contacts.event_driven.partition import DEPTH, Partition
from particles_mpi.contacts.event_driven.regions import Regions, can_affect_owned, distances2
from particles_mpi.contacts.event_driven.rows import OWNERSHIP, SHARED, Log, Rows, save_once
from particles_mpi.contacts.law import Loss
from particles_mpi.kernels.geometry import Box, image_shifts
from particles_mpi.kernels.markers import START
from particles_mpi.kernels.planes import no_planes
from particles_mpi.neighbours.verlet_kernels import Lists, list_rows
from particles_mpi.particles import Particles, default_values


@njit
def affect(rows, lists, log, regions, ghosts, begin, place, found):
    rows, lists, log, regions = Rows(*rows), Lists(*lists), Log(*log), Regions(*regions)
    for p in range(len(ghosts)):
        found[p] = can_affect_owned(rows, lists, log, regions, ghosts[p], begin, place)


@njit
def save(axes, rows, log, some):
    rows, log = Rows(*rows), Log(*log)
    for i in some:
        save_once(axes, rows, i, log)


def some_rows(d, periodic, seed):
    """(the answer of the kernel, that of all pairs) for each ghost of a rank that owns half of a box."""
    random = np.random.default_rng(seed)
    n, side, skin, bound, begin = 400, {1: 200.0, 2: 20.0, 3: 9.0}[d], 0.2, 0.2, 0.3
    box = Box(np.zeros(d), np.full(d, side), np.full(d, side * periodic))
    names = "id", "position", "velocity", "mass", "radius", "fixed", "contacted"
    p = Particles(d, {name: default_values(name, n, d) for name in names})
    p.id[:] = np.arange(n)
    p.position[:] = random.uniform(0.0, side, (n, d))
    p.velocity[:] = random.uniform(-0.2, 0.2, (n, d))
    p.radius[:] = random.uniform(0.05, 0.1, n)
    p.mass[:] = 1.0
    half = 0.5 * side
    low, high = np.zeros((2, d)), np.full((2, d), side)
    high[0, 0] = low[1, 0] = half
    own = p.position[:, 0] < half
    order = np.argsort(~own, kind="stable")
    p = Particles(d, {name: column[order] for name, column in p.arrays.items()})
    engine = Engine(box, Loss(1.0, 1.0), np.zeros((1, 2)), no_planes(d))
    engine.lists.width = skin
    engine.lists.build(p.position, p.radius, p.inverse_mass, 0)
    engine.load(p, int(own.sum()))
    rows, log, state = engine.rows, engine.log, engine.rows.state
    rows.segment[:, :d] += random.uniform(-0.5, 0.5, (n, d)) * (skin / d)
    rows.segment[:, d : 2 * d], rows.segment[:, 2 * d + START] = p.velocity, 0.0
    state[: own.sum(), OWNERSHIP] = SHARED
    places = rows.segment[:, :d] + rows.segment[:, d : 2 * d] * begin
    some = random.permutation(n)[: n // 3]  # have changed since
    save((0,) * d, tuple(rows), tuple(log), some)
    rows.segment[some, :d] += random.uniform(-10.0, 10.0, (len(some), d))
    rows.segment[some, 2 * d + START] = 0.9
    for i in some[:40].tolist():  # have got new reference positions, as far away as they can be
        x = engine.lists.arrays.reference[: i + 1, :d].copy()
        x[i] = places[i] + (skin + bound) * random.choice([-1.0, 1.0], d) / np.sqrt(d)
        row = i
        while row == i:
            row, short = list_rows((0,) * d, tuple(engine.lists.arrays), x, i)
            engine.lists.enlarge(short)
    reach = skin + 2.0 * bound + float(p.radius.max())
    regions = Regions(low, high, tuple(box), 0, np.array([1, 0]), reach, bound, reach + 1.0)
    ghosts = np.arange(int(own.sum()), n)
    found = np.zeros(len(ghosts), np.bool_)
    affect(tuple(rows), tuple(engine.lists.arrays), tuple(log), tuple(regions), ghosts, begin, np.empty((2, d)), found)
    r = places[ghosts, None] - places[None, : ghosts[0]]
    r -= image_shifts(r, box.length)
    expected = (np.sqrt((r**2).sum(axis=2)) <= p.radius[ghosts, None] + p.radius[None, : ghosts[0]] + 2.0 * bound).any(axis=1)
    return found, expected


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("d", [3, *with_all(1, 2)])
def test_ghosts_that_can_have_touched_an_own_row(d, periodic):
    """Wherever rows are within their skins, and whatever became of them in the window: it is where they began that counts."""
    touching = 0
    for seed in range(20):
        found, expected = some_rows(d, periodic, seed)
        assert (found == expected).all()
        touching += expected.sum()
    assert touching > 10


@pytest.mark.parametrize("length", [0.0, 7.3])
def test_two_ranks_are_as_far_apart_for_both(length):
    """To the bit: else one may wait for a message that the other does not send."""
    random = np.random.default_rng(5)
    low = random.uniform(0.0, 7.0, (300, 3))
    high = low + random.uniform(0.0, 0.3, low.shape)
    found = np.array([distances2(low, high, rank, np.full(3, length)) for rank in range(len(low))])
    assert (found == found.T).all() and (found.diagonal() == 0.0).all() and (found > 0.0).any()


@pytest.mark.parametrize("d", [1, 2, 3])
def test_own_rows_touch_nobody_beyond_the_reach_of_their_region(d):
    """Own rows are within their skin of reference positions in the region, and ghosts go no further than `bound` in a window."""
    random = np.random.default_rng(d)
    skin, largest = 0.3, 0.5
    cut = SimpleNamespace(lower=np.array([[-np.inf] * d, [0.0] * d]), upper=np.array([[0.0] * d, [np.inf] * d]))
    part = SimpleNamespace(
        ranks=SimpleNamespace(rank=0), balance=SimpleNamespace(decomposition=cut), skin=skin, depth=DEPTH,
        box=Box(np.zeros(d), np.zeros(d), np.zeros(d)),
    )  # fmt: skip
    Partition.divide(part, largest, 0.4)
    regions, worst = part.regions, -np.inf

    def aside(most):
        """A vector of any direction, and of that length mostly."""
        way = np.abs(random.standard_normal(d)) if random.random() < 0.5 else random.standard_normal(d)
        return most * min(1.0, 2.0 * random.random()) * way / np.linalg.norm(way)

    for _ in range(2000):
        reference = -random.random(d) * (random.random(d) < 0.5)
        one, other = largest * np.maximum(random.random(2), 0.5)
        contact = aside(1.0)
        ghost = reference + aside(skin) + (one + other) * contact / np.linalg.norm(contact) + aside(regions.bound)
        worst = max(worst, np.linalg.norm(np.maximum(ghost, 0.0)) - other - regions.reach)
    assert -skin < worst <= 0.0
