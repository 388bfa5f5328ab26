"""A scene at random that is written and read again, by any way, starts and goes on with the same bits; so does a changed one."""

import copy
import json

import numpy as np
import pytest
from any_scene import any_scene, columns
from hypothesis import Phase, given, reject, settings
from hypothesis import strategies as st
from random_scenes import random_tables
from with_all import with_search

from particles_mpi import Run, Scene, SceneError, Simulation, StoppedError

SEEDS = st.integers(0, 2**32 - 1)
PHASES = (Phase.reuse, Phase.generate)  # a smaller seed is no smaller scene
parts = pytest.mark.parametrize("part", [0, *with_search(*range(1, 9))])


def scene_with_more(seed):
    """A valid scene at random with more of the keys that a scene may have, and particles that the program places."""
    rng = np.random.default_rng(seed)

    def chance(share):
        return rng.random() < share

    while True:
        tables = random_tables(rng)
        effects, time, d = tables["effects"], tables["time"], tables["dimension"]
        if d > 3:
            continue
        tables |= {"title": str(rng.choice(["", 'ä "q" \\', "two\nlines"])), "G": float(rng.choice([0.0, 1e-300, 0.1]))}
        time["steps"] = min(time["steps"], 12)
        if chance(0.5):
            time["end"] = time.pop("steps") * time["step"] * float(rng.choice([1.0, 1.0001, 0.997]))
        if time["integrator"] == "adaptive":
            time["tolerance"] = 1e-5
        output = tables.setdefault("output", {})
        output |= {"every": int(rng.integers(1, 9)), "diagnostics_every": int(rng.integers(1, 7)), "formats": ["hdf5"]}
        if any("friction" in effects.get(name, {}) for name in ("collisions", "walls")) and chance(0.5):
            output["orientation"] = True
        if effects and chance(0.3):
            effects[str(rng.choice(list(effects)))]["active"] = False
        if "collisions" in effects and chance(0.3):
            effects["collisions"] |= {"allow_overlap": True, "contact_tolerance": 1e-3}
        if "mutual_gravity" in effects and chance(0.3):
            effects["mutual_gravity"] |= {"method": "tree", "opening_angle": 0.6, "multipole": "monopole"}
        first = tables["particles"][0]
        if "box" in tables and chance(0.4) and not isinstance(first.get("fixed"), list):
            first |= {"count": len(first["position"]), "position": str(rng.choice(["random", "lattice"]))}
        if d == 3 and "box" not in tables and chance(0.4):
            equilibrium = "equilibrium" if "mutual_gravity" in effects else [0.0] * 3
            tables["particles"].append({"count": 20, "position": {"plummer": 1.5}, "velocity": equilibrium, "mass": 0.1})
        try:
            Simulation(Scene.from_dict(copy.deepcopy(tables))).steps(6)
        except (SceneError, StoppedError):
            continue
        return tables, rng


def as_toml(tables):
    """The text of a scene file."""

    def of(value):
        if isinstance(value, dict):
            return "{" + ", ".join(f"{json.dumps(key)} = {of(part)}" for key, part in value.items()) + "}"
        if isinstance(value, list):
            return "[" + ", ".join(map(of, value)) + "]"
        return json.dumps(value) if isinstance(value, str | bool) else repr(value)

    return "\n".join(f"{key} = {of(value)}" for key, value in tables.items()) + "\n"


@parts
@settings(max_examples=6, phases=PHASES)
@given(seed=SEEDS)
def test_what_is_written_is_read_with_the_same_bits(part, seed, tmp_path_factory):
    """As tables, as a scene file, by a run, as a checkpoint, as JSON; three more steps of each are the same."""
    folder = tmp_path_factory.mktemp("written")
    tables, rng = scene_with_more(seed)
    scene = Scene.from_dict(copy.deepcopy(tables))
    first, steps = Simulation(scene), int(rng.integers(4))
    sim = Simulation(scene)
    sim.run(folder / "run", steps=min(steps, sim.last_step))
    texts = {"given": as_toml(tables), "shown": as_toml(scene.to_dict())}
    for name, text in texts.items():
        (folder / f"{name}.toml").write_text(text)
    scenes = {name: Scene.load(folder / f"{name}.toml") for name in texts}
    scenes["tables"] = Scene.from_dict(json.loads(json.dumps(scene.to_dict())))
    scenes["run.json"] = Scene.from_dict(json.loads((folder / "run" / "run.json").read_text())["scene"])
    scenes["Run"] = Run(folder / "run").scene
    for name, other in scenes.items():
        again = Simulation(other)
        assert other == scene and again == first and again.last_step == first.last_step, (tables, name)
        assert again.warnings == first.warnings, (tables, name)
    sim.to_json(folder / "state.json")
    sims = {"resumed": Simulation.resume(folder / "run" / "checkpoint.h5"), "JSON": Simulation.from_json(folder / "state.json")}
    for _ in range(3):
        for one in (sim, *sims.values()):
            one.step()
        for name, other in sims.items():
            assert other == sim and other.totals == sim.totals, (tables, name)


@parts
@settings(max_examples=10, phases=PHASES)
@given(seed=SEEDS)
def test_a_start_in_a_csv_has_the_bits_of_lists(part, seed, tmp_path_factory):
    """Every column that a scene has, in any order."""
    folder = tmp_path_factory.mktemp("start")
    tables, rng = any_scene(seed)
    (population,), d = tables["particles"], tables["dimension"]
    cells = {}
    for name, values in population.items():
        array, axes = np.array(values), "xyz"[: np.shape(values)[-1]]
        names = {"position": axes, "velocity": [f"v{axis}" for axis in axes]}.get(name, [f"{name}_{axis}" for axis in axes])
        cells |= {name: array} if array.ndim == 1 else dict(zip(names, array.T, strict=True))
    order = rng.permutation(len(cells))
    names = [list(cells)[k] for k in order]
    rows = [",".join(repr(float(cells[name][i])) for name in names) for i in range(len(population["mass"]))]
    (folder / "start.csv").write_text("\n".join([",".join(names), *rows]) + "\n")
    other = tables | {"particles": [{"position": {"file": "start.csv"}}]}
    here, there = columns(Simulation(Scene.from_dict(tables))), columns(Simulation(Scene.from_dict(other, folder)))
    assert here.keys() == there.keys()
    assert [name for name in here if here[name].tobytes() != there[name].tobytes()] == [], (tables, d)


def changed(sim, tables, rng):
    """Change fields of particles and options at random, in a simulation and in the tables of its scene."""
    particles, (population,), fields = sim.particles, tables["particles"], columns(sim)
    fixed = fields["fixed"] != 0
    n = len(fixed)
    values = {
        "velocity": np.where(fixed[:, None], 0.0, 0.7 * fields["velocity"] + 0.1),
        "radius": 0.8 * fields["radius"],
        "mass": fields["mass"] * rng.choice([0.5, 2.0, 3.3], n),
        "drag": rng.random(n),
        "acceleration": rng.standard_normal(fields["position"].shape),
    }
    if "spin" in fields:
        values["spin"] = np.where(fixed[:, None], 0.0, rng.standard_normal(fields["spin"].shape))
    for name in sorted(values.keys() & population.keys()):
        if rng.random() < 0.4:
            particles[name] = values[name]
            population[name] = (values[name][:, 0] if name == "spin" and tables["dimension"] == 2 else values[name]).tolist()
    if "spin" in fields:
        sim.take_changes()  # moments of inertia follow masses and radii
        population["moment_of_inertia"] = columns(sim)["moment_of_inertia"].tolist()
    if rng.random() < 0.3:
        sim.h = tables["time"]["step"] = 0.6 * tables["time"]["step"]
    options = {
        "uniform_gravity": ("acceleration", rng.standard_normal(tables["dimension"]).tolist()),
        "mutual_gravity": ("G", 0.02),
        "friction": ("strength", 0.2),
        "drag": ("active", False),
        "collisions": ("active", False),
        "walls": ("restitution", 0.4),
    }
    for name, (key, value) in options.items():
        if name in tables["effects"] and "damping" not in tables["effects"][name] and rng.random() < 0.4:
            setattr(sim.effects[name], key, value)
            tables["effects"][name][key] = value


@parts
@settings(max_examples=6, phases=PHASES)
@given(seed=SEEDS)
def test_what_is_changed_before_a_run_is_as_if_it_had_been_started_so(part, seed, tmp_path_factory):
    """Frames, rows, the final state, and what is resumed from the checkpoint."""
    folder = tmp_path_factory.mktemp("changed")
    tables, rng = any_scene(seed)
    tables["output"] = {"every": 4, "diagnostics_every": 3, "formats": ["hdf5"]}
    sim, other = Simulation(Scene.from_dict(tables)), copy.deepcopy(tables)
    changed(sim, other, rng)
    try:
        started = Simulation(Scene.from_dict(other))
    except SceneError as refused:  # spheres that are smaller now, and faster; a run that goes on with them tells of it
        assert "cross more than their diameter in a step" in str(refused)
        reject()
    sims = {"changed": sim, "started": started}
    try:
        for name, one in sims.items():
            one.run(folder / name)
    except StoppedError:
        return
    runs = [Run(folder / name) for name in sims]
    assert runs[0].times.tolist() == runs[1].times.tolist()
    for one, two in zip(*runs, strict=True):
        assert one.position.tobytes() == two.position.tobytes() and one.velocity.tobytes() == two.velocity.tobytes(), other
    assert runs[0].diagnostics.to_csv() == runs[1].diagnostics.to_csv(), other
    resumed = [Simulation.resume(folder / name / "checkpoint.h5") for name in sims]
    assert resumed[0] == sim and resumed[0].scene.to_dict()["effects"] == resumed[1].scene.to_dict()["effects"]
    ends = []
    for one in (*sims.values(), *resumed):
        one.steps(2)
        ends.append(columns(one))
    for end in ends[1:]:
        assert [name for name in end if name != "contacted" and end[name].tobytes() != ends[0][name].tobytes()] == [], other
