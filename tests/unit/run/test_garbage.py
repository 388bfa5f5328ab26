"""Python's search for garbage: not in the start of a run, which makes very many objects that stay, but in its steps."""

import subprocess
import sys

from conftest import environment

PROBE = """
import gc
from particles_mpi.effects import EffectOptions, Event


class Options(EffectOptions):
    pass


class Effect(Event):
    formula = "none"

    def __init__(self, options, scene):
        print("start", gc.isenabled())

    def act(self, particles, h):
        print("step", gc.isenabled(), gc.get_freeze_count() > 100_000)
        return 0
"""
SCENE = """
dimension = 1
time = {step = 0.1, steps = 2}
particles = [{position = [[0.0]], velocity = [1.0]}]
effects.probe = {file = "probe.py"}
"""


def test_garbage_is_sought_in_steps_but_not_among_what_the_start_has_made(tmp_path):
    (tmp_path / "probe.py").write_text(PROBE)
    (tmp_path / "scene.toml").write_text(SCENE)
    command = [sys.executable, "-m", "particles_mpi", "run", tmp_path / "scene.toml", "--output", tmp_path / "out", "--quiet"]
    done = subprocess.run(command, env=environment(), capture_output=True, text=True, check=True)
    lines = done.stdout.splitlines()
    assert "start False" in lines and lines.count("step True True") == 2
