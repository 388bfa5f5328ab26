"""Friction of constant magnitude, and velocity flows, of what lies on something: they act along it, for it holds the rest."""

from math import cos, sin
from pathlib import Path

import numpy as np
import pytest
from with_all import with_all

from particles_mpi import Scene, Simulation

G, R = 9.81, 0.3
MODES = (None, "event", "rewind")
OUTSIDE = Path(__file__).parents[1] / "parallel" / "outside"


def sliding(mode, h, tilt, strength, speed, duration):
    """(way along a plane, speed along it, gap) of a smooth ball that starts on it."""
    normal, down = np.array([sin(tilt), cos(tilt)]), np.array([cos(tilt), -sin(tilt)])
    effects = {
        "uniform_gravity": {"acceleration": [0.0, -G]},
        "walls": {"planes": [{"point": [0.0, 0.0], "normal": normal.tolist()}], "restitution": 0.5},
        "friction": {"strength": strength},
    }
    effects |= {"collisions": {"mode": mode, "restitution": 0.5}} if mode else {}
    ball = {"position": [(R * normal).tolist()], "velocity": (speed * down).tolist(), "radius": R}
    sim = Simulation(Scene(dimension=2, time={"step": h, "end": duration}, particles=[ball], effects=effects))
    sim.run()
    x, v = sim.particles.position[0], sim.particles.velocity[0]
    return x @ down, v @ down, x @ normal - R


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("strength", [3.0, 3.5, 6.0, 9.0])
def test_a_ball_on_a_slope_stays_where_friction_is_stronger(mode, strength):
    """m g sin(0.3) = 2.9. What falls in the first step, before the plane is known to hold it, stops at once."""
    for h in (0.02, 0.005):
        way, speed, gap = sliding(mode, h, 0.3, strength, 0.0, 2.0)
        assert abs(speed) < 1e-15 and abs(way) < 30.0 * h * h and abs(gap) < 1e-4 * R


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("tilt", [0.3, *with_all(0.0, -0.3)])
def test_it_stops_after_the_right_way(mode, tilt):
    """v^2/(2 (alpha/m - g sin)), after v/(alpha/m - g sin); errors fall with the step as its square, but for the first step."""
    slowing = 3.5 - G * sin(tilt)
    ways = [sliding(mode, h, tilt, 3.5, 2.0, 2.2 / slowing) for h in (0.02, 0.01, 0.005)]
    assert all(abs(speed) < 1e-15 for _, speed, _ in ways)
    errors = [abs(way - 2.0 / slowing) for way, _, _ in ways]
    assert all(error < limit for error, limit in zip(errors, (0.02, 0.006, 0.004) if tilt > 0.0 else (5e-4, 1.3e-4, 4e-5)))


@pytest.mark.parametrize("mode", MODES)
def test_a_magnetic_field_that_presses_a_charge_onto_a_floor_does_no_work(mode):
    """v x B is along the normal, so that the speed stays 1: of second order in the step, errors 16 times smaller by h/4."""
    errors = []
    for h in (0.02, 0.005):
        effects = {
            "uniform_gravity": {"acceleration": [0.0, 0.0, -G]},
            "magnetic_field": {"file": str(OUTSIDE / "magnetic.py"), "field": [0.0, 4.0, 0.0]},
            "walls": {"planes": [{"point": [0.0, 0.0, 0.0], "normal": [0.0, 0.0, 1.0]}], "restitution": 0.5},
        }
        effects |= {"collisions": {"mode": mode, "restitution": 0.5}} if mode else {}
        ball = {"position": [[0.0, 0.0, R]], "velocity": [1.0, 0.0, 0.0], "radius": R, "charge": 2.0}
        sim = Simulation(Scene(dimension=3, time={"step": h, "end": 4.0}, particles=[ball], effects=effects))
        sim.run()
        assert np.abs(sim.particles.velocity[0, 1:]).max() < 1e-9
        errors.append(abs(sim.particles.velocity[0, 0] - 1.0))
    assert errors[0] < 1e-3 and errors[1] < errors[0] / 12.0


@pytest.mark.parametrize("mode", MODES)
def test_a_ball_that_is_nailed_where_it_lies_stays(mode):
    """What forces and contacts gave it before is not taken from one that is fixed between two steps."""
    effects = {
        "uniform_gravity": {"acceleration": [0.0, -G]},
        "walls": {"planes": [{"point": [0.0, 0.0], "normal": [0.3, 1.0]}], "restitution": 0.5},
        "friction": {"strength": 1.0},
    }
    effects |= {"collisions": {"mode": mode, "restitution": 0.5}} if mode else {}
    ball = {"position": [[0.0, R * np.sqrt(1.09)]], "radius": R}
    sim = Simulation(Scene(dimension=2, time={"step": 0.01, "steps": 100}, particles=[ball], effects=effects))
    sim.steps(10)
    place = sim.particles.position.copy()
    sim.particles.fixed[0] = 1
    for _ in range(5):
        sim.step()
    assert place[0, 0] > 0.005
    assert not sim.particles.velocity.any() and (sim.particles.position == place).all()
