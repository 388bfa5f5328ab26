"""Steps that end with a collision, against PBPhys's printed run and against exact moments."""

from types import SimpleNamespace

import numpy as np
import pytest

from particles_mpi import Scene, SceneError, Simulation
from particles_mpi.between_steps.saved import StepTrial


def scene(d, particles, step, **effects):
    effects.setdefault("collisions", {"mode": "event"})
    return Scene.from_dict({"dimension": d, "time": {"step": step, "steps": 100}, "particles": particles, "effects": effects})


DISCS = [
    {"position": [[0.0, 0.0]], "velocity": [1.0, 1.0], "radius": 0.5, "mass": 1.0},
    {"position": [[0.0, 2.0]], "velocity": [0.5, -0.5], "radius": 0.5, "mass": 1.0},
    {"position": [[2.0, 2.0]], "velocity": [-1.0, -1.0], "radius": 0.5, "mass": 2.0},
]


@pytest.mark.parametrize(("step", "mode"), [(0.01, "event"), (0.3, "event"), (10.0, "event"), (0.01, "rewind"), (0.3, "rewind")])
def test_pbphys_three_discs(step, mode):
    """Its printed run: discs 0 and 2 at t = 0.646447, then 1 and 2 at t = 0.878937."""
    sim = Simulation(scene(2, DISCS, step, collisions={"mode": mode}))
    met = []
    while sim.time < 1.0 and len(met) < 2:
        pair = sim.step_to_collision()
        if pair is not None:
            met.append((pair, sim.time))
    assert [pair for pair, _ in met] == [(0, 2), (1, 2)]
    np.testing.assert_allclose([t for _, t in met], [0.646447, 0.878937], atol=1e-6)
    assert met[0][1] == pytest.approx(1.0 - np.sqrt(2.0) / 4.0, abs=1e-14)
    x = sim.particles.position[np.argsort(sim.particles.id)]
    assert np.linalg.norm(x[1] - x[2]) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("mode", ["event", "rewind"])
@pytest.mark.parametrize("step", [0.05, 1.0])
def test_dropped_on_a_fixed_sphere(step, mode):
    """From rest, a gap of 1 under g = 2: contact at t = 1 with speed 2, whatever the step, since the last one fits."""
    pair = [
        {"position": [[0.0, 0.0]], "radius": 0.5, "mass": 1.0, "fixed": True},
        {"position": [[0.0, 2.0]], "velocity": [0.0, 0.0], "radius": 0.5, "mass": 1.0},
    ]
    effects = {"collisions": {"mode": mode}, "uniform_gravity": {"acceleration": [0.0, -2.0]}}
    sim = Simulation(scene(2, pair, step, **effects))
    pairs = [sim.step_to_collision()]
    while pairs[-1] is None:
        pairs.append(sim.step_to_collision())
    assert pairs[-1] == (0, 1)
    assert sim.time == pytest.approx(1.0, abs=1e-12)
    falling = sim.particles.position[sim.particles.id == 1][0]
    assert falling[1] == pytest.approx(1.0, abs=1e-12)


CLOCK = """
from particles_mpi.effects import Column, EffectOptions, Event, Needs

class Options(EffectOptions):
    pass

class Effect(Event):
    formula = "age = time"
    needs = Needs(columns={"age": Column("float64")}, integrators=("leapfrog",))

    def act(self, particles, h):
        particles["age"][:] += h
        return 0
"""


@pytest.mark.parametrize("gravity", [0.0, 2.0])
def test_events_act_for_the_time_until_then(gravity, tmp_path):
    """A user's event that adds up the time that it is told of, with contacts found at once and by tries that are undone."""
    (tmp_path / "clock.py").write_text(CLOCK)
    effects = {"collisions": {"mode": "event"}, "clock": {"file": "clock.py"}}
    effects |= {"uniform_gravity": {"acceleration": [0.0, -gravity]}} if gravity else {}
    tables = {"dimension": 2, "time": {"step": 0.3, "steps": 100}, "particles": DISCS, "effects": effects}
    sim = Simulation(Scene.from_dict(tables, tmp_path))
    pairs = [sim.step_to_collision() for _ in range(6)]
    assert pairs.count(None) == 4
    np.testing.assert_allclose(sim.particles.age, sim.time, rtol=1e-13)


def test_nobody_to_meet_is_a_whole_step():
    sim = Simulation(scene(1, [{"position": [[0.0], [5.0]], "velocity": [[1.0], [1.0]], "radius": 0.1}], 0.5))
    assert sim.step_to_collision() is None
    assert (sim.steps_done, sim.time) == (1, 0.5)


def test_a_view_looks_after_whole_steps_only():
    seen, sim = [], Simulation(scene(2, DISCS, 0.3))
    sim.views.append(SimpleNamespace(after_step=lambda sim: seen.append(sim.steps_done)))
    found = [sim.step_to_collision() for _ in range(5)]
    assert found.count(None) == sim.steps_done > 1 and seen == list(range(1, sim.steps_done + 1))


@pytest.mark.parametrize("mode", ["event", "rewind"])
def test_a_try_that_is_undone_leaves_no_trace(mode):
    """In a pile: also not in what is known of contacts that last, with which the next solution begins."""
    discs = {"position": [[0.1 + 0.2 * (k % 6) + 0.05 * (k // 6 % 2), 0.1 + 0.19 * (k // 6)] for k in range(30)], "radius": 0.09}
    losses = {"restitution": 0.5, "friction": 0.3}
    effects = {"uniform_gravity": {"acceleration": [0.5, -9.81]}, "walls": losses, "collisions": losses | {"mode": mode}}
    box, time = {"lower": [0.0, 0.0], "upper": [1.3, 3.0]}, {"step": 0.01, "steps": 100}
    sim = Simulation(Scene.from_dict({"dimension": 2, "box": box, "time": time, "particles": [discs], "effects": effects}))
    sim.steps(60)
    twin, kept = sim.copy(), sim.lasting_contacts()
    assert len(kept.id) > 20
    with sim.stepping():
        trial = StepTrial(sim)
        sim.advance(0.7 * sim.h, stop=True)
        trial.undo()
    sim.particles.open()
    for before, after in zip(kept, sim.lasting_contacts(), strict=True):
        np.testing.assert_array_equal(after, before)
    for _ in range(5):
        assert sim == twin and sim.totals == twin.totals
        sim.step()
        twin.step()


def test_needs_collisions():
    sim = Simulation(Scene.from_dict({"dimension": 2, "time": {"step": 0.01, "steps": 100}, "particles": DISCS}))
    with pytest.raises(SceneError, match=r"effects\.collisions: step_to_collision needs it"):
        sim.step_to_collision()
