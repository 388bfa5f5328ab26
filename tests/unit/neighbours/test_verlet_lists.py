"""Neighbour lists whose rows move one at a time hold, after every move, the pairs that are near, and no others."""

import numpy as np
import pytest

from particles_mpi import Scene, Simulation
from particles_mpi.kernels.geometry import Box, image_shifts
from particles_mpi.neighbours.verlet_cells import make_grid
from particles_mpi.neighbours.verlet_kernels import BEGIN, BLOCK_NUMBERS, COUNT, PLACES, SIZE, list_rows
from particles_mpi.neighbours.verlet_lists import VerletLists


def listed(lists, n):
    """The set of rows in the list of each row."""
    arrays = lists.arrays
    begins, counts = arrays.spans[:n, BEGIN], arrays.spans[:n, COUNT]
    rows = [arrays.pool[b : b + c].tolist() for b, c in zip(begins, counts, strict=True)]
    assert all(len(row) == len(set(row)) for row in rows)
    return [set(row) for row in rows]


def near(lists, n, d, length):
    """The same by all pairs of reference positions."""
    reference = lists.arrays.reference[:n]
    r = reference[:, None, :d] - reference[None, :, :d]
    r -= image_shifts(r, length)
    reach = reference[:, None, d + SIZE] + reference[None, :, d + SIZE]
    return [set(np.flatnonzero(row).tolist()) for row in ((r**2).sum(axis=2) <= reach**2) & ~np.eye(n, dtype=bool)]


@pytest.mark.parametrize("d", [1, 2, 3])
@pytest.mark.parametrize("periodic", [False, True])
def test_lists_follow_every_move(d, periodic):
    random = np.random.default_rng(d)
    n, side = 150, {1: 60.0, 2: 12.0, 3: 7.0}[d]
    length = np.full(d, side if periodic else 0.0)
    radius = np.where(np.arange(n) == 3, 0.3 * side, 0.3)  # one is large: its list does not fit into its block
    lists = VerletLists(Box(np.zeros(d), np.full(d, side), length))
    lists.width = 0.2
    x = random.uniform(0.0, side, (n, d))
    x[3] = 0.5 * side
    lists.build(x, radius, np.ones(n))
    assert lists.arrays.spans[3, COUNT] > BLOCK_NUMBERS - PLACES
    for move in range(60):
        i = int(random.integers(n)) if move % 10 else 3
        far = random.integers(-2, 3, d) * length  # in whole boxes, which changes nothing
        x = lists.arrays.reference[: i + 1, :d].copy()
        x[i] += random.uniform(-0.5, 0.5, d) + far
        row = i
        while row == i:
            row, short = list_rows((0,) * d, tuple(lists.arrays), x, i)
            lists.enlarge(short)
        if move == 30:
            lists.grow()
        assert listed(lists, n) == near(lists, n, d, length)


@pytest.mark.parametrize("sizes", [[0.0, 20.0, 1e30], [0.0, 1e-300, 1e300], [0.0, 0.0, 0.0]])
def test_sizes_of_any_magnitude_have_a_level(sizes):
    """No warning (it is an error here), and no smaller sphere is in a level of larger ones than a larger sphere."""
    box = Box(np.full(2, -np.inf), np.full(2, np.inf), np.zeros(2))
    _, level = make_grid(np.random.default_rng(1).random((3, 2)), np.array(sizes), box, 1.0)
    assert (np.diff(level) >= 0).all()


def test_open_space_has_as_many_cells_as_a_box():
    """Without a box the grid is around the particles: else a new list would look at all of them."""
    places = [[x, y, z] for x in range(8) for y in range(8) for z in range(8)]
    particles = [{"position": places, "velocity": [0.1, 0.0, 0.0], "radius": 0.3}]
    cells = []
    for box in (None, {"lower": [-100.0] * 3, "upper": [100.0] * 3}):
        scene = Scene(
            dimension=3, box=box, time={"step": 0.1, "steps": 1}, particles=particles, effects={"collisions": {"mode": "event"}}
        )
        sim = Simulation(scene)
        sim.step()
        cells.append(sim.drift.operator.whole.engine.lists.arrays.grid[2].prod(axis=1).max())
    assert cells[0] == cells[1] > 50
