"""Scenes that a script makes and changes: what it keeps is its own, and what it changes is checked."""

import numpy as np
import pytest

from particles_mpi import Run, Scene, SceneError, Simulation

TABLES = dict(
    dimension=1,
    time={"step": 0.1, "steps": 20},
    particles=[{"position": [[0.0], [1.0]], "radius": 0.1}],
    effects={"collisions": {"restitution": 0.5}},
)


def scene():
    return Scene.from_dict(TABLES)


def test_lists_of_a_script_are_its_own():
    """Neither scenes nor simulations see what it writes into them later."""
    points, scenes = [[0.0], [1.0]], []
    for x in (3.0, 4.0, 5.0):
        points[1][0] = x
        scenes.append(Scene(**TABLES | {"particles": [{"position": points}]}))
    assert [one.particles[0].position[1][0] for one in scenes] == [3.0, 4.0, 5.0]
    sim = Simulation(scenes[0])
    scenes[0].particles[0].position[1][0] = -77.0
    assert sim.scene.particles[0].position == [[0.0], [3.0]]


CHANGES = {
    "effects.collisions.restitution: must be less than": lambda s: setattr(s.effects["collisions"], "restitution", 7.0),
    "effects.collisions.mode": lambda s: setattr(s.effects["collisions"], "mode", "evnt"),
    "time.step: must be greater than 0": lambda s: setattr(s.time, "step", -0.01),
    "time.step: must be a valid number": lambda s: setattr(s.time, "step", "a"),
    'time.integrator: "order4" goes back': lambda s: setattr(s.time, "integrator", "order4"),
    "time.steps: give either time.end or time.steps": lambda s: setattr(s.time, "end", 1.0),
    "particles\\[0\\].position\\[0\\]: 1 components in dimension 3": lambda s: setattr(s, "dimension", 3),
    "output.formats": lambda s: s.output.formats.append("hfd5"),
    "effects.drag.rate: must be": lambda s: s.effects.update(drag={"rate": -1.0}),
    "particles\\[1\\].position: missing": lambda s: s.particles.append({"positon": [[2.0]]}),
}


@pytest.mark.parametrize("fault", CHANGES)
def test_what_a_script_changes_in_a_scene_is_checked(fault):
    changed = scene()
    CHANGES[fault](changed)
    with pytest.raises(SceneError, match=fault):
        Simulation(changed)


def test_a_changed_scene_runs_and_is_read_back_as_it_was_changed(tmp_path):
    changed = scene()
    changed.time.steps, changed.effects["collisions"].restitution = 30, 0.25
    changed.particles.append({"position": [[2.0]], "radius": 0.1})
    changed.output.every = 15
    sim = Simulation(changed)
    sim.run(tmp_path / "o")
    assert sim.steps_done == 30 and len(sim.particles) == 3
    back = Run(tmp_path / "o").scene
    assert (
        back == sim.scene
        and back.time.steps == 30
        and back.effects["collisions"].restitution == 0.25
        and len(back.particles) == 2
    )
    assert Run(tmp_path / "o").times.tolist() == pytest.approx([0.0, 1.5, 3.0])
    assert Simulation.resume(tmp_path / "o" / "checkpoint.h5") == sim


def test_the_key_that_may_be_meant_is_named():
    tables = TABLES | {"particles": [{"positon": [[0.0]], "radius": 0.1}]}
    with pytest.raises(SceneError, match=r"^particles\[0\].position: missing \(got 'positon'\)$"):
        Scene.from_dict(tables)


def test_a_folder_may_be_text(tmp_path):
    (tmp_path / "start.csv").write_text("0.5\n")
    tables = TABLES | {"particles": [{"position": {"file": "start.csv"}}], "effects": {}}
    assert Simulation(Scene.from_dict(tables, str(tmp_path))).particles.position.tolist() == [[0.5]]


def test_steps_that_are_changed_are_those_of_the_default_between_frames():
    """All of a shorter run, also if the scene had more steps, or fewer, when it was made."""
    for first, then, every in ((20, 1000, 100), (1000, 50, 50)):
        changed = Scene.from_dict(TABLES | {"time": {"step": 0.1, "steps": first}})
        changed.time.steps = then
        assert Simulation(changed).scene.output.every == every


def test_what_numpy_gives_is_a_number_in_a_scene_too():
    changed = scene()
    changed.time.steps, changed.time.step = np.int64(7), np.float64(0.5)
    sim = Simulation(changed)
    assert sim.last_step == 7 and sim.h == 0.5


def test_a_scene_that_was_not_changed_is_not_checked_twice():
    one = scene()
    assert one.checked() is one
    one.output.every = 7
    assert one.checked().output.every == 7


def test_a_table_in_the_place_of_another_one_is_checked_wherever_it_is_kept():
    """Python may keep a new table where the old one was."""
    for _ in range(50):
        changed = scene()
        kind = type(changed.particles[0])
        changed.particles[0] = None
        changed.particles[0] = kind(position=[[0.0, 0.0]])
        with pytest.raises(SceneError, match="2 components in dimension 1"):
            Simulation(changed)
