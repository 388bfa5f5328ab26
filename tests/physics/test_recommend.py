"""The recommended setting reaches the tolerance in truth, and nothing measured that does is much cheaper."""

from time import sleep

import numpy as np
import pytest
from conftest import ROOT
from recommend_cases import CASES, kepler, thrown
from with_all import with_all

from particles_mpi import Scene, Simulation
from particles_mpi.errors import SceneError, StoppedError
from particles_mpi.study.accuracy.orbits import PLANET, gravity
from particles_mpi.study.experiment import Benchmark
from particles_mpi.study.recommend.methods import methods
from particles_mpi.study.recommend.predict import predict
from particles_mpi.study.recommend.recommend import recommend
from particles_mpi.study.recommend.reference import extrapolated, reference
from particles_mpi.study.recommend.runs import Start
from particles_mpi.study.recommend.search import Search

PLENTY = 300.0  # seconds that measuring may take: none of these comes near it


QUICK = (0, 5, 6)  # of the cases: with others measuring takes seconds


@pytest.mark.parametrize("number", [k if k in QUICK else pytest.param(k, marks=pytest.mark.slow) for k in range(len(CASES))])
def test_its_setting_reaches_the_tolerance_in_truth(number):
    case = CASES[number]()
    found = recommend(Benchmark(quick=True, samples=3), case.scene, case.tolerance, case.error, PLENTY)
    sim = Simulation(Scene.from_dict(found.tables))
    sim.run()
    assert sim.time == pytest.approx(case.scene.steps * case.scene.time.step, rel=1e-12)
    assert case.truth(sim, found.search.metric.size) <= case.tolerance
    names = list(found.search.tolerances)
    reached = [one for one in found.timed if all(one.errors[name] <= case.tolerance for name in names)]
    assert found.best in reached and found.best.timed.median <= 1.2 * min(one.timed.median for one in reached)
    assert all(found.half[name] <= case.tolerance for name in names) and found.difference <= 2.0 * case.tolerance


def falling_ball(restitution, steps, step):
    """A ball of radius 0.1 that falls 1 under g = 9.81 onto a floor."""
    tables = {
        "dimension": 1,
        "box": {"lower": [0.0], "upper": [10.0]},
        "time": {"step": step, "steps": steps},
        "particles": [{"position": [[1.1]], "radius": 0.1}],
        "effects": {"uniform_gravity": {"acceleration": [-9.81]}, "walls": {"restitution": restitution}},
    }
    return Scene.from_dict(tables)


def height(t, restitution, g=9.81):
    """Of the ball at a time: parabolas, each as long as the one before times the restitution."""
    lands, speed = np.sqrt(2.0 / g), np.sqrt(2.0 * g)
    if t < lands:
        return 1.1 - 0.5 * g * t**2
    while (speed := speed * restitution) > 1e-12 and t >= lands + 2.0 * speed / g:
        lands += 2.0 * speed / g
    since = min(t - lands, 2.0 * speed / g)
    return 0.1 + speed * since - 0.5 * g * since**2


@pytest.mark.parametrize("tolerance", [1e-4, *with_all(1e-2)])
def test_a_motion_that_is_over_before_the_first_snapshot_is_measured_too(tolerance):
    """The ball lies still from t = 1.35 on: at all sixteen moments at which places are compared but the first."""
    found = recommend(Benchmark(quick=True, samples=3), falling_ball(0.5, 2000, 0.01), tolerance, "", PLENTY)
    sim, wrong = Simulation(Scene.from_dict(found.tables)), 0.0
    while sim.steps_done < sim.scene.steps:
        sim.step()
        wrong = max(wrong, abs(sim.particles.position[0, 0] - height(sim.time, 0.5)))
    assert 0.1 * tolerance < wrong <= tolerance


def recommended(tables, tolerance, folder, seconds=20.0):
    """The simulation of the setting that is recommended, at its end; None if nothing is."""
    scene = Scene.from_dict(tables, folder)
    try:
        found = recommend(Benchmark(quick=True, samples=3), scene, tolerance, "", seconds)
    except (SceneError, StoppedError):
        return None
    sim = Simulation(Scene.from_dict(found.tables, folder))
    sim.run()
    return sim


@pytest.mark.parametrize("rate", [1e3, 1e9])
def test_a_setting_whose_steps_drag_cannot_be_seen_in_is_not_recommended(rate, tmp_path):
    """The way that drag leaves a particle, v/k, is none in steps of 100/k, however many times they are halved."""
    g, v, end = np.array([0.0, -9.8]), np.array([1.0, 2.0]), 10.0
    tables = {
        "dimension": 2,
        "time": {"step": 0.1, "end": end},
        "particles": [{"position": [[0.0, 0.0]], "velocity": v.tolist(), "drag": rate}],
        "effects": {"drag": {}, "uniform_gravity": {"acceleration": g.tolist()}},
    }
    (told,) = predict(Simulation(Scene.from_dict(tables)), Benchmark()).errors
    left_out = np.linalg.norm(v - g / rate) / np.linalg.norm(g * end)  # over the way of the fall, which is twice its size or so
    assert left_out < float(told.split("positions wrong by ")[1].split()[0]) < 4.0 * left_out and "drag stops particles" in told
    sim = recommended(tables, 1e-4, tmp_path)
    if sim:
        exact = g / rate * end + (v - g / rate) * -np.expm1(-rate * end) / rate
        assert np.linalg.norm(sim.particles.position[0] - exact) <= 1e-4 * np.linalg.norm(exact)


def test_steps_that_agree_by_chance_are_no_reference(tmp_path):
    """A particle is slowed in the step in which it passes a gate: of h, h/2, h/4 and h/8 all may be late by the same."""
    (tmp_path / "gate.py").write_text((ROOT / "tests/parallel/outside/gate.py").read_text())
    errors = []
    for place in (0.777, 0.333, 0.509, 0.5081):
        tables = {
            "dimension": 2,
            "time": {"step": 0.01, "end": 2.0},
            "particles": [{"position": [[0.0, 0.0]], "velocity": [1.0, 0.3]}],
            "effects": {"gate": {"file": "gate.py", "place": place}},
        }
        if sim := recommended(tables, 2e-3, tmp_path, 60.0):
            errors.append(abs(sim.particles.position[0, 0] - (place + 0.5 * (2.0 - place))))
    assert errors and max(errors) <= 2e-3


def test_no_error_of_a_recommended_setting_is_above_the_tolerance(tmp_path):
    """A body that flies past a fixed one closely: no collision takes place at any step, but the energy is wrong by 1900 %."""
    body = {"mass": 1.0, "radius": 0.001}
    tables = {
        "dimension": 2,
        "G": 1.0,
        "time": {"step": 0.02, "end": 6.0},
        "particles": [
            {"position": [[0.0, 0.0]], "fixed": True, **body},
            {"position": [[-3.0, 0.02]], "velocity": [1.0, 0.0], **body},
        ],
        "effects": {"mutual_gravity": {}, "collisions": {"mode": "event"}},
    }
    energy = Simulation(Scene.from_dict(tables)).measure()["total_energy"]
    sim = recommended(tables, 1e-3, tmp_path)
    assert sim is None or abs(sim.measure()["total_energy"] - energy) <= 1e-3 * energy


def test_whole_periods_are_no_chaos():
    """At the end of each a planet is where it began, and an elastic ball too: so near to the start as nothing that moves is."""
    orbits = Start(Benchmark(), Scene.from_dict(gravity(PLANET, 2.0 * np.pi / 100, 1600, "leapfrog")))
    found = reference(orbits, PLENTY)
    assert "state" in found.limits and found.size == pytest.approx(np.sqrt(1.0 + 1.5 * 0.5**2), rel=0.2)  # from the focus
    bounce = 2.0 * np.sqrt(2.0 / 9.81)
    found = reference(Start(Benchmark(), falling_ball(1.0, 1600, bounce / 100.0)), PLENTY)
    assert "state" in found.limits and 0.2 < found.size < 1.0


def test_the_step_that_is_told_is_the_one_that_was_measured():
    """And not a shorter one, to which that of a part of the run was rounded."""
    start = Start(Benchmark(), kepler(1e-9).scene)
    search = Search(start, reference(start, 0.005), {"state": 1e-2}, PLENTY)
    assert search.metric.part < 1.0
    for method in (method for method in methods(start) if not method.adaptive):
        for resolution in (37.0, 75.0, 1000.0):
            trial = search.attempt(method, resolution)
            whole = trial.method.whole_steps(trial.resolution, trial.part)
            assert trial.scene.time.step == pytest.approx(start.duration / whole, rel=1e-12)
            assert trial.scene.steps >= resolution * trial.part


def test_frames_that_the_user_wants_set_the_longest_step():
    scene = falling_ball(1.0, 400, 0.01)
    scene.output.every = 4
    found = recommend(Benchmark(quick=True, samples=3), scene, 0.5, "", PLENTY)
    time, every = found.tables["time"], found.tables["output"]["every"]
    assert time["steps"] / every >= 100
    (method,) = methods(Start(Benchmark(), scene))  # a ladder of steps, as study accuracy has, goes further
    assert method.steps(20.0, 1.0) < 100


def test_a_free_flight_takes_time_in_every_integrator():
    flight = {"dimension": 2, "time": {"step": 0.05, "steps": 100}, "particles": [{"position": [[3, 3]], "velocity": [1, 0.5]}]}
    found = recommend(Benchmark(quick=True, samples=3), Scene.from_dict(flight), 1e-6, "", PLENTY)
    assert all(trial.timed.median > 0.0 for trial in found.timed)


def test_the_cases_are_nine_and_careless():
    """As they are, those with a state are off by more than their tolerance: there is something to recommend."""
    assert len(CASES) == 9
    for case in (CASES[k]() for k in (0, 1, 3, 5, 6)):
        sim = Simulation(case.scene)
        sim.run()
        assert case.truth(sim, 1.0) > case.tolerance


def test_it_refuses_what_cannot_be_measured():
    with pytest.raises(SceneError, match=r"--tolerance 1e-14 is below what can be measured here: state \d+e-1\d \("):
        recommend(Benchmark(), kepler(1e-9).scene, 1e-14, "", PLENTY)
    with pytest.raises(SceneError, match="collision rate: cannot be measured here"):
        recommend(Benchmark(), thrown().scene, 1e-2, "collision rate", PLENTY)
    with pytest.raises(SceneError, match="--error energie: there is no such error"):
        recommend(Benchmark(), thrown().scene, 1e-2, "energie", PLENTY)
    with pytest.raises(SceneError, match="must be above 0 and below 1"):
        recommend(Benchmark(), thrown().scene, 2.0)


def test_errors_of_a_reference_are_those_of_the_exact_solution():
    """The place on the ellipse at the end, and the size: of a planet and a sun."""
    case = kepler(1e-9)
    found = reference(Start(Benchmark(), case.scene), PLENTY)
    sim = Simulation(case.scene)
    sim.particles.position[:] = found.places[-1]
    sim.steps_done = case.scene.steps
    assert case.truth(sim, found.size) < found.limits["state"] < 1e-12
    assert 5.0 < found.growth < 100.0 and found.part == 1.0


def test_little_time_gives_the_first_part_of_the_run():
    found = reference(Start(Benchmark(), kepler(1e-9).scene), 0.005)
    assert found.part < 1.0 and np.log2(found.part).is_integer() and found.span == pytest.approx(found.part * 4.0 * np.pi)


@pytest.mark.parametrize("seconds", [0.0005, 0.005, PLENTY])
def test_a_slow_machine_measures_the_same(seconds, monkeypatch):
    """How much of the run, and against which reference, is decided by counted work: a clock would decide anew each time."""
    orbit, ball = kepler(1e-9).scene, falling_ball(1.0, 400, 0.01)
    quick = [reference(Start(Benchmark(), scene), 0.1 * seconds if scene is ball else seconds) for scene in (orbit, ball)]
    steps = Simulation.steps

    def slow_steps(self, number):
        sleep(0.003)
        steps(self, number)

    monkeypatch.setattr(Simulation, "steps", slow_steps)
    slow = [reference(Start(Benchmark(), scene), 0.1 * seconds if scene is ball else seconds) for scene in (orbit, ball)]
    for one, other in zip(quick, slow, strict=True):
        assert (one.part, one.reference, one.limits, one.size) == (other.part, other.reference, other.limits, other.size)
        assert one.places.tobytes() == other.places.tobytes()


def test_extrapolation_finds_the_limit_and_knows_how_well():
    def run(h):
        return np.array([1.0 + 0.3 * h**2 + 0.2 * h**4, -2.0 * h**2])

    value, wrong = extrapolated([run(2.0**-k) for k in range(5)])
    assert np.abs(value - [1.0, 0.0]).max() <= wrong < 1e-12

    def kinked(h):
        return np.array([abs(np.sin(1e3 * h)) * h])

    value, wrong = extrapolated([kinked(2.0**-k) for k in range(8)])
    assert abs(value[0]) < 5.0 * wrong  # no smooth expansion: it says so
