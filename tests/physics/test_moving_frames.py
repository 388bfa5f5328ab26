"""What no result may depend on, in scenes at random: a common fall, a common velocity, the origin, left and right, names of axes.

`test_symmetries.py` has scenes of the plane that somebody thought of; these have any effects, modes and integrators, one to three
axes, and are compared after each step, to the bit where no sum changes its order, else to round-off until that has grown.
"""

import copy

import numpy as np
import pytest
from any_scene import any_scene, assert_same_bits, assert_same_physics, columns
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from with_all import with_search

from particles_mpi import Scene, Simulation

SEEDS = st.integers(0, 2**32 - 1)
PHASES = (Phase.reuse, Phase.generate)  # a smaller seed is no smaller scene
parts = pytest.mark.parametrize("part", [0, *with_search(*range(1, 9))])  # each looks for other examples


def same(value, step):
    return value


def free(tables):
    """Without what knows which velocity is none: walls, fixed particles, drag, friction, and damping at contacts."""
    tables = copy.deepcopy(tables)
    effects, collisions = tables["effects"], tables["effects"].get("collisions", {})
    for name in ("drag", "friction", "walls", "uniform_gravity"):
        effects.pop(name, None)
    if "damping" in collisions:
        collisions["restitution"] = 1.0 - collisions.pop("damping")
    if "friction" not in collisions:
        effects.pop("rolling", None)
    for population in tables["particles"]:
        for name in ("drag", "fixed", *(("spin", "moment_of_inertia") if "friction" not in collisions else ())):
            population.pop(name, None)
    return tables


@parts
@settings(max_examples=15, phases=PHASES)
@given(seed=SEEDS)
def test_what_falls_together_does_not_notice(part, seed):
    tables, rng = any_scene(seed, change=free)
    other, h = copy.deepcopy(tables), tables["time"]["step"]
    g = (5.0 * rng.standard_normal(tables["dimension"])).round(3)
    other["effects"]["uniform_gravity"] = {"acceleration": g.tolist()}
    back = {"position": lambda x, k: x - 0.5 * g * (k * h) ** 2, "velocity": lambda v, k: v - g * k * h, "spin": same}
    assert_same_physics(tables, other, back)


@parts
@settings(max_examples=15, phases=PHASES)
@given(seed=SEEDS)
def test_what_flies_together_does_not_notice(part, seed):
    tables, rng = any_scene(seed, change=free)
    other, h = copy.deepcopy(tables), tables["time"]["step"]
    u = rng.standard_normal(tables["dimension"]).round(3)
    other["particles"][0]["velocity"] = (np.array(tables["particles"][0]["velocity"]) + u).tolist()
    back = {"position": lambda x, k: x - u * (k * h), "velocity": lambda v, k: v - u, "spin": same}
    assert_same_physics(tables, other, back)


@parts
@settings(max_examples=10, phases=PHASES)
@given(seed=SEEDS)
def test_the_origin_does_not_matter(part, seed):
    """All is put elsewhere; along periodic axes the box stays where it is."""
    tables, rng = any_scene(seed)
    other, d = copy.deepcopy(tables), tables["dimension"]
    by, population = rng.uniform(-3.0, 3.0, d).round(4), other["particles"][0]
    places = np.array(population["position"]) + by
    if "box" in tables:
        lower, upper = np.array(tables["box"]["lower"]), np.array(tables["box"]["upper"])
        periodic = np.array(tables["box"]["periodic"])
        places = np.where(periodic, lower + np.mod(places - lower, upper - lower), places)
        other["box"] |= {"lower": np.where(periodic, lower, lower + by).tolist()}
        other["box"] |= {"upper": np.where(periodic, upper, upper + by).tolist()}
    population["position"] = places.tolist()
    for plane in other["effects"].get("walls", {}).get("planes", []):
        plane["point"] = (np.array(plane["point"]) + by).tolist()
    assert_same_physics(tables, other, {"position": lambda x, k: x - by, "velocity": same, "spin": same})


def seen_by(tables, matrix):
    """A scene whose axes are those of a matrix of 0, 1 and -1; spins, as axial vectors, turn with its determinant."""
    other, effects = copy.deepcopy(tables), tables["effects"]
    population, box = other["particles"][0], tables.get("box")

    def to(value):
        return (np.array(value, float) @ matrix.T + 0.0).tolist()

    for name in {"position", "velocity", "acceleration"} & population.keys():
        population[name] = to(population[name])
    if "spin" in population:
        spin = round(np.linalg.det(matrix)) * np.array(population["spin"])
        population["spin"] = to(spin) if tables["dimension"] == 3 else spin.tolist()
    if "uniform_gravity" in effects:
        other["effects"]["uniform_gravity"] = {"acceleration": to(effects["uniform_gravity"]["acceleration"])}
    for plane in other["effects"].get("walls", {}).get("planes", []):
        plane |= {name: to(plane[name]) for name in ("point", "normal")}
    if box:
        corners = np.array([to(box["lower"]), to(box["upper"])])
        periodic = np.abs(matrix) @ np.array(box["periodic"], float) > 0.0
        other["box"] = {
            "lower": corners.min(axis=0).tolist(),
            "upper": corners.max(axis=0).tolist(),
            "periodic": periodic.tolist(),
        }
    return other


@parts
@settings(max_examples=10, phases=PHASES)
@given(seed=SEEDS, how=st.sampled_from(["mirrored", "swapped", "turned"]))
def test_left_and_right_and_names_of_axes_do_not_matter(part, seed, how):
    tables, rng = any_scene(seed)
    d = tables["dimension"]
    matrix = np.eye(d)
    if how == "mirrored" or d == 1:
        matrix[0, 0] = -1.0
    else:
        matrix = matrix[rng.permutation(d)]
        matrix[0] *= -1.0 if how == "turned" else 1.0
    sign = round(np.linalg.det(matrix))
    back = {"position": lambda x, k: x @ matrix, "velocity": lambda v, k: v @ matrix}
    back["spin"] = lambda s, k: sign * (s @ matrix if d == 3 else s)
    assert_same_physics(tables, seen_by(tables, matrix), back)


@parts
@settings(max_examples=10, phases=PHASES)
@given(seed=SEEDS)
def test_the_order_of_particles_does_not_matter(part, seed):
    tables, rng = any_scene(seed)
    population = tables["particles"][0]
    order = rng.permutation(len(population["position"]))
    other = tables | {"particles": [{name: [values[i] for i in order] for name, values in population.items()}]}

    def back(value, step):
        return value[np.argsort(order)]

    assert_same_physics(tables, other, {"position": back, "velocity": back, "spin": back})


@parts
@settings(max_examples=10, phases=PHASES)
@given(seed=SEEDS)
def test_populations_are_but_names(part, seed):
    """The same ids in one table or in two: every field has the same bits."""
    tables, rng = any_scene(seed)
    population = tables["particles"][0]
    cut = int(rng.integers(len(population["position"]) + 1))
    two = [{name: values[part] for name, values in population.items()} for part in (slice(cut), slice(cut, None))]
    other = tables | {"particles": [part for part in two if part["position"]]}
    assert_same_bits(tables, other, fields=columns(Simulation(Scene.from_dict(tables))))
