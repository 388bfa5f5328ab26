"""Runs that a script starts, goes on with, copies, or shows: what it asks for is done, or refused in one line."""

import copy
import json
import pickle
import threading

import h5py
import numpy as np
import pytest

from particles_mpi import Run, Scene, SceneError, Simulation
from particles_mpi.study.recommend.runs import variant

HEAD = {"dimension": 1, "time": {"step": 0.1, "steps": 40}, "output": {"every": 10, "checkpoint_every": 10}}


def simulation():
    return Simulation(Scene(**HEAD, particles=[{"position": [[0.0]], "velocity": [1.0]}]))


@pytest.mark.parametrize("option", [{"steps": 0.3 / 0.1}, {"steps": -5}, {"steps": "3"}, {"wall_time": "00:00:10"}])
def test_options_that_are_no_numbers_are_refused_and_nothing_is_written(option, tmp_path):
    sim = simulation()
    with pytest.raises(ValueError, match=f"run: {next(iter(option))}: .* is not a number of (steps|seconds)"):
        sim.run(tmp_path / "o", **option)
    assert not (tmp_path / "o").exists() and sim.steps_done == 0


def test_an_option_that_there_is_not_is_named_with_those_that_there_are(tmp_path):
    for folder in (tmp_path / "o", None):
        with pytest.raises(TypeError, match="run: every: not one of its options, quiet, overwrite, resumed, steps, wall_time"):
            simulation().run(folder, every=2)
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize("every", [0, -3, 2.5])
def test_frames_of_a_view_come_every_whole_number_of_steps(every):
    with pytest.raises(ValueError, match="view: every"):
        simulation().view(every=every)


def test_a_run_goes_on_from_its_checkpoint_in_its_own_folder_and_in_no_other(tmp_path):
    simulation().run(tmp_path / "o", steps=20)
    simulation().run(tmp_path / "other", steps=20)
    Simulation.resume(tmp_path / "o" / "checkpoint.h5").run(tmp_path / "o")
    run = Run(tmp_path / "o")
    assert run.times.tolist() == pytest.approx([0.0, 1.0, 2.0, 3.0, 4.0]) and run.ended
    resumed = Simulation.resume(tmp_path / "o" / "checkpoint.h5")
    resumed.h = 0.05
    with pytest.raises(SceneError, match="already holds a run"):
        resumed.run(tmp_path / "other")


def test_a_simulation_does_not_go_on_in_a_folder_where_another_one_has(tmp_path):
    simulation().run(tmp_path / "o", steps=20)
    late = Simulation.resume(tmp_path / "o" / "checkpoint.h5")
    Simulation.resume(tmp_path / "o" / "checkpoint.h5").run(tmp_path / "o")
    with pytest.raises(SceneError, match="already holds a run"):
        late.run(tmp_path / "o", steps=30)
    assert len(Run(tmp_path / "o")) == 5


def test_a_run_that_was_stopped_has_not_ended(tmp_path):
    sim = simulation()
    with pytest.raises(Exception, match="stopped at step"):
        sim.run(tmp_path / "o", wall_time=0.0)
    assert not Run(tmp_path / "o").ended and Run(tmp_path / "o").about["counts"]["steps"] < 40
    ended = []
    step = sim.step
    sim.step = lambda: (ended.append(Run(tmp_path / "o").ended), step())
    sim.run(tmp_path / "o")
    assert ended and not any(ended) and Run(tmp_path / "o").ended


def test_every_copy_is_a_simulation_of_its_own():
    sim = simulation()
    sim.steps(3)
    for other in (sim.copy(), copy.copy(sim), copy.deepcopy(sim)):
        assert other == sim
        other.steps(4)
        assert other.steps_done == 7 and sim.steps_done == 3 and sim.particles.position[0, 0] == pytest.approx(0.3)
    with pytest.raises(TypeError, match="to_json"):
        pickle.dumps(sim)


def test_a_thread_may_run_into_a_folder(tmp_path):
    sim = simulation()
    thread = threading.Thread(target=lambda: sim.run(tmp_path / "o"))
    thread.start()
    thread.join(60)
    assert sim.steps_done == 40 and Run(tmp_path / "o").ended


def test_data_attached_again_leaves_no_array_that_can_be_written_to():
    sim = simulation()
    sim.attach("charge", np.array([1.0]))
    before = sim.particles.charge
    sim.attach("charge", np.array([2.0]))
    with pytest.raises(ValueError, match="read-only"):
        before[0] = 9.0


def test_particles_to_be_added_come_by_name():
    with pytest.raises(TypeError, match="add: takes a dict with the keys of one"):
        simulation().add([{"position": [[3.0]]}])


def test_what_a_run_does_not_have_is_told_by_name(tmp_path):
    simulation().run(tmp_path / "o")
    run = Run(tmp_path / "o")
    with pytest.raises(KeyError, match="no field 'charge'"):
        run[0]["charge"]
    with pytest.raises(KeyError, match="no field 'time'"):
        run.to_xarray("time")
    with pytest.raises(TypeError, match="is neither the number of a frame nor a slice"):
        run["position"]
    frames = pickle.loads(pickle.dumps(run[:]))
    assert [frame.position.tolist() for frame in frames] == [frame.position.tolist() for frame in run]


@pytest.mark.parametrize("d", [1, 2, 3])
def test_mutual_gravity_that_is_switched_off_has_its_columns(tmp_path, d):
    """From the start, and between two runs into one folder."""
    pair = [{"position": [[0.0] * d, [1.0] + [0.0] * (d - 1)], "mass": 1.0}]
    tables = {"dimension": d, "G": 1.0, "time": {"step": 0.01, "steps": 4}, "particles": pair}
    sim = Simulation(Scene(**tables, effects={"mutual_gravity": {"active": False}}, output={"diagnostics_every": 1}))
    sim.run(tmp_path / "out", steps=2)
    sim.effects["mutual_gravity"].active = True
    sim.run(tmp_path / "out")
    rows = Run(tmp_path / "out").diagnostics
    assert np.isnan(rows["virial_ratio"][:3]).all() and np.isfinite(rows["virial_ratio"][3:]).all()
    assert (rows["center_x"] == 0.5).all() and rows["potential"].tolist()[:3] == [0.0] * 3


def test_who_is_fixed_just_before_a_run_is_so_in_its_frames(tmp_path):
    tables = {"dimension": 2, "time": {"step": 0.01, "steps": 4}, "effects": {}}
    sim = Simulation(Scene(**tables, particles=[{"position": [[0.0, 0.0], [1.0, 0.0]], "velocity": [1.0, 0.0]}]))
    sim.particles.fixed[0] = True
    sim.particles.velocity[0] = 0.0
    sim.run(tmp_path / "out", steps=2)
    assert Run(tmp_path / "out")[-1].fixed.tolist() == [True, False]
    assert json.loads((tmp_path / "out/run.json").read_text())["plan"]["fixed"] == 1
    resumed = Simulation.resume(tmp_path / "out/checkpoint.h5")
    resumed.run(tmp_path / "out")
    assert len(Run(tmp_path / "out").times) > 0 and resumed.steps_done == 4


def test_a_run_that_has_nothing_left_to_do_keeps_what_was_changed(tmp_path):
    tables = {"dimension": 2, "time": {"step": 0.01, "steps": 4}, "effects": {}}
    sim = Simulation(Scene(**tables, particles=[{"position": [[0.0, 0.0]], "velocity": [1.0, 0.0]}]))
    sim.run(tmp_path / "out")
    sim.particles.velocity *= -3.0
    sim.run(tmp_path / "out")
    assert Simulation.resume(tmp_path / "out/checkpoint.h5") == sim


def test_what_follows_from_other_fields_cannot_be_set():
    sim = Simulation(Scene(dimension=1, time={"step": 0.01, "steps": 4}, effects={}, particles=[{"position": [[0.0]]}]))
    for change in (
        lambda p: setattr(p, "inverse_mass", 2.0),
        lambda p: setattr(p, "dimension", 2),
        lambda p: p.inverse_mass.__setitem__(0, 2.0),
    ):
        with pytest.raises((AttributeError, ValueError), match=r"inverse_mass|dimension|read-only"):
            change(sim.particles)


def test_a_spin_is_kept_where_no_wall_is():
    """Rough walls of a box that is periodic are none, and spheres turn all the same."""
    box = {"lower": [0.0] * 2, "upper": [1.0] * 2, "periodic": True}
    spinning = [{"position": [[0.5, 0.5]], "radius": 0.1, "spin": 3.0}]
    scene = Scene(dimension=2, box=box, time={"step": 0.01, "steps": 4}, effects={"walls": {"friction": 0.3}}, particles=spinning)
    sim = Simulation(scene)
    sim.run()
    assert sim.particles.spin.tolist() == [[3.0]]


def test_a_run_goes_on_in_its_folder_when_others_are_fixed(tmp_path):
    """Frames that told who was fixed go on telling it; those that did not cannot, and the run says so."""
    for before, after in ((True, False), (False, True)):
        pair = {"position": [[0.0, 0.0], [1.0, 0.0]], "fixed": [before, False]}
        sim = Simulation(Scene(dimension=2, time={"step": 0.01, "steps": 4}, effects={}, particles=[pair]))
        sim.run(tmp_path / f"{before}", steps=2)
        sim.particles.fixed[0] = after
        sim.run(tmp_path / f"{before}")
        with h5py.File(tmp_path / f"{before}/trajectory.vtkhdf") as file:
            assert ("fixed" in file["VTKHDF/PointData"]) == before
        assert any("do not show which particles are fixed" in line for line in sim.warnings) == after and sim.steps_done == 4
        resumed = Simulation.resume(tmp_path / f"{before}/checkpoint.h5")
        assert resumed.particles.fixed.tolist() == [after, False]


def test_the_last_row_is_there_when_nothing_is_left_to_do(tmp_path):
    """It is extra, and so removed where a run goes on; what was changed meanwhile is in it. In another folder, too."""
    tables = {"dimension": 2, "time": {"step": 0.01, "steps": 10}, "effects": {}, "output": {"diagnostics_every": 4}}
    sim = Simulation(Scene(**tables, particles=[{"position": [[0.0, 0.0]], "velocity": [1.0, 0.0]}]))
    sim.run(tmp_path / "a")
    sim.particles.velocity *= 3.0
    sim.run(tmp_path / "a")
    rows = Run(tmp_path / "a").diagnostics
    assert rows["step"].tolist() == [0, 4, 8, 10] and rows["kinetic"].tolist() == [0.5, 0.5, 0.5, 4.5]
    Simulation.resume(tmp_path / "a/checkpoint.h5").run(tmp_path / "b", resumed=True)
    assert Run(tmp_path / "b").diagnostics["step"].tolist() == [10]


def test_frames_in_another_folder_begin_where_the_run_goes_on(tmp_path):
    """Where nothing is left to do, too; and only if that step is one with a frame: else there may be none, and nothing to see."""
    tables = {"dimension": 2, "time": {"step": 0.01, "steps": 10}, "effects": {}}
    particles = [{"position": [[0.0, 0.0]], "velocity": [1.0, 0.0]}]
    for every, frames in ((5, {4: [5, 10], 5: [5, 10], 10: [10]}), (3, {9: [9], 10: []})):
        for stop, steps in frames.items():
            sim = Simulation(Scene(**tables, output={"every": every}, particles=particles))
            sim.run(tmp_path / f"{every}.{stop}", steps=stop)
            here = tmp_path / f"{every}.{stop}.on"
            Simulation.resume(tmp_path / f"{every}.{stop}" / "checkpoint.h5").run(here, resumed=True)
            assert [frame.step for frame in Run(here)] == steps
            assert (here / "particles.pvd").exists() == (steps != [])


def test_what_is_fixed_by_a_table_is_so_in_each_form_of_the_scene(tmp_path):
    (tmp_path / "a.csv").write_text("x,y,fixed\n0.1,0.2,1\n0.5,0.6,0\n")
    tables = {"dimension": 2, "time": {"step": 0.01, "steps": 2}, "particles": [{"position": {"file": "a.csv"}}]}
    scene = Scene.from_dict(tables | {"effects": {"uniform_gravity": {"acceleration": [0, -1]}}}, tmp_path)
    changed = Scene.from_dict(scene.to_dict(), tmp_path)
    changed.time.steps = 4
    variants = scene, changed, variant(scene, scene.to_dict()["time"])
    assert [Simulation(each).particles.fixed.tolist() for each in variants] == [[True, False]] * 3


def test_a_run_that_is_to_end_earlier_than_it_has_come_keeps_its_last_row(tmp_path):
    particles = [{"position": [[0.0, 0.0]], "velocity": [1.0, 0.0]}]
    longer, shorter = (
        Scene(dimension=2, time={"step": 0.01, "steps": n}, output={"diagnostics_every": 4}, particles=particles)
        for n in (13, 10)
    )
    Simulation(longer).run(tmp_path)
    sim = Simulation.resume(tmp_path / "checkpoint.h5")
    sim.scene = shorter
    sim.run(tmp_path, resumed=True)
    assert Run(tmp_path).diagnostics["step"].tolist() == [0, 4, 8, 12, 13]


def test_a_remark_is_made_once_though_both_parts_of_a_run_have_it(tmp_path):
    """A sphere that crosses most of a narrow box in a step: mode event, or shorter steps, would be better."""
    box = {"lower": [-1, 2], "upper": [1, 4], "periodic": True}
    particles = [
        {"position": [[0, 3.5], [0.5, 3.2]], "velocity": [[9, 3], [-1, 0.5]], "radius": 0.05},
        {"count": 10, "position": "random", "velocity": {"speed": 2}, "radius": 0.03},
    ]
    tables = {"dimension": 2, "box": box, "particles": particles, "time": {"step": 0.01, "steps": 3000}}
    sim = Simulation(Scene(**tables, effects={"collisions": {}}))
    sim.run(tmp_path, steps=1500)
    Simulation.resume(tmp_path / "checkpoint.h5").run(tmp_path, resumed=True)
    remarks = Run(tmp_path).about["remarks"]
    assert remarks and len(set(remarks)) == len(remarks)
