"""Runs that a script starts, goes on with, copies, or shows: what it asks for is done, or refused in one line."""

import copy
import pickle
import threading

import numpy as np
import pytest

from particles_mpi import Run, Scene, SceneError, Simulation

HEAD = {"dimension": 1, "time": {"step": 0.1, "steps": 40}, "output": {"every": 10, "checkpoint_every": 10}}


def simulation():
    return Simulation(Scene(**HEAD, particles=[{"position": [[0.0]], "velocity": [1.0]}]))


@pytest.mark.parametrize("option", [{"steps": 0.3 / 0.1}, {"steps": -5}, {"steps": "3"}, {"wall_time": "00:00:10"}])
def test_options_that_are_no_numbers_are_refused_and_nothing_is_written(option, tmp_path):
    sim = simulation()
    with pytest.raises(ValueError, match=f"run: {next(iter(option))}: .* is (not a number of steps|no number of seconds)"):
        sim.run(tmp_path / "o", **option)
    assert not (tmp_path / "o").exists() and sim.steps_done == 0


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
    with pytest.raises(TypeError, match="add: takes the keys of one"):
        simulation().add([{"position": [[3.0]]}])


def test_what_a_run_does_not_have_is_told_by_name(tmp_path):
    simulation().run(tmp_path / "o")
    run = Run(tmp_path / "o")
    with pytest.raises(KeyError, match="no field 'charge'"):
        run[0]["charge"]
    with pytest.raises(KeyError, match="no field 'time'"):
        run.to_xarray("time")
    with pytest.raises(TypeError, match="no number of a frame"):
        run["position"]
    frames = pickle.loads(pickle.dumps(run[:]))
    assert [frame.position.tolist() for frame in frames] == [frame.position.tolist() for frame in run]
