"""What `run.json` tells of a run that was computed in parts, or with steps before it; and of which steps its seconds are."""

import json

import pytest

from particles_mpi import Scene, Simulation

COLLAPSE = {  # beads that hit one another ever faster
    "dimension": 1,
    "box": {"lower": [-3.0], "upper": [5.0]},
    "time": {"step": 0.05, "steps": 40},
    "particles": [{"position": [[0.0], [1.0], [1.3], [2.0]], "velocity": [[1.0], [0.0], [0.0], [-1.0]], "radius": 0.1}],
    "effects": {"collisions": {"mode": "event", "restitution": 0.05}, "walls": {"restitution": 0.05}},
}
GAS = {  # more contacts than can be put in order
    "dimension": 2,
    "box": {"lower": [0, 0], "upper": [4, 4]},
    "time": {"step": 0.1, "steps": 40},
    "particles": [{"count": 60, "position": "random", "velocity": {"speed": 3.0}, "radius": 0.2}],
    "effects": {"collisions": {"passes": 1}, "walls": {}},
}


def told(folder):
    return json.loads((folder / "run.json").read_text())


@pytest.mark.parametrize("tables", [COLLAPSE, GAS], ids=["collapse", "gas"])
def test_what_is_told_at_the_end_is_of_the_whole_run(tables, tmp_path):
    scene = Scene.from_dict(tables)
    Simulation(scene).run(tmp_path / "whole")
    Simulation(scene).run(tmp_path / "parts", steps=20)
    before = told(tmp_path / "parts")
    for steps in (30, 40):
        Simulation.resume(tmp_path / "parts" / "checkpoint.h5").run(tmp_path / "parts", steps=steps)
    whole, parts = told(tmp_path / "whole"), told(tmp_path / "parts")
    assert {name: parts["counts"][name] for name in ("steps", "collisions", "wall_hits", "missed")} == {
        name: whole["counts"][name] for name in ("steps", "collisions", "wall_hits", "missed")
    }
    assert parts["plan"]["effects"] == whole["plan"]["effects"]  # with how often each was called
    assert before["remarks"] and parts["remarks"] == whole["remarks"]  # counts, times and particles of the whole
    assert (whole["timed_from"], parts["timed_from"]) == (0, 30)


def test_seconds_of_phases_are_those_of_the_loop(tmp_path):
    """Whatever was computed before; together they are the loop."""
    sim = Simulation(Scene.from_dict(GAS))
    sim.steps(30)
    for last in (35, 40):
        sim.run(tmp_path, steps=last)
        about = told(tmp_path)
        phases = {name: part["mean"] for name, part in about["timers"].items() if name not in ("setup", "loop")}
        assert about["timed_from"] == last - 5 and min(phases.values()) >= 0.0
        assert sum(phases.values()) == pytest.approx(about["timers"]["loop"]["mean"])
