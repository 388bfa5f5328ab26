"""What the plan says of a scene that is valid and will surprise."""

import json

import pytest
from conftest import ROOT

from particles_mpi import Scene, Simulation
from particles_mpi.initial.populate import populate
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.scene.plan import advice, duration, plan

FLOOR = {"point": [0.0, 0.0], "normal": [0.0, 1.0]}


@pytest.mark.parametrize(
    "planes, restitution, integrator, words",
    [([FLOOR], 0.5, "leapfrog", []), ([FLOOR], 1.0, "taylor", []), ([FLOOR], 0.5, "taylor", ["never come to rest on anything"])],
)
def test_advice(planes, restitution, integrator, words):
    scene = Scene(
        dimension=2,
        box={"lower": [0, 0], "upper": [4, 4], "periodic": [True, False]},
        time={"step": 0.01, "steps": 1, "integrator": integrator},
        particles=[{"position": [[1.0, 2.0]], "radius": 0.1}],
        effects={"walls": {"planes": planes, "restitution": restitution}, "uniform_gravity": {"acceleration": [0.0, -1.0]}},
    )
    lines = advice(scene, populate(scene)[0], Communicator.alone())
    assert len(lines) == len(words) and all(word in line for word, line in zip(words, lines))


@pytest.mark.parametrize(
    "seconds, words",
    [(0.0, "0.01 s"), (1.25, "1.2 s"), (119.0, "119 s"), (7200.0, "2.0 h"), (3e5, "3 days"), (7.9e9, "250 years")],
)
def test_seconds_for_people(seconds, words):
    assert duration(seconds) == words


def test_that_there_is_no_vtk_in_four_dimensions_is_said():
    tables = {
        "dimension": 4,
        "time": {"step": 0.01, "steps": 1},
        "particles": [{"position": [[1.0, 2.0, 0.0, 0.0]], "radius": 0.1}],
    }
    told = plan(scene := Scene.from_dict(tables), populate(scene)[0], Communicator.alone(), 1)
    assert told["advice"] == [
        "output.formats: only hdf5 is written, which has all axes of positions and velocities; vtk has three"
    ]


def test_what_is_switched_off_does_not_run():
    tables = {"dimension": 2, "time": {"step": 0.01, "steps": 1}, "particles": [{"position": [[1.0, 2.0]], "radius": 0.1}]}
    effects = {"collisions": {"active": False}, "uniform_gravity": {"acceleration": [0.0, -1.0]}}
    scene = Scene.from_dict(tables | {"effects": effects})
    told = plan(scene, populate(scene)[0], Communicator.alone(), scene.steps)
    assert [row["effect"] for row in told["effects"]] == ["uniform_gravity"] and not told["advice"]
    assert "collisions" in told["not_run"] and "uniform_gravity" not in told["not_run"]
    without = Scene.from_dict(tables | {"effects": {"uniform_gravity": effects["uniform_gravity"]}})
    assert told == plan(without, populate(without)[0], Communicator.alone(), scene.steps)


def test_a_plane_across_a_periodic_axis_is_told():
    tables = {
        "box": {"lower": [0, 0], "upper": [4, 4], "periodic": [True, False]},
        "particles": [{"position": [[1.0, 2.0]], "radius": 0.1}],
        "effects": {"walls": {"planes": [FLOOR, {"point": [0.0, 0.0], "normal": [0.2, 1.0]}]}},
    }
    _, warnings = populate(Scene(dimension=2, time={"step": 0.01, "steps": 1}, **tables))
    assert [line.partition(":")[0] for line in warnings] == ["effects.walls.planes[1].normal"]


@pytest.mark.parametrize(
    ("periodic", "effects", "words"),
    [
        ([True, False], {"collisions": {}}, "may leave it along axis 1: there is no [effects.walls]"),
        (False, {"collisions": {}}, "may leave it along axes 0 and 1: there is no [effects.walls]"),
        (False, {"collisions": {}, "walls": {}}, ""),
        (True, {"collisions": {}}, ""),
        (True, {"collisions": {}, "walls": {}}, "there is no wall"),
    ],
)
def test_a_box_without_walls_is_open(periodic, effects, words):
    box, particles = {"lower": [0, 0], "upper": [4, 4], "periodic": periodic}, [{"position": [[1.0, 2.0]], "radius": 0.1}]
    scene = Scene(dimension=2, box=box, time={"step": 0.01, "steps": 1}, particles=particles, effects=effects)
    lines = advice(scene, populate(scene)[0], Communicator.alone())
    assert len(lines) == bool(words) and all(words in line for line in lines)


@pytest.mark.parametrize(
    ("name", "steps"), [("marbles", 100), ("gas_periodic", 200), ("silo", 40), ("bounce", 300), ("solar_system", 900)]
)
@pytest.mark.parametrize("formats", [["hdf5"], ["vtk"], ["hdf5", "vtk"]])
def test_as_much_is_written_as_the_plan_says(tmp_path, name, steps, formats):
    """Of a run that ends earlier than its scene, too. Contacts that last are in the checkpoint, and not in the plan."""
    scene = Scene.load(ROOT / f"particles_mpi/scenes/{name}.toml").to_dict()
    scene["output"]["formats"] = formats
    Simulation(Scene.from_dict(scene)).run(tmp_path, steps=steps)
    told = json.loads((tmp_path / "run.json").read_text())["plan"]
    data = [tmp_path / "trajectory.vtkhdf", tmp_path / "checkpoint.h5", tmp_path / "diagnostics.csv", *tmp_path.glob("vtk/*")]
    written = sum(path.stat().st_size for path in data if path.exists())
    assert told["steps"] == steps and told["frames"] == steps // scene["output"]["every"] + 1
    assert told["output_bytes"] == pytest.approx(written, rel=0.15, abs=30_000)


@pytest.mark.parametrize(
    ("effects", "told"), [({"mutual_gravity": {}}, True), ({"uniform_gravity": {"acceleration": [0.0, 1.0]}}, False)]
)
def test_taylor_is_of_first_order_where_forces_depend_on_the_place(effects, told):
    scene = Scene(
        dimension=2,
        time={"step": 0.01, "steps": 1, "integrator": "taylor"},
        particles=[{"position": [[1.0, 2.0], [2.0, 2.0]], "mass": 1.0}],
        effects=effects,
    )
    lines = advice(scene, populate(scene)[0], Communicator.alone())
    assert any("first order with forces that depend on position" in line for line in lines) == told
