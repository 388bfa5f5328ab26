"""What `check` predicts, against what is published or follows from the order."""

from time import process_time

import numpy as np
import pytest

from particles_mpi import Scene, Simulation
from particles_mpi.run import forecast
from particles_mpi.scene.schema import TOLERANCES
from particles_mpi.study import timing
from particles_mpi.study.experiment import Benchmark
from particles_mpi.study.recommend import predict as predicting
from particles_mpi.study.recommend.lost_collisions import beside_event
from particles_mpi.study.recommend.predict import predict, refined


@pytest.fixture(autouse=True)
def short_trials(monkeypatch):
    """What is told is tested here, and not how well seconds are measured: a tenth of the time is enough.

    How long a step takes decides what is measured at all: here it is 0.1 ms, also where another process had the core meanwhile.
    """
    rehearse = predicting.rehearse
    monkeypatch.setattr(predicting, "rehearse", lambda sim: rehearse(sim)._replace(step=1e-4))
    monkeypatch.setattr(forecast, "MEASURED_SECONDS", 0.1 * forecast.MEASURED_SECONDS)
    monkeypatch.setattr(predicting, "COST_SECONDS", 0.1 * predicting.COST_SECONDS)


def scene(integrator="leapfrog", **effects):
    time = {"step": 0.01, "steps": 200, "integrator": integrator}
    particles = [{"position": [[0.0, 0.0]], "velocity": [4.0, 4.0]}]
    return Scene(
        dimension=2, time=time, particles=particles, effects={"uniform_gravity": {"acceleration": [0, -9.81]}, **effects}
    )


@pytest.mark.parametrize(("integrator", "order"), [("leapfrog", "2.0"), ("taylor", "1.0")])
def test_the_order_of_the_step_is_seen(integrator, order):
    found = predict(Simulation(scene(integrator, drag={"rate": 0.5})), Benchmark())
    (error,) = found.errors
    assert "on 1 rank" in str(found.forecast) and "ms a step" in str(found.forecast)
    assert f"order {order}" in error


@pytest.mark.parametrize("mode", ["rewind", "event"])
def test_what_each_effect_costs_is_told(monkeypatch, mode):
    """Collisions are most of a step here; an effect that is switched off costs nothing, and is not named."""
    box = {"lower": [0.0] * 3, "upper": [9.0] * 3}
    gas = {"count": 200, "position": "random", "velocity": {"temperature": 1.0}, "radius": 0.4, "mass": 1.0}
    effects = {"collisions": {"mode": mode}, "walls": {}, "drag": {"rate": 0.1}, "uniform_gravity": {"acceleration": [0, 0, -1]}}
    effects["uniform_gravity"]["active"] = False
    monkeypatch.setattr(timing, "perf_counter", process_time)  # seconds of this process, not of what runs beside it
    time = {"step": 0.01, "steps": 100}
    sim = Simulation(Scene(dimension=3, box=box, time=time, particles=[gas], effects=effects))
    costs = dict(part.split(maxsplit=1) for part in predict(sim, Benchmark()).costs.split(", "))
    assert costs.keys() == {"collisions", "walls", "drag"}
    assert " ms (" in costs["collisions"]


def test_effects_are_timed_in_runs_that_go_on(monkeypatch):
    """Each has one copy of the run: what is done only at the start of one is no part of a step."""
    begun, begin = [], predicting.without_effect
    monkeypatch.setattr(predicting, "without_effect", lambda sim, name: begun.append(name) or begin(sim, name))
    sim = Simulation(scene(drag={"rate": 0.5}))
    assert "drag" in predicting.costs_of(sim, 1e-6)
    assert sorted(begun) == ["", "drag", "uniform_gravity"]


def test_what_is_exact_is_said_to_be():
    assert "round-off only" in predict(Simulation(scene()), Benchmark()).errors[0]


def test_contacts_and_chaos():
    box = {"lower": [0.0] * 3, "upper": [6.0] * 3, "periodic": True}
    gas = {"count": 120, "position": "random", "velocity": {"temperature": 1.0}, "radius": 0.5, "mass": 1.0}
    told = {}
    for mode in ("rewind", "event"):
        time, effects = {"step": 0.01, "steps": 1000}, {"collisions": {"mode": mode}}
        sim = Simulation(Scene(dimension=3, box=box, time=time, particles=[gas], effects=effects))
        told[mode] = predict(sim, Benchmark()).errors
    assert "compared with mode event" in told["rewind"][0] and "passes 10" in told["rewind"][0]
    assert "contacts are exact in mode event" in told["event"][0]
    assert all("positions mean nothing" in lines[1] for lines in told.values())


@pytest.mark.parametrize(
    ("collisions", "passes", "least", "most"), [(0.3, 1, 0.03, 0.1), (1.0, 1, 0.4, 0.6), (1.0, 10, -0.02, 0.02)]
)
def test_what_rewind_loses_is_measured(collisions, passes, least, most):
    """A fluid at packing 0.30: one round of contacts a step loses half of all where a particle has one collision in a step."""
    side = (1000 * np.pi / 6.0 / 0.30) ** (1.0 / 3.0)
    gas = {"count": 1000, "position": "lattice", "velocity": {"temperature": 1.0}, "radius": 0.5, "mass": 1.0}
    box = {"lower": [0.0] * 3, "upper": [side] * 3, "periodic": True}
    time, effects = {"step": collisions / 10.2, "steps": 64}, {"collisions": {"passes": passes}}
    fluid = Scene(dimension=3, box=box, time=time, particles=[gas], effects=effects)
    found = beside_event(Benchmark(), fluid, 60.0)
    assert found.steps == 64 and least <= 1.0 - found.found / found.exact <= most
    assert ("collisions are lost, about" in str(found)) == (passes == 1)
    assert "not measured" in str(beside_event(Benchmark(), fluid, 0.0))


def test_a_scene_without_steps_or_particles_has_nothing_to_predict():
    empty = Scene(dimension=2, time={"step": 0.1, "steps": 0}, particles=[{"position": [[0.0, 0.0]]}])
    assert predict(Simulation(empty), Benchmark()).errors == ["predicted: nothing happens in this run"]


@pytest.mark.parametrize("tolerance", TOLERANCES)
def test_a_run_at_the_end_of_the_tolerances_is_compared_with_others_within_them(tolerance):
    """With its own one, or one ten times the tightest, and with a tenth of that; past the ends they would be refused."""
    at = scene("adaptive")
    at = at.model_copy(update={"time": at.time.model_copy(update={"tolerance": tolerance})})
    own, tighter = (refined(at, 4, k).time.tolerance for k in range(2))
    assert own == max(tolerance, 10.0 * TOLERANCES[0]) and own / tighter == pytest.approx(10.0)
