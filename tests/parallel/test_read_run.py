"""A run is read while two ranks write it, and in the process that writes it."""

import subprocess
import sys
from time import sleep

import h5py
import pytest
from conftest import ROOT, run_ranks
from ranks import environment

from particles_mpi import Run, Scene, SceneError, Simulation

pytestmark = pytest.mark.parallel

SCENE = """
dimension = 3
[time]
step = 0.01
steps = 30
[box]
lower = [0, 0, 0]
upper = [9, 9, 9]
periodic = true
[[particles]]
count = 2000
position = "lattice"
velocity = {speed = 1.0}
[output]
every = 1
diagnostics_every = 1
formats = ["hdf5"]
"""


PAUSE = """
from time import sleep
from particles_mpi.effects import EffectOptions, Event

class Options(EffectOptions):
    pass

class Effect(Event):
    formula = "a pause: frames that follow one another within half a second are shown together"

    def __init__(self, options, scene):
        pass

    def act(self, particles, h):
        sleep(0.07)
        return 0
"""


def test_reading_while_two_ranks_write(tmp_path):
    """Every frame that is counted is whole: its bits are those of the end. New frames are seen by the same `Run`."""
    (tmp_path / "gas.toml").write_text(SCENE + '[effects.pause]\nfile = "pause.py"\n')
    (tmp_path / "pause.py").write_text(PAUSE)
    folder = tmp_path / "run"
    command = ["mpirun", "-n", "2", sys.executable, "-m", "particles_mpi", "run", tmp_path / "gas.toml", "--output", folder]
    with subprocess.Popen([*map(str, command), "--quiet"], cwd=ROOT, env=environment()) as writer:
        run, seen, lengths, rows = None, {}, set(), 0
        while writer.poll() is None:
            sleep(0.01)
            try:
                run = run or Run(folder)
                count = len(run)
            except SceneError:  # not begun
                continue
            for k in {0, count // 2, count - 1} if count else ():
                frame = run[k]
                seen.setdefault(k, (frame.time, frame.id.tobytes() + frame.position.tobytes() + frame.velocity.tobytes()))
            lengths.add(count)
            if count:  # the row of a step is written before its frame
                assert rows <= (rows := len(run.columns["time"])) and rows >= count
    assert writer.returncode == 0 and len(run) == 31 and run.ended
    assert len(lengths) > 2 and len(seen) > 2
    for k, found in seen.items():
        frame = run[k]
        assert found == (frame.time, frame.id.tobytes() + frame.position.tobytes() + frame.velocity.tobytes()), k


def test_reading_in_the_process_that_writes(tmp_path):
    sim = Simulation(Scene(dimension=2, time={"step": 0.1, "steps": 5}, particles=[{"position": [[0, 0]], "velocity": [1, 0]}],
                           output={"every": 1}))  # fmt: skip
    step, told = sim.step, []

    def step_and_look():
        step()
        told.append([frame.position[0, 0] for frame in Run(tmp_path / "run")])

    sim.step = step_and_look
    sim.run(tmp_path / "run")
    expected = [0.0, 0.1, 0.2, 0.3, 0.4]
    assert [len(row) for row in told] == [1, 2, 3, 4, 5]
    assert told[-1] == pytest.approx(expected) and len(Run(tmp_path / "run")) == 6


def test_frames_before_an_error_are_in_the_file(tmp_path):
    """An error of Python, as in an effect of the user's own, when frames wait for those that follow."""
    sim = Simulation(Scene(dimension=2, time={"step": 0.1, "steps": 5}, particles=[{"position": [[0, 0]]}], output={"every": 1}))
    step = sim.step

    def fails():
        if sim.steps_done == 3:
            raise ZeroDivisionError
        step()

    sim.step = fails
    with pytest.raises(ZeroDivisionError):
        sim.run(tmp_path / "run")
    with h5py.File(tmp_path / "run" / "trajectory.vtkhdf", "r", locking=False) as file:
        assert file["VTKHDF/Steps"].attrs["NSteps"] == 4


def test_view_writes_one_page_on_any_number_of_ranks(tmp_path):
    sim = Simulation(Scene(dimension=2, time={"step": 0.1, "steps": 1}, particles=[{"position": [[0, 0]]}]))
    sim.run(tmp_path / "run")
    pages = set()
    for ranks in (1, 2):
        done = run_ranks(ranks, "-m", "particles_mpi", "view", tmp_path / "run", "--no-open")
        assert done.returncode == 0 and done.stdout.count(" kB)") == 1, done.stdout + done.stderr
        pages.add((tmp_path / "run" / "view.html").read_text())
    assert len(pages) == 1
    done = run_ranks(2, "-m", "particles_mpi", "view", tmp_path, "--no-open")
    assert done.returncode == 2 and done.stderr.splitlines()[-1].endswith(f"{tmp_path}: holds no run")


def test_what_a_notebook_gets_has_the_same_bits_on_any_number_of_ranks():
    done = [run_ranks(ranks, ROOT / "tests" / "parallel" / "view_frames.py") for ranks in (1, 2, 3)]
    assert all(one.returncode == 0 for one in done), done[-1].stderr
    assert len({one.stdout for one in done}) == 1 and done[0].stdout.startswith("5 ")
