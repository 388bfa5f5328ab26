"""Drag of what other things hold: contacts push through the whole kick, as forces do, and drag acts on what they give."""

import numpy as np
import pytest
from with_all import with_all

from particles_mpi import Scene, Simulation


def pushed(mode, h, masses, rates, duration):
    """Velocities of two spheres, of which the last one is pulled against the other by a force of 2."""
    row = {"position": [[0.2], [0.0]], "radius": 0.1, "mass": masses, "drag": rates, "acceleration": [[0.0], [2.0 / masses[1]]]}
    effects = {"user_acceleration": {}, "drag": {}, "collisions": {"mode": mode, "restitution": 0.5}}
    sim = Simulation(Scene(dimension=1, time={"step": h, "end": duration}, particles=[row], effects=effects))
    sim.run()
    return sim.particles.velocity.ravel()


@pytest.mark.parametrize("mode", ["event", "rewind"])
@pytest.mark.parametrize("masses, rates", [([1.0, 2.0], [2.0, 0.0]), ([2.0, 0.5], [0.5, 1.0])])
@pytest.mark.parametrize("h", [0.2, 1.0, *with_all(0.01)])
def test_the_final_speed_is_exact_at_any_step(mode, masses, rates, h):
    """F = v sum(k m), with k h from 0 to 2."""
    speed = 2.0 / np.dot(masses, rates)
    assert pushed(mode, h, masses, rates, max(30.0, 60.0 * h)) == pytest.approx(speed, rel=1e-7)


@pytest.mark.parametrize("mode", ["event", "rewind"])
def test_the_way_there_is_of_second_order(mode):
    """The pair moves as one of its mass and its drag: v = 1 - exp(-2 t/3)."""
    errors = [np.abs(pushed(mode, h, [1.0, 2.0], [2.0, 0.0], 2.0) - 1.0 + np.exp(-4.0 / 3.0)).max() for h in (0.04, 0.02, 0.01)]
    assert errors[0] < 2e-5 and errors[1] / errors[2] == pytest.approx(4.0, rel=0.1)


@pytest.mark.parametrize("mode", [None, "event", "rewind"])
def test_a_ball_that_rolls_with_drag_is_of_second_order(mode):
    """A disc has half of its mass more for a force along the ground, which drag does not act on: dv/dt = 2/3 (a - k v)."""
    effects = {
        "uniform_gravity": {"acceleration": [0.5, -5.0]},
        "drag": {"rate": 0.8},
        "walls": {"restitution": 0.3, "friction": 2.0, "planes": [{"point": [0.0, 0.0], "normal": [0.0, 1.0]}]},
    } | ({"collisions": {"mode": mode, "restitution": 0.3}} if mode else {})
    ball = {"position": [[0.0, 0.1]], "radius": 0.1, "mass": 1.5}
    k, a, t, errors = 0.8 / 1.5, 0.5 / 1.5, 3.0, []
    for h in (0.04, 0.02, 0.01):
        sim = Simulation(Scene(dimension=2, time={"step": h, "end": t}, particles=[ball], effects=effects))
        sim.run()
        errors.append(abs(sim.particles.position[0, 0] - a / k * (t + np.expm1(-k * t) / k)))
    assert errors[0] < 3e-5 and errors[1] / errors[2] == pytest.approx(4.0, rel=0.1)


@pytest.mark.parametrize("mode", ["event", "rewind"])
@pytest.mark.parametrize(
    "surface", [{"restitution": 0.0}, {"restitution": 0.4, "friction": 0.3}, *with_all({"restitution": 0.4})]
)
@pytest.mark.parametrize("h", [0.1, *with_all(0.01)])
def test_two_that_sink_together_have_their_common_final_speed(h, surface, mode):
    """Nothing but drag presses the upper one, which it slows less, onto the lower one: (m1 + m2) g = (k1 m1 + k2 m2) v."""
    masses, rates, g = [1.0, 3.0], [5.0, 0.5], 10.0
    row = {"position": [[0.0, 0.0], [0.0, 0.25]], "radius": 0.1, "mass": masses, "drag": rates}
    effects = {"uniform_gravity": {"acceleration": [0.0, -g]}, "drag": {}, "collisions": {"mode": mode, **surface}}
    sim = Simulation(Scene(dimension=2, time={"step": h, "end": 20.0}, particles=[row], effects=effects))
    sim.run()
    assert sim.particles.velocity[:, 1] == pytest.approx(-g * sum(masses) / np.dot(masses, rates), rel=1e-7)


@pytest.mark.parametrize("walls", [{}, {"walls": {"planes": [{"point": [0, -1e4], "normal": [0, 1]}], "restitution": 0.5}}])
def test_free_elastic_spheres_that_drag_presses_together_bounce(walls):
    """Whether or not there is a wall that takes energy, far below."""
    row = {"position": [[0.0, 0.0], [0.0, 0.25]], "radius": 0.1, "mass": [1.0, 3.0], "drag": [5.0, 0.5]}
    effects = {"uniform_gravity": {"acceleration": [0.0, -10.0]}, "drag": {}, "collisions": {"mode": "event"}} | walls
    sim = Simulation(Scene(dimension=2, time={"step": 0.02, "end": 3.0}, particles=[row], effects=effects))
    sim.run()
    assert sim.particles.velocity[:, 1] == pytest.approx([-5.903527134, -6.181512876], rel=1e-8)


def test_drag_holds_a_pair_whatever_pulls_elsewhere():
    """Two that drag presses together, and a third one a hundred lengths away, with a large acceleration of its own."""
    row = {"position": [[0.0, 0.0], [0.0, 1.0], [100.0, 0.0]], "velocity": [[0.0, -5.0], [0.0, -5.0], [0.0, 0.0]], "radius": 0.5}
    row |= {"mass": 1.0, "drag": [1.0, 0.1, 1.0], "acceleration": [[0.0, 0.0], [0.0, 0.0], [60.0, 0.0]]}
    effects = {"user_acceleration": {}, "drag": {}, "collisions": {"mode": "event", "restitution": 0.0}}
    sim = Simulation(Scene(dimension=2, time={"step": 0.01, "steps": 10}, effects=effects, particles=[row]))
    sim.steps(10)
    speeds = sim.particles.velocity[np.argsort(sim.particles.id), 1]
    assert abs(speeds[1] - speeds[0]) < 1e-12 and sim.totals["collisions"] == 0
