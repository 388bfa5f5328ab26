"""What `check` predicts is about the run, and not about what would come after it."""

import re

import pytest

from particles_mpi import Scene, Simulation
from particles_mpi.run import forecast
from particles_mpi.study.experiment import Benchmark
from particles_mpi.study.recommend import predict as predicting
from particles_mpi.study.recommend.predict import predict

ORBIT = {
    "dimension": 2,
    "particles": [{"position": [[1.0, 0.0]], "velocity": [0.0, 1.0], "mass": 0.0}, {"position": [[0.0, 0.0]], "fixed": True}],
    "effects": {"mutual_gravity": {"G": 1.0}},
}


@pytest.fixture(autouse=True)
def short_trials(monkeypatch):
    """What is told is tested here, and not how well seconds are measured: a tenth of the time is enough.

    How long a step takes decides what is measured at all: here it is 0.1 ms, also where another process had the core meanwhile.
    """
    rehearse = predicting.rehearse
    monkeypatch.setattr(predicting, "rehearse", lambda sim: rehearse(sim)._replace(step=1e-4))
    monkeypatch.setattr(forecast, "MEASURED_SECONDS", 0.1 * forecast.MEASURED_SECONDS)
    monkeypatch.setattr(predicting, "COST_SECONDS", 0.1 * predicting.COST_SECONDS)


@pytest.mark.parametrize("steps", [1, 3, 4, 7, 1000])
def test_errors_are_those_of_a_time_within_the_run(steps):
    scene = Scene.from_dict(ORBIT | {"time": {"step": 0.01, "steps": steps}})
    (line,) = predict(Simulation(scene), Benchmark()).errors
    if steps < 4:
        assert line == "predicted error: not measured, the run has fewer than 4 steps"
    else:
        assert 0.0 < float(re.search(r"at t = ([\d.]+)", line).group(1)) <= 0.01 * steps * (1.0 + 1e-12)


def end_of_orbit(start, end, **time):
    """(places at the end of an orbit, the scene)."""
    scene = Scene.from_dict(ORBIT | {"particles": start, "time": {"end": end} | time})
    sim = Simulation(scene)
    sim.run()
    return sim.particles.position.copy(), scene


@pytest.mark.parametrize(
    ("time", "above"),
    [
        ({"step": 0.04}, 3.0),
        ({"step": 0.01}, 3.0),
        ({"step": 0.1, "integrator": "order4"}, 3.0),
        ({"step": 0.75, "integrator": "adaptive", "tolerance": 1e-3}, 20.0),
        ({"step": 0.75, "integrator": "adaptive", "tolerance": 5.7e-4}, 30.0),
        ({"step": 0.75, "integrator": "adaptive", "tolerance": 1e-4}, 5.0),
        ({"step": 0.75, "integrator": "adaptive", "tolerance": 1e-5}, 5.0),
    ],
)
def test_the_error_is_as_told(time, above):
    """The largest on the way, at least what it is at the end; that of `adaptive` is of the tolerance, not extrapolated."""
    start = [
        {"position": [[1.0, 0.0]], "velocity": [0.0, 0.8], "mass": 1e-3},
        {"position": [[0.0, 0.0]], "velocity": [0.0, 0.0], "mass": 1.0},
    ]
    found, scene = end_of_orbit(start, 12.0, **time)
    true, _ = end_of_orbit(start, 12.0, step=0.75, integrator="adaptive", tolerance=1e-11)
    (line,) = predict(Simulation(scene), Benchmark()).errors
    told, at = re.search(r"positions wrong by ([-+e.0-9]+) of the size of the motion at t = ([\d.]+)", line).groups()
    assert float(at) == 12.0
    assert 1.0 < float(told) / abs(found - true).max() < above  # the size of the motion is about 1


GAS = {
    "dimension": 2,
    "box": {"lower": [0.0, 0.0], "upper": [9.0, 9.0]},
    "particles": [{"count": 30, "position": "random", "velocity": {"temperature": 1.0}, "radius": 0.5}],
    "effects": {"collisions": {}, "walls": {}},
}


@pytest.mark.parametrize("tables", [ORBIT, GAS])
def test_errors_do_not_follow_the_clock(monkeypatch, tables):
    """A machine that is ten times as slow, or a hundred times as fast, tells the same of as much of the run."""
    scene = Scene.from_dict(tables | {"time": {"step": 0.01, "steps": 100_000}})
    told, now = [], predicting.rehearse
    for speed in (1.0, 0.1, 100.0):
        monkeypatch.setattr(predicting, "rehearse", lambda sim, s=speed: (f := now(sim))._replace(step=f.step / s))
        told.append(predict(Simulation(scene), Benchmark()).errors)
    assert told[0] == told[1] == told[2] and "not measured, " not in told[0][0]


def test_the_error_of_a_tree_is_told_too():
    stars = {"count": 300, "position": {"plummer": 1.0}, "velocity": "equilibrium", "mass": 1.0 / 300}
    tree = {"softening": 0.05, "method": "tree", "opening_angle": 1.0, "multipole": "monopole"}
    scene = {
        "dimension": 3,
        "G": 1.0,
        "time": {"step": 0.01, "steps": 20},
        "particles": [stars],
        "effects": {"mutual_gravity": tree},
    }
    (line,) = predict(Simulation(Scene.from_dict(scene)), Benchmark()).errors
    step, by_tree = (float(re.search(f"{word} ([-+e.0-9]+)", line).group(1)) for word in ("positions wrong by", "the tree adds"))
    assert by_tree > 5.0 * step > 0.0


COMPILES = """
from time import sleep
from particles_mpi.scene.effect import EffectOptions, Force
compiled = []
class Options(EffectOptions): pass
class Effect(Force):
    formula = "dv/dt = 1"
    def __init__(self, options, scene): pass
    def add(self, particles, acceleration):
        if not compiled:
            sleep(0.8)
            compiled.append(True)
        acceleration += 1.0
"""


def test_what_is_compiled_for_the_first_trial_is_not_compiled_by_the_run(tmp_path, monkeypatch):
    monkeypatch.setattr(predicting, "COMPILED_IF_LONGER", 0.5)
    (tmp_path / "slow.py").write_text(COMPILES)
    tables = {"dimension": 2, "time": {"step": 0.01, "steps": 30}, "particles": [{"position": [[0.0, 0.0]]}]}
    sim = Simulation(Scene.from_dict(tables | {"effects": {"slow": {"file": "slow.py"}}}, tmp_path))
    trials, rehearse = [], predicting.rehearse
    monkeypatch.setattr(predicting, "rehearse", lambda sim: trials.append(rehearse(sim)) or trials[-1])
    told = predict(sim, Benchmark()).forecast
    first, second = trials
    assert first.seconds > 0.8 and told is second and second.seconds < first.seconds - 0.4
