"""Ctrl-C is heard within a second in a step that takes days: in a script, and in a run of one process."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from time import sleep

import pytest
from conftest import ROOT

WELL_INTO = 0.4  # seconds of a core, after which a process is in its long step: kernels are loaded in a quarter of that
LONG = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # the tests may be a job in the background, which is to ignore it
import sys
from particles_mpi import Scene, Simulation
from particles_mpi.cli import main
print("begins", flush=True)
"""
SCRIPT = LONG + "Simulation(Scene.load(sys.argv[1])).run()"
COMMAND = LONG + "sys.argv[1:] = ['run', sys.argv[1], '--output', sys.argv[1] + '.out']\nmain()"
SCENE = """
dimension = 2
[box]
lower = [0, 0]
upper = [100, 100]
[time]
step = 1e4
steps = 1
[[particles]]
count = 1000
position = "random"
velocity = {speed = 50.0}
radius = 0.5
[effects.collisions]
mode = "event"
[effects.walls]
"""


def seconds_of(process):
    """Of a core that a process has taken so far."""
    ticks = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()[11:13]
    return sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory):
    """(process, exit code due, what it says) of a user's script and of a command, well into a step of very many contacts."""
    scene = tmp_path_factory.mktemp("long") / "long.toml"
    scene.write_text(SCENE)
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    processes = [subprocess.Popen([sys.executable, "-c", script, scene], cwd=ROOT, **pipes) for script in (SCRIPT, COMMAND)]
    try:
        for process in processes:
            assert process.stdout.readline() == "begins\n"
        begun = [seconds_of(process) for process in processes]
        while any(seconds_of(process) < begin + WELL_INTO for process, begin in zip(processes, begun, strict=True)):
            assert all(process.poll() is None for process in processes)
            sleep(0.02)
        ends = (-signal.SIGINT, "KeyboardInterrupt"), (130, "particles-mpi: stopped in the middle of a long step")
        yield {what: (process, *end) for what, process, end in zip(("script", "command"), processes, ends, strict=True)}
    finally:
        for process in processes:
            process.kill()
            process.wait()


@pytest.mark.parametrize("what", ["script", "command"])
def test_ctrl_c_is_heard_within_a_step(interrupted, what):
    process, code, text = interrupted[what]
    assert process.poll() is None
    os.kill(process.pid, signal.SIGINT)
    said = process.communicate(timeout=20)[1]  # a second, on a machine that is not busy with something else; the step takes days
    assert process.returncode == code and text in said, said
