"""In a job of Slurm: when a run stops, and by which command run.sh starts it."""

import os
import re
import signal
import subprocess
import time

import pytest
from conftest import ROOT

from particles_mpi import Run, Scene, Simulation
from particles_mpi.errors import Interrupted
from particles_mpi.parallel import signals
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.signals import StopRequest
from particles_mpi.run.files import RunFiles
from particles_mpi.run.scheduler import parse_time, slurm_limit


def answers(folder, name, text):
    """Put a program of this name first on the PATH of a test, which prints a text; it fails if that is empty."""
    path = folder / name
    path.write_text(f"#!/bin/sh\n[ '{text}' ] && echo {text}\n")
    path.chmod(0o755)
    return f"{folder}:{os.environ['PATH']}"


@pytest.mark.parametrize(("left", "stop"), [(40, 30), (1000, 940), (86400, 85536), (0, 0), (-5, -5)])
def test_a_run_stops_before_the_end_of_its_job(monkeypatch, left, stop):
    monkeypatch.setenv("SLURM_JOB_ID", "7")
    monkeypatch.setenv("SLURM_JOB_END_TIME", str(time.time() + left))
    found, line = slurm_limit()
    assert abs(found - stop) < 0.5 and "of job 7" in line


@pytest.mark.parametrize(
    ("said", "stop", "line"),
    [("1-00:00:00", 85536, "stops at"), ("16:40", 940, "stops at"), ("UNLIMITED", None, ""), ("", None, "give --wall-time")],
)
def test_an_old_slurm_is_asked(monkeypatch, tmp_path, said, stop, line):
    monkeypatch.setenv("SLURM_JOB_ID", "7")
    monkeypatch.delenv("SLURM_JOB_END_TIME", raising=False)
    monkeypatch.setenv("PATH", answers(tmp_path, "squeue", said))
    found, told = slurm_limit()
    assert found == (stop and pytest.approx(stop)) and line in told and bool(line) == bool(told)


def test_outside_of_a_job_there_is_no_limit(monkeypatch):
    monkeypatch.delenv("SLURM_JOB_ID", raising=False)
    assert slurm_limit() == (None, "")


@pytest.mark.parametrize("text", ["", "1:2:3:4", "ten", "-5", "1:-2", "nan", "inf", "NOT_SET"])
def test_no_time(text):
    with pytest.raises(ValueError):
        parse_time(text)


OPEN, MPICH, BOTH = "mpirun Open MPI 5.0.7", "HYDRA build details", "none pmi2 pmix_v4 pmix"


@pytest.mark.parametrize(
    ("mpi", "offers", "variables", "command"),
    [
        (OPEN, BOTH, {"SLURM_JOB_ID": "7", "SLURM_NTASKS": "16"}, "srun --mpi=pmix --wait=30 -n 16 run"),
        (MPICH, BOTH, {"SLURM_JOB_ID": "7", "SLURM_NTASKS": "16", "RANKS": "4"}, "srun --mpi=pmi2 --wait=30 -n 4 run"),
        (OPEN, BOTH, {"SLURM_JOB_ID": "7", "SLURM_STEP_ID": "0"}, "srun --mpi=pmix --wait=30 --overlap run"),
        (OPEN, "none pmi2", {"SLURM_JOB_ID": "7", "SLURM_NTASKS": "16"}, "mpirun -n 16 run"),
        (OPEN, BOTH, {"RANKS": "4"}, "mpirun -n 4 run"),
        (OPEN, BOTH, {}, "mpirun -n 2 run"),
    ],
)
def test_the_command_of_run_sh(tmp_path, mpi, offers, variables, command):
    for name, asked, text in (("mpirun", "--version", mpi), ("srun", "--mpi=list", offers)):
        (tmp_path / name).write_text(f'#!/bin/sh\n[ "$1" = {asked} ] && echo {text} || echo {name} "$@"\n')
        (tmp_path / name).chmod(0o755)
    launch = re.search(r"^launch\(\) \{.*?^\}", (ROOT / "run.sh").read_text(), re.DOTALL | re.MULTILINE)[0]
    words = ["bash", "-euc", launch + "\nlaunch run"]
    done = subprocess.run(
        words, env={"PATH": f"{tmp_path}:/usr/bin:/bin"} | variables, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == command


def test_time_is_left_for_a_checkpoint():
    request = StopRequest(Communicator.alone(), time.perf_counter(), 100.0)
    stops = [request.poll(0)]
    request.reserve = 150.0
    stops.append(request.poll(request.next))
    request.close()
    assert stops == [False, True]


@pytest.mark.parametrize(("before", "most"), [(0.001, 0.4), (5.0, 10.0), (300.0, 20.0)])
def test_after_a_signal_a_step_may_take_twice_as_long_as_the_one_before(monkeypatch, before, most):
    """Steps of five seconds end with a checkpoint; the first one, of which nothing is known, has 0.4 s, none more than 20 s."""
    clock = [0.0]
    monkeypatch.setattr(signals, "perf_counter", lambda: clock[0])
    request = StopRequest(Communicator.alone(), 0.0, None)
    try:
        for seconds in (100.0, before):  # the first one compiles
            with request:
                clock[0] += seconds
        request.note_signal()
        clock[0] += 1000.0  # while a frame is written
        with request:
            clock[0] += 0.999 * most
            signals.check_signals()
            clock[0] += 0.002 * most
            with pytest.raises(KeyboardInterrupt, match="continue from the last checkpoint"):
                signals.check_signals()
    finally:
        request.close()


def test_a_signal_while_something_is_written_slowly_is_followed_by_a_checkpoint(tmp_path, monkeypatch):
    """Ranks compare every ten steps; those until then are short, however long the writing has taken."""
    write, signalled = RunFiles.write_frame, []

    def slowly(files):
        write(files)
        step = files.sim.steps_done
        if not signalled and 0 < step < signals._requests[-1].next:
            signalled.append(step)
            os.kill(os.getpid(), signal.SIGUSR1)
            time.sleep(1.1 * signals.GRACE)

    monkeypatch.setattr(RunFiles, "write_frame", slowly)
    bodies = [{"position": [[1.0, 0.0], [-1.0, 0.0]], "velocity": [[0.0, 0.5], [0.0, -0.5]], "mass": 1.0}]
    output = {"every": 5, "diagnostics_every": 5, "checkpoint_every": 1000}
    time_step = {"step": 0.01, "steps": 1000, "integrator": "adaptive"}
    scene = Scene(dimension=2, G=1.0, time=time_step, particles=bodies, effects={"mutual_gravity": {}}, output=output)
    with pytest.raises(Interrupted, match="of 1000, saved"):
        Simulation(scene).run(tmp_path / "o", quiet=True)
    saved = Simulation.resume(tmp_path / "o" / "checkpoint.h5").steps_done
    assert signalled[0] < saved <= signalled[0] + 10 and not Run(tmp_path / "o").ended
