"""Scene files: what is accepted, and that everything else is a SceneError that names the key."""

import numpy as np
import pytest
from conftest import ROOT
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from particles_mpi import Simulation
from particles_mpi.errors import SceneError
from particles_mpi.initial.populate import populate
from particles_mpi.scene.schema import Scene

SCENES = sorted((ROOT / "particles_mpi" / "scenes").glob("*.toml"))


def tables(**changes):
    """A small valid scene; a change to None removes the table."""
    base = {
        "dimension": 2,
        "box": {"lower": [0, 0], "upper": [1, 1]},
        "time": {"step": 0.01, "steps": 3},
        "particles": [{"count": 3, "position": "random", "radius": 0.1, "velocity": {"speed": 0.5}}],
        "effects": {"collisions": {}, "walls": {}},
    }
    base.update(changes)
    return {key: value for key, value in base.items() if value is not None}


def faults(given_tables):
    with pytest.raises(SceneError) as caught:
        populate(Scene.from_dict(given_tables))
    assert all("\n" not in fault for fault in caught.value.faults)
    return "\n".join(caught.value.faults)


def test_there_are_scenes():
    names = {path.stem for path in SCENES}
    assert names >= {"marbles", "pool_break", "bounce", "gas_periodic", "billiard_3d_fixed", "headline", "pbphys_drag"}


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_shipped_scene_starts_without_a_word(path):
    particles, warnings = populate(Scene.load(path))
    assert len(particles) and not warnings


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_scene_survives_its_own_tables(path):
    scene = Scene.load(path)
    again = Scene.from_dict(scene.to_dict())
    assert again.to_dict() == scene.to_dict()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"output": {"observables": ["foo"]}}, ["output.observables", "must be true or false"]),
        ({"dimensions": 2}, ["dimensions", "did you mean 'dimension'"]),
        ({"effects": {"gravity": {}}}, ["effects.gravity", "did you mean 'mutual_gravity' or 'uniform_gravity'?"]),
        ({"effects": {"uniform_gravity": {"acceleration": -9.81}}}, ["effects.uniform_gravity.acceleration: must be a list"]),
        ({"dimension": None}, ["dimension: missing"]),
        ({"dimension": 0}, ["dimension"]),
        ({"dimension": 1001}, ["dimension: must be less than or equal to 1000"]),
        ({"time": {"step": 1e101, "steps": 3}}, ["time.step: 1e+101 is not a number between -1e+100 and 1e+100"]),
        ({"effects": {"drag": {"rate": 1e101}}}, ["effects.drag.rate: 1e+101 is not a number between"]),
        ({"effects": {"uniform_gravity": {"acceleration": [0.0, -1e101]}}}, ["effects.uniform_gravity.acceleration: -1e+101 is"]),
        ({"dimension": "2"}, ["dimension"]),
        ({"dimension": 3}, ["box.lower", "box.upper"]),
        ({"box": {"lower": [0, 1], "upper": [1, 1]}}, ["box.upper", "axis 1"]),
        ({"box": {"lower": [0, 0], "upper": [1, 1], "periodic": [True]}}, ["box.periodic"]),
        ({"box": None}, ["particles[0].position", "effects.walls.planes"]),
        ({"time": {"step": 0.0, "steps": 1}}, ["time.step"]),
        ({"time": {"step": float("nan"), "steps": 1}}, ["time.step"]),
        ({"time": {"step": 0.1}}, ["time.end", "time.steps"]),
        ({"time": {"step": 0.1, "end": 1.0, "steps": 1}}, ["time.end", "time.steps"]),
        ({"effects": {"gravity": {}}}, ["effects.gravity", "unknown effect"]),
        ({"effects": {"collisions": {"restitution": 2.0}}}, ["effects.collisions.restitution"]),
        ({"effects": {"collisions": {"restitution": 0.5, "damping": 0.5}}}, ["effects.collisions.restitution", "not both"]),
        ({"effects": {"collisions": {"passes": 0}}}, ["effects.collisions.passes"]),
        ({"effects": {"uniform_gravity": {"acceleration": [1]}}}, ["effects.uniform_gravity.acceleration"]),
        ({"effects": {"friction": {}}}, ["effects.friction.strength: missing"]),
        ({"effects": {"collisions": {"friction": -1}}}, ["effects.collisions.friction", "greater than or equal to 0 (got -1)"]),
        ({"effects": {"collisions": {"frction": 0.5}}}, ["effects.collisions.frction", "did you mean 'friction'"]),
        ({"effects": {"collisions": {"tangential_restitution": 2}}}, ["collisions.tangential_restitution", "equal to 1 (got 2)"]),
        ({"effects": {"collisions": {"friction": 0.5, "damping": 0.1}}}, ["effects.collisions.friction", "give restitution"]),
        ({"effects": {"walls": {"planes": [{"point": [0, 0], "normal": [0, 1], "friction": -1}]}}}, ["walls.planes[0].friction"]),
        ({"effects": {"rolling": {"resistance": 0.01}}}, ["effects.rolling.resistance", "only with friction"]),
        ({"effects": {"collisions": {"friction": 0.5}, "rolling": {}}}, ["effects.rolling.resistance: missing"]),
        ({"particles": [{"position": [[0.5, 0.5]], "spin": 1.0}]}, ["particles[0].spin", "only with friction"]),
        ({"particles": [{"position": [[0.5, 0.5]], "moment_of_inertia": 1.0}]}, ["particles[0].moment_of_inertia", "friction"]),
        ({"particles": [{"position": "random"}]}, ["particles[0].count"]),
        ({"particles": [{"position": "somewhere", "count": 1}]}, ["particles[0].position"]),
        ({"particles": [{"position": [[0.5]]}]}, ["particles[0].position[0]"]),
        ({"particles": [{"position": [[0.5, 0.5]], "velocity": {"speed": -1}}]}, ["particles[0].velocity"]),
        ({"particles": [{"position": [[0.5, 0.5]], "mass": {"min": 2, "max": 1}}]}, ["particles[0].mass"]),
        ({"particles": [{"position": [[0.5, 0.5]], "drag": 1.0}]}, ["particles[0].drag", "effects.drag"]),
        ({"particles": [{"position": [[0.5, 0.5]], "acceleration": [0, 1]}]}, ["particles[0].acceleration"]),
        ({"output": {"every": 0}}, ["output.every"]),
        ({"output": {"formats": ["png"]}}, ["output.formats"]),
        ({"output": {"formats": ["vtk", "vtk"]}}, ["output.formats"]),
        ({"seed": -1}, ["seed"]),
        ({"seed": 2**64}, ["seed"]),
        ({"folder": "/tmp"}, ["folder"]),
    ],
)
def test_a_fault_names_its_key(changes, words):
    told = faults(tables(**changes))
    assert all(word in told for word in words), told


@pytest.mark.parametrize("dimension", [1, 4])
def test_friction_is_for_two_and_three_dimensions(dimension):
    box = {"lower": [0] * dimension, "upper": [1] * dimension}
    told = faults(tables(dimension=dimension, box=box, effects={"collisions": {"friction": 0.5}}))
    assert told == f"effects.collisions.friction: rough spheres need dimension 2 or 3, not {dimension}"


@pytest.mark.parametrize(
    ("dimension", "given", "words"),
    [
        (2, [1.0, 2.0, 3.0], "3 entries, but position has 1"),
        (3, 1.0, "must be a vector [sx, sy, sz]"),
        (3, [1.0, 2.0], "2 components in dimension 3"),
        (3, {"temperature": -1.0}, "with T >= 0"),
    ],
)
def test_spins_have_one_component_in_the_plane_and_three_in_space(dimension, given, words):
    box = {"lower": [0] * dimension, "upper": [1] * dimension}
    turning = [{"position": [[0.5] * dimension], "radius": 0.1, "spin": given}]
    told = faults(tables(dimension=dimension, box=box, particles=turning, effects={"collisions": {"friction": 0.5}}))
    assert told.startswith("particles[0].spin: ") and words in told and "\n" not in told


def test_faults_name_the_file(tmp_path):
    for name, text in (("a.toml", "dimension = "), ("b.toml", "dimension = 2"), ("c.toml", "\udcff")):
        (tmp_path / name).write_bytes(text.encode("utf-8", "surrogateescape"))
        with pytest.raises(SceneError, match=name):
            Scene.load(tmp_path / name)
    with pytest.raises(SceneError, match="cannot be read"):
        Scene.load(tmp_path / "none.toml")


numbers = st.integers(-3, 5) | st.floats(width=32) | st.sampled_from([0.0, 1e-300, 1e300, 2**70])
words = st.sampled_from(["random", "lattice", "rewind", "event", "taylor", "hdf5", "", "none.csv", "min", "x"]) | st.text(
    max_size=3
)
values = st.recursive(
    st.none() | st.booleans() | numbers | words,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["min", "max", "speed", "temperature", "file", "point", "normal"]), inner, max_size=2)
    ),
    max_leaves=6,
)
likely = {
    "box": {"lower": [0, 0], "upper": [2, 3], "periodic": [True, False]},
    "time": {"step": 0.01, "steps": 3},
    "effects": {"collisions": {"allow_overlap": True}, "walls": {}, "drag": {}, "user_acceleration": {}},
    "particles": [{"count": 3, "position": "random", "radius": 0.1}, {"count": 2, "position": "lattice", "radius": 0.2}],
}


def table(*keys):
    return st.dictionaries(st.sampled_from(keys) | st.text(max_size=2), values, max_size=4)


population = st.dictionaries(
    st.sampled_from(["count", "position", "velocity", "radius", "mass", "fixed", "drag", "acceleration"]), values, max_size=5
)
effect = table("restitution", "damping", "rate", "strength", "acceleration", "mode", "passes", "planes", "allow_overlap")
names = st.sampled_from(["collisions", "walls", "drag", "friction", "uniform_gravity", "user_acceleration", "mutual_gravity"])
garbage = st.fixed_dictionaries(
    {"dimension": st.just(2) | st.integers(-1, 4)},
    optional={
        "box": st.just(likely["box"]) | table("lower", "upper", "periodic") | values,
        "time": st.just(likely["time"]) | table("step", "end", "steps", "integrator") | values,
        "particles": st.just(likely["particles"]) | st.lists(population, max_size=3) | values,
        "effects": st.just(likely["effects"]) | st.dictionaries(names, effect, max_size=3) | values,
        "output": table("every", "formats") | values,
        "seed": values,
        "G": values,
    },
)


@settings(max_examples=300, suppress_health_check=list(HealthCheck))
@given(garbage)
def test_garbage_is_a_scene_error_and_nothing_else(given_tables):
    try:
        populate(Scene.from_dict(given_tables))
    except SceneError as error:
        assert error.faults and all(fault.strip() for fault in error.faults)


def test_arrays_and_tuples_are_as_good_as_lists():
    """At any depth, in any table."""
    tables = {"dimension": 2, "time": {"step": 0.1, "steps": 3}, "box": {"lower": [0.0, 0.0], "upper": [2.0, 2.0]}}
    particles = {"position": [[0.5, 0.5], [1.5, 1.5]], "velocity": [1.0, 0.0], "mass": [1.0, 2.0]}
    effects = {"uniform_gravity": {"acceleration": [0.0, -1.0]}}
    wanted = Scene(**tables, particles=[particles], effects=effects)
    arrays = {name: np.array(value) for name, value in particles.items()}
    tuples = {"position": [(0.5, 0.5), np.array([1.5, 1.5])], "velocity": (1.0, np.float64(0.0)), "mass": (1.0, 2.0)}
    others = {"time": {"step": np.float64(0.1), "steps": np.int64(3)}, "box": {"lower": (0.0, 0.0), "upper": np.full(2, 2.0)}}
    for one in (arrays, tuples):
        scene = Scene(**tables | others, particles=(one,), effects={"uniform_gravity": {"acceleration": np.array([0.0, -1.0])}})
        assert scene == wanted and scene.to_dict() == wanted.to_dict()


def test_a_scene_is_the_same_wherever_it_is_from(tmp_path):
    text = "dimension = 1\ntime = {step = 0.1, steps = 1}\nparticles = [{position = [[0.0]]}]\n"
    (tmp_path / "a.toml").write_text(text)
    scene = Scene.load(tmp_path / "a.toml")
    assert scene == Scene(dimension=1, time={"step": 0.1, "steps": 1}, particles=[{"position": [[0.0]]}])
    assert scene != Scene(dimension=1, time={"step": 0.2, "steps": 1}, particles=[{"position": [[0.0]]}])
    sim = Simulation(scene)
    sim.to_json(tmp_path / "a.json")
    sim.run(tmp_path / "out", steps=0)
    assert Simulation.from_json(tmp_path / "a.json") == sim == Simulation.resume(tmp_path / "out" / "checkpoint.h5")


def test_files_of_vtk_have_three_axes():
    """In more dimensions they are left out where there are others, and refused where they are all."""
    tables = {"dimension": 4, "time": {"step": 0.1, "steps": 1}, "particles": [{"position": [[0.0] * 4]}]}
    assert Scene(**tables).output.formats == ["hdf5"]
    with pytest.raises(SceneError, match=r'output\.formats: .*use "hdf5"'):
        Scene(**tables, output={"formats": ["vtk"]})


@pytest.mark.parametrize(("steps", "output", "every"), [(30, {}, 30), (30, {"every": 100}, 100), (300, {}, 100), (0, {}, 100)])
def test_a_short_run_writes_its_end_unless_it_is_told_how_often(steps, output, every):
    tables = {"dimension": 1, "particles": [{"position": [[0.0]]}], "output": output}
    scene = Scene.from_dict(tables | {"time": {"step": 0.1, "steps": steps}})
    assert scene.output.every == every and Scene.from_dict(scene.to_dict()) == scene
    assert Scene.from_dict(tables | {"time": {"step": 0.1, "end": 0.1 * steps}}).output.every == every


def test_a_mark_of_byte_order_does_not_matter(tmp_path):
    """Some editors begin a text with one."""
    text = "dimension = 1\nparticles = [{position = [[0.0]]}]\n[time]\nstep = 0.1\nsteps = 1\n"
    for name, encoding in (("a.toml", "utf-8"), ("b.toml", "utf-8-sig")):
        (tmp_path / name).write_text(text, encoding=encoding)
    assert Scene.load(tmp_path / "a.toml") == Scene.load(tmp_path / "b.toml")
