"""What must hold where numbers of 32 bits end, with limits that small cases run into."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from particles_mpi import Scene, Simulation
from particles_mpi.contacts.event_driven.rows import EVENT_COUNT
from particles_mpi.errors import StoppedError
from particles_mpi.initial.sphere_grid import SphereGrid
from particles_mpi.kernels import limits
from particles_mpi.kernels.geometry import Box
from particles_mpi.neighbours import cells
from particles_mpi.neighbours.candidates import touching
from particles_mpi.neighbours.verlet_lists import VerletLists
from particles_mpi.parallel import exact_sum
from particles_mpi.parallel.buffers import RowBuffers
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import rows_in_order
from particles_mpi.particles import Particles

OPEN = Box(np.full(3, -np.inf), np.full(3, np.inf), np.zeros(3))


def gas(mode, steps=0):
    scene = Scene(
        dimension=3,
        seed=5,
        box={"lower": [0.0] * 3, "upper": [1.0] * 3},
        time={"step": 0.05, "steps": 10},
        particles=[{"count": 200, "position": "lattice", "velocity": {"speed": 1.0}, "radius": 0.05, "mass": 1.0}],
        effects={"collisions": {"mode": mode}, "walls": {}},
    )
    sim = Simulation(scene)
    for _ in range(steps):
        sim.step()
    return sim


def in_id_order(sim):
    """Positions and velocities, in one table."""
    return np.hstack((sim.rows.position, sim.rows.velocity))[np.argsort(sim.rows.id)]


def test_cells_are_coarser_where_there_would_be_too_many(monkeypatch):
    expected = in_id_order(gas("rewind", 10))
    x = np.random.default_rng(1).random((1000, 3))
    monkeypatch.setattr(cells, "limits", SimpleNamespace(INT32_MAX=100))
    for fine in (1, 4):
        assert cells.grid(x, (np.zeros(3), np.ones(3)), 0.01, fine).cells.prod() <= 100
    assert np.array_equal(in_id_order(gas("rewind", 10)), expected)


def test_lists_of_neighbours_do_not_outgrow_their_places(monkeypatch):
    x, ones = np.random.default_rng(1).random((50, 3)), np.ones(50)
    lists = VerletLists(OPEN)
    lists.width = 0.01
    monkeypatch.setattr(limits, "INT32_MAX", 2000)
    lists.build(x, 0.01 * ones, ones)
    room = len(lists.arrays.pool)
    lists.enlarge(2000 - room)
    assert len(lists.arrays.pool) == 2000
    for action in (lambda: lists.enlarge(1), lists.grow, lambda: lists.build(x, ones, ones, spare=50)):
        if action == lists.grow:
            lists.arrays.used[0] = 1500
        with pytest.raises(StoppedError, match=r"places in lists of neighbours on one rank, more than 2000: use more ranks"):
            action()


def test_candidate_pairs(monkeypatch):
    x, ones = np.random.default_rng(1).random((200, 3)), np.ones(200)
    monkeypatch.setattr(limits, "INT32_MAX", 20)
    with pytest.raises(StoppedError, match=r"candidate pairs on one rank, more than 20: use more ranks"):
        touching(x, 0.2 * ones, ones, np.arange(200), np.zeros(3))


def test_rows_and_spheres(monkeypatch):
    monkeypatch.setattr(limits, "INT32_MAX", 10)
    particles = Particles(3, {"id": np.arange(10), "position": np.zeros((10, 3))})
    rows = RowBuffers(particles)
    rows.adopt()
    with pytest.raises(StoppedError, match=r"^11 particles and ghosts on one rank, more than 10: use more ranks$"):
        rows.reserve(11)
    monkeypatch.setattr(limits, "INT32_MAX", 640)
    counts, reach = np.array([30, *[0] * 9]), np.array([0.1, *[-1.0] * 9])
    spheres = SphereGrid(np.zeros(3), np.ones(3), np.zeros(3), counts, reach)
    with pytest.raises(StoppedError, match=r"^641 spheres on one rank"):
        spheres.append(np.random.default_rng(1).random((641, 3)), np.full(641, 0.1), np.arange(641))


def test_a_particle_may_have_any_number_of_contacts():
    expected, sim = gas("event", 5), gas("event", 4)
    assert expected.totals["collisions"] > 100
    sim.near.whole.engine.rows.state[:, EVENT_COUNT] = 2**31 - 1
    sim.step()
    assert np.array_equal(in_id_order(sim), in_id_order(expected))


@given(st.lists(st.floats(), max_size=30))
def test_sums_of_few_have_the_bits_of_sums_by_digits(values):
    """Also where values, or sums of some of them, are infinite, are no numbers, or are negative zeros."""
    column = np.array(values, float)
    few = np.array(exact_sum.exact_sums(Communicator.alone(), [column]))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(exact_sum, "FEW_VALUES", -1)
        digits = np.array(exact_sum.exact_sums(Communicator.alone(), [column]))
    assert few.tobytes() == digits.tobytes() or (np.isnan(few).all() and np.isnan(digits).all())


def test_digits_of_sums_stay_small(monkeypatch):
    values = np.random.default_rng(1).standard_normal(1000) * 10.0 ** np.arange(-300, 200, 0.5)
    expected = exact_sum.exact_sums(Communicator.alone(), [values, -values, np.abs(values)])
    monkeypatch.setattr(exact_sum, "BLOCK", 7)
    assert exact_sum.exact_sums(Communicator.alone(), [values, -values, np.abs(values)]) == expected
    for sign in (1.0, -1.0):
        digits = np.zeros(exact_sum.DIGITS, np.int64)
        exact_sum.accumulate(sign * values, digits)
        assert digits[:-2].min() >= 0 and digits.max() < 2**32 and digits[-2] in (0, -1)
        assert exact_sum.rounded(digits) == sign * expected[0]


@given(st.lists(st.integers(-3, 3), max_size=8))
def test_rows_are_in_the_order_of_their_ids(ids):
    """Those of ids that repeat as they stand, also where there are as many as would be different ones."""
    ids = np.array(ids, np.int64)
    assert rows_in_order(ids).tolist() == sorted(range(len(ids)), key=ids.__getitem__)


def test_diagnostics_by_blocks_of_rows(monkeypatch):
    """Energies, momenta and observables of rough spheres that attract one another, some of them fixed: the same bits."""
    balls = {"position": "random", "radius": 0.3, "mass": 2.0}
    scene = Scene.from_dict(
        {
            "dimension": 3,
            "box": {"lower": [0.0] * 3, "upper": [9.0] * 3},
            "time": {"step": 0.01, "steps": 3},
            "particles": [
                {"count": 40, "velocity": {"speed": 2.0}, "spin": [1.0, 0.0, 0.5]} | balls,
                {"count": 5, "fixed": True} | balls,
            ],
            "effects": {
                "collisions": {"tangential_restitution": 0.5},
                "mutual_gravity": {"softening": 0.1},
                "uniform_gravity": {"acceleration": [0.0, 0.0, -1.0]},
            },
            "output": {"observables": True},
        }
    )
    rows = []
    for block in (2**14, 7):
        monkeypatch.setattr(exact_sum, "FEW_VALUES", 0)
        monkeypatch.setattr(exact_sum, "BLOCK", block)
        sim = Simulation(scene)
        sim.steps(3)
        rows.append(sim.measure(row=True))
    assert {"rotational", "virial_ratio", "temperature"} <= rows[0].keys() and repr(rows[0]) == repr(rows[1])
