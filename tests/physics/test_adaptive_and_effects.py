"""The integrator `adaptive` with forces of a user's, and where it refuses or stops."""

import signal
import subprocess
import sys
from time import sleep

import numpy as np
import pytest
from with_all import with_all

from particles_mpi import Scene, SceneError, Simulation

HILL = """
import numpy as np
from particles_mpi.effects import EffectOptions, Force
class Options(EffectOptions):
    height: float = 0.1
    width: float = 0.06
class Effect(Force):
    "A smooth hill in the middle of a box from 0 to 1."
    formula = "dv/dt = -dphi/dx"
    farthest = 0.0
    def __init__(self, options, scene): self.height, self.width = options.height, options.width
    def phi(self, x): return self.height * np.exp(-(((x - 0.5) / self.width) ** 2) / 2)
    def add(self, p, a):
        x = p.position[:, 0]
        Effect.farthest = max(Effect.farthest, x.max(initial=0.0))
        a[:, 0] += self.phi(x) * (x - 0.5) / self.width**2
    def potential(self, p): return p.mass * self.phi(p.position[:, 0])
"""
SLOW = """
import time
from pathlib import Path
from particles_mpi.effects import EffectOptions, Force
class Options(EffectOptions): pass
class Effect(Force):
    formula = "an oscillator of high frequency, whose force takes 0.02 s"
    def __init__(self, options, scene): pass
    def add(self, p, a):
        time.sleep(0.02)
        Path("asked").touch()
        a -= 1e6 * p.position
"""
SCENE = """
dimension = 1
time = {step = 1.0, steps = 1, integrator = "adaptive"}
particles = [{position = [[0.0]], velocity = [1.0]}]
effects = {slow = {file = "slow.py"}}
"""


def over_the_hill(folder, step, steps, integrator="adaptive", periodic=True, **options):
    """A point that begins at x = 0 with a speed of 1: its simulation, after the run."""
    (folder / "hill.py").write_text(HILL)
    tables = {"dimension": 1, "time": {"step": step, "steps": steps, "integrator": integrator}}
    tables["particles"] = [{"position": [[0.0]], "velocity": [1.0]}]
    box = {"box": {"lower": [0.0], "upper": [1.0], "periodic": True}} if periodic else {}
    sim = Simulation(Scene.from_dict({**tables, **box, "effects": {"hill": {"file": "hill.py", **options}}}, folder))
    sim.run()
    return sim


@pytest.mark.parametrize("step", [1.0, *with_all(0.1, 0.5)])
def test_a_hill_in_a_periodic_box_is_passed_in_each_lap(step, tmp_path):
    """The time of a lap is the integral of dx/v. The force is exactly 0 at the faces, and is never asked for beyond them."""
    x, w = np.polynomial.legendre.leggauss(2000)
    lap = float((0.5 * w / np.sqrt(1.0 - 0.2 * np.exp(-((0.5 * x / 0.012) ** 2) / 2))).sum())
    sim = over_the_hill(tmp_path, step, round(2 / step), width=0.012)
    assert sim.particles.position[0, 0] == pytest.approx(2.0 - lap - (lap - 1.0), abs=1e-8)
    assert 0.5 < type(sim.active.forces["hill"]).farthest < 1.0


@pytest.mark.parametrize("integrator", ["leapfrog", "order4", "taylor"])
def test_a_force_is_given_places_inside_of_a_periodic_box(integrator, tmp_path):
    sim = over_the_hill(tmp_path, 0.01, 400, integrator)
    assert 0.5 < type(sim.active.forces["hill"]).farthest < 1.0


@pytest.mark.parametrize("step", [0.1, 1.0, 5.0])
def test_a_force_may_fade_away_below_the_range_of_numbers(step, tmp_path):
    sim = over_the_hill(tmp_path, step, round(5 / step), periodic=False)
    assert sim.particles.position[0, 0] == pytest.approx(4.98310867388, abs=1e-8)


def test_a_tree_is_refused_and_auto_is_the_direct_sum():
    """Forces of a tree jump where its cells change: substeps would be as short as can be, for days."""

    def cluster(method):
        gravity, time = {"G": 1.0, "softening": 0.1, "method": method}, {"step": 0.01, "steps": 1, "integrator": "adaptive"}
        stars = [{"count": 3000, "position": {"plummer": 1.0}, "velocity": "equilibrium", "mass": 1e-3}]
        return Scene(dimension=3, time=time, effects={"mutual_gravity": gravity}, particles=stars)

    with pytest.raises(SceneError, match=r"mutual_gravity\.method: the forces of a tree jump"):
        cluster("tree")
    scene = cluster("auto")
    assert "tree" not in scene.effects["mutual_gravity"].described(scene, 3000).split(",")[0]


def test_a_long_step_with_a_force_of_the_users_ends_on_a_signal(tmp_path):
    """Whoever ends a job need not wait for the end of the step, which would take an hour."""
    (tmp_path / "slow.py").write_text(SLOW)
    (tmp_path / "a.toml").write_text(SCENE)
    command = [sys.executable, "-m", "particles_mpi", "run", "a.toml", "--output", "out"]
    run = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while not ((tmp_path / "out/diagnostics.csv").exists() and (tmp_path / "asked").exists()) and run.poll() is None:
        sleep(0.05)
    sleep(0.3)
    run.send_signal(signal.SIGTERM)
    _, said = run.communicate(timeout=30)
    assert run.returncode == 130 and said.endswith("stopped in the middle of a long step: continue from the last checkpoint\n")
