"""What must change nothing: effects of zero, effects switched off, a wall or a particle very far away, scenes far apart."""

import copy
import json

import numpy as np
import pytest
from any_scene import COUNTS, any_scene, assert_same_bits, assert_same_physics, columns, keeps_contacts, states_of
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from with_all import with_search

from particles_mpi import Run, Scene, SceneError, Simulation

SEEDS = st.integers(0, 2**32 - 1)
PHASES = (Phase.reuse, Phase.generate)  # a smaller seed is no smaller scene
parts = pytest.mark.parametrize("part", [0, *with_search(*range(1, 9))])
FORWARD = ("leapfrog", "taylor")
SAME = {name: lambda value, step: value for name in ("position", "velocity", "spin")}


def with_zero(tables, name):
    """The scene with an effect, or an option, of zero that it has not got; None if it cannot have it."""
    other, effects, integrator = copy.deepcopy(tables), tables["effects"], tables["time"]["integrator"]
    periodic = np.any(tables.get("box", {}).get("periodic", False))
    table = {
        "uniform_gravity": {"acceleration": [0.0] * tables["dimension"]},
        "user_acceleration": {},
        "drag": {"rate": 0.0} if integrator in FORWARD else None,
        "friction": {"strength": 0.0} if integrator == "leapfrog" else None,
        "mutual_gravity": {"G": 0.0} if not periodic else None,
    }.get(name)
    if name in ("restitution", "rough") and "collisions" in effects:
        given = {"restitution", "damping"} if name == "restitution" else {"friction", "tangential_restitution"}
        if given.isdisjoint(effects["collisions"]):
            other["effects"]["collisions"] |= {"restitution": 1.0} if name == "restitution" else {"friction": 0.0}
            return other
    if table is None or name in effects:
        return None
    other["effects"][name] = table
    return other


@parts
@settings(max_examples=25, phases=PHASES)
@given(
    seed=SEEDS,
    name=st.sampled_from(["uniform_gravity", "user_acceleration", "drag", "friction", "mutual_gravity", "restitution", "rough"]),
)
def test_zero_changes_nothing(part, seed, name):
    """To the bit for options of contacts; an effect of zero rounds velocities at contacts otherwise.

    Not compared: friction that is all there is, which stops exactly at its distance only then; and contacts that follow one
    another so often that energy is no longer taken, which under forces is earlier.
    """
    tables, _ = any_scene(seed)
    other = with_zero(tables, name)
    if other is None or ("friction" in tables["effects"] and len(tables["effects"].keys() - {"collisions", "walls"}) == 1):
        return
    if name in ("restitution", "rough"):
        assert_same_bits(tables, other)
    else:
        assert_same_physics(tables, other, SAME)


@parts
@settings(max_examples=10, phases=PHASES)
@given(seed=SEEDS, far=st.sampled_from([1e6, 1e12]))
def test_a_wall_very_far_away_changes_no_bit(part, seed, far):
    def fits(tables):
        walls = tables["effects"].get("walls")
        return tables["time"]["integrator"] in FORWARD and (walls is None or "planes" in walls)

    tables, rng = any_scene(seed, fits)
    normal = rng.standard_normal(tables["dimension"])
    normal /= np.sqrt((normal**2).sum())
    other, walls = copy.deepcopy(tables), tables["effects"].get("walls", {})
    if np.abs(np.concatenate([state[0]["position"] for state in states_of(tables)])).max() > 1e4:
        return
    plane = {"point": (-far * normal).tolist(), "normal": normal.tolist()}
    other["effects"]["walls"] = walls | {"planes": [*walls.get("planes", []), plane]}
    assert_same_bits(tables, other)


@parts
@settings(max_examples=8, phases=PHASES)
@given(seed=SEEDS, choice=st.integers(0, 99))
def test_switched_off_is_as_if_it_were_not_named(part, seed, choice, tmp_path_factory):
    """Frames, rows and the final state, to the bit; only columns of the effect are there."""
    tables, _ = any_scene(seed, lambda tables: tables["effects"])
    name = list(tables["effects"])[choice % len(tables["effects"])]
    off, without = copy.deepcopy(tables), copy.deepcopy(tables)
    off["effects"][name]["active"] = False
    del without["effects"][name]
    population = without["particles"][0]
    population.pop({"drag": "drag", "user_acceleration": "acceleration"}.get(name), None)
    turning = {column: population.pop(column) for column in ("spin", "moment_of_inertia") if column in population}
    try:
        population |= turning if Scene.from_dict(without).rough else {}
    except SceneError:  # as rolling without friction, which only the one that is switched off may have
        return
    folders, sims = tmp_path_factory.mktemp("off"), []
    for number, one in enumerate((off, without)):
        one["output"] = {"every": 5, "diagnostics_every": 3, "formats": ["hdf5"]}
        try:
            sims.append(Simulation(Scene.from_dict(one)))
        except SceneError:
            return
        sims[-1].run(folders / str(number))
    here, there = map(columns, sims)
    assert there.keys() <= here.keys()
    fields = there.keys() - {"contacted"}
    assert [field for field in fields if here[field].tobytes() != there[field].tobytes()] == [], (off, name)
    assert [sims[0].totals[count] for count in COUNTS] == [sims[1].totals[count] for count in COUNTS], (off, name)
    one, other = (Run(folders / str(number)) for number in range(2))
    assert len(one) == len(other) and one.times.tolist() == other.times.tolist()
    for k in range(len(one)):
        assert one[k].position.tobytes() == other[k].position.tobytes(), (off, name, k)
    assert one.diagnostics["kinetic"].tolist() == other.diagnostics["kinetic"].tolist()
    assert name not in [effect["effect"] for effect in json.loads((folders / "0" / "run.json").read_text())["plan"]["effects"]]


@parts
@settings(max_examples=10, phases=PHASES)
@given(seed=SEEDS)
def test_scenes_far_apart_do_not_influence_one_another(part, seed):
    """Where nothing lasts, crowds or is done again in order of time: those decisions are of the whole scene."""

    def alone(tables):
        tables = copy.deepcopy(tables)
        tables["effects"].pop("mutual_gravity", None)
        tables.pop("box", None)
        if "planes" not in tables["effects"].get("walls", {"planes": []}):
            del tables["effects"]["walls"]
        tables["effects"].get("rolling") and tables["effects"].pop("rolling")
        if not any("friction" in tables["effects"].get(contact, {}) for contact in ("collisions", "walls")):
            for population in tables["particles"]:
                population.pop("spin", None), population.pop("moment_of_inertia", None)
        return tables

    tables, _ = any_scene(seed, change=alone)
    if "walls" in tables["effects"] or keeps_contacts(tables):
        return
    far = copy.deepcopy(tables)
    far["particles"][0]["position"] = (np.array(tables["particles"][0]["position"]) + 500.0).tolist()
    population, there = tables["particles"][0], far["particles"][0]
    both = tables | {"particles": [{name: values + there[name] for name, values in population.items()}]}
    n = len(population["position"])
    for k, states in enumerate(zip(states_of(tables), states_of(far), states_of(both), strict=True)):
        (here, counts), (other, others), (union, all_counts) = states
        if max(all_counts) > 50:
            return
        for name in {"position", "velocity", "spin"} & here.keys():
            assert union[name][:n].tobytes() == here[name].tobytes(), (tables, k, name)
            assert union[name][n:].tobytes() == other[name].tobytes(), (tables, k, name)
        assert all_counts == [a + b for a, b in zip(counts, others, strict=True)]
