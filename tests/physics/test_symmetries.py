"""What no result may depend on: units, left and right, the names of the axes, the order of the particles.

With lengths, times and masses times powers of two every result is multiplied by its own power, and no bit differs: a limit or
tolerance in metres, seconds or kilograms would show. Scenes of the plane are mirrored, turned by a right angle, and renumbered;
that changes the order of sums over many particles and no other bit.
"""

import copy
import sys

import numpy as np
import pytest
from conftest import ROOT
from random_scenes import random_scenes
from with_all import with_all, with_search

from particles_mpi import Scene, Simulation

sys.path.insert(0, str(ROOT / "tests" / "parallel"))
from changed_state import SCENES

# Powers of length, time and mass in the unit of a key of a scene, and of a column of the particles.
KEYS = {
    "lower": (1, 0, 0),
    "upper": (1, 0, 0),
    "step": (0, 1, 0),
    "G": (3, -2, -1),
    "position": (1, 0, 0),
    "velocity": (1, -1, 0),
    "radius": (1, 0, 0),
    "mass": (0, 0, 1),
    "acceleration": (1, -2, 0),
    "rate": (0, -1, 0),
    "strength": (1, -2, 1),
    "softening": (1, 0, 0),
    "resistance": (1, 0, 0),
    "contact_duration": (0, 1, 0),
    "temperature": (2, -2, 1),
    "point": (1, 0, 0),
    "drag": (0, -1, 0),
    "spin": (0, -1, 0),
    "moment_of_inertia": (2, 0, 1),
}
COLUMNS = ("position", "velocity", "radius", "mass", "acceleration", "drag", "spin", "moment_of_inertia")
COLUMNS = {name: KEYS[name] for name in COLUMNS} | {
    "total_acceleration": KEYS["acceleration"],
    "free_acceleration": KEYS["acceleration"],
    "rate": KEYS["acceleration"],  # dv/dt
    "virial": (2, -1, 1),  # of impulses, -r.dp
    "contacted": (0, 1, 0),
}
UNITS = {"kilometres": (10, 0, 0), "seconds": (0, -30, 0), "masses": (0, 0, 60), "all": (-33, 21, -50)}


def exponent(powers, unit):
    return sum(power * size for power, size in zip(powers, unit, strict=True))


def in_unit(tables, unit):
    """The tables of a scene with all numbers that have a unit multiplied."""

    def times(value, powers):
        if isinstance(value, dict):
            return {key: times(part, KEYS["temperature"] if key == "temperature" else powers) for key, part in value.items()}
        if isinstance(value, list):
            return [times(part, powers) for part in value]
        return value if isinstance(value, str) else float(np.ldexp(value, exponent(powers, unit)))

    def walk(table):
        for key, value in table.items():
            if key in KEYS:
                table[key] = times(value, KEYS[key])
                continue
            below = list(value.values()) if key == "effects" else value if isinstance(value, list) else [value]
            for part in below:
                if isinstance(part, dict):
                    walk(part)

    tables = copy.deepcopy(tables)
    walk(tables)
    return tables


def end_of(tables, steps=60):
    """The columns of all particles by id, and the counts."""
    sim = Simulation(Scene.from_dict(tables))
    sim.steps(steps)
    order = np.argsort(sim.particles.id)
    return {name: column[order] for name, column in sim.particles.arrays.items()}, sim.totals


def assert_same_in_units(tables, sizes, steps):
    here, counts = end_of(tables, steps)
    for size in sizes:
        there, others = end_of(in_unit(tables, size), steps)
        assert dict(counts) == dict(others), size
        for column, values in here.items():
            scaled = np.ldexp(there[column], -exponent(COLUMNS[column], size)) if column in COLUMNS else there[column]
            assert scaled.tobytes() == values.tobytes(), (size, column)


@pytest.mark.parametrize("name", SCENES)
def test_units_change_no_bit(name):
    """Except `adaptive` with another length: it finds the round-off of forces by moving places by what depends on their bits."""
    assert_same_in_units(SCENES[name], [(size[0] * (name != "adaptive"), *size[1:]) for size in UNITS.values()], 60)


@pytest.mark.parametrize(
    ("seed", "count", "axes"), [(41, 25, 3), *with_all((41, 50, 4)), *with_search(*((seed, 50, 4) for seed in range(42, 50)))]
)
def test_units_change_no_bit_of_random_scenes(seed, count, axes):
    for number, (_, tables, _) in enumerate(random_scenes(seed, count, axes)):
        if tables["time"]["integrator"] != "adaptive":
            assert_same_in_units(tables, [list(UNITS.values())[number % len(UNITS)]], tables["time"]["steps"])


def mirrored(v):
    return v * [-1.0, 1.0]


def turned(v):
    """By a right angle; so axes change places too."""
    return np.stack((-v[..., 1], v[..., 0]), axis=-1)


def moved(tables, how):
    """A scene with all its vectors mirrored or turned."""
    tables = copy.deepcopy(tables)
    (population,), box, effects = tables["particles"], tables["box"], tables["effects"]
    for name in ("position", "velocity"):
        population[name] = how(np.array(population[name])).tolist()
    corners = how(np.array([box["lower"], box["upper"]], float))
    tables["box"] = box | {"lower": corners.min(axis=0).tolist(), "upper": corners.max(axis=0).tolist()}
    if "uniform_gravity" in effects:
        effects["uniform_gravity"]["acceleration"] = how(np.array(effects["uniform_gravity"]["acceleration"])).tolist()
    return tables


def listed(tables, order=None):
    """A scene whose particles are given one by one, in this order."""
    particles, _ = end_of(tables, 0)
    names = ("position", "velocity", "radius", "mass")
    order = np.arange(len(particles["id"])) if order is None else order
    return tables | {"particles": [{name: particles[name][order].tolist() for name in names}]}


def assert_same(name, one, other):
    """Bit by bit; where many attract one another, but for the round-off of their sums, which grows."""
    summed = any(kind in name for kind in ("attracted", "tree", "order4", "adaptive"))
    np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-6 if summed else 0.0)


@pytest.mark.parametrize("how", [mirrored, turned])
@pytest.mark.parametrize("name", SCENES)
def test_left_and_right_and_the_names_of_axes_do_not_matter(name, how):
    tables = listed(SCENES[name])
    (here, counts), (there, others) = end_of(tables, 25), end_of(moved(tables, how), 25)
    assert dict(counts) == dict(others)
    for column in ("position", "velocity"):
        assert_same(name, how(here[column]), there[column])
    if "spin" in here:
        assert_same(name, here["spin"], -there["spin"] if how is mirrored else there["spin"])


@pytest.mark.parametrize("name", SCENES)
def test_the_order_of_particles_does_not_matter(name):
    order = np.random.default_rng(5).permutation(24)
    (here, counts), (there, others) = end_of(listed(SCENES[name]), 25), end_of(listed(SCENES[name], order), 25)
    assert dict(counts) == dict(others)
    for column in {"position", "velocity", "spin"} & here.keys():
        assert_same(name, here[column][order], there[column])
