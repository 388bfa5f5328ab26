"""Orientations, where a scene asks for them: they follow the spins, and cost nothing where it does not."""

import numpy as np
import pytest
from scenes import simulation, slope

from particles_mpi import Scene, SceneError

FREE = {"collisions": {"mode": "event", "friction": 0.3}}


def test_a_free_sphere_turns_about_its_spin():
    """The quaternion of the angle |s| t about s, for slow and for very fast spins; the angle itself in the plane."""
    for spin in ([0.3, -0.4, 1.2], [300.0, 0.0, 400.0]):
        ball = {"position": [[0.0, 0.0, 0.0]], "radius": 0.5, "spin": [spin]}
        sim = simulation(3, [ball], FREE, step=0.01, output={"orientation": True})
        for _ in range(100):
            sim.step()
        angle, axis = np.linalg.norm(spin), np.array(spin) / np.linalg.norm(spin)
        wanted = np.array([np.cos(0.5 * angle), *(np.sin(0.5 * angle) * axis)])
        assert np.abs(sim.rows.orientation[0] - wanted).max() <= 1e-13 * angle + 1e-14
    disc = simulation(2, [{"position": [[0.0, 0.0]], "radius": 0.5, "spin": 2.0}], FREE, output={"orientation": True})
    for _ in range(100):
        disc.step()
    assert disc.rows.orientation[0, 0] == pytest.approx(2.0, abs=1e-13)


def test_a_rolling_ball_turns_by_its_way():
    sim = slope(2, 0.3, 0.5, output={"orientation": True})
    for _ in range(200):
        sim.step()
    assert sim.rows.orientation[0, 0] * 0.5 == pytest.approx(-sim.rows.position[0, 0], rel=1e-9)


@pytest.mark.parametrize("gravity", [0.0, 2.0])
def test_a_step_to_a_collision_turns_until_then(gravity):
    """A ball comes down on a fixed one after t, and has turned by its spin times t; the hit comes after that."""
    pair = [
        {"position": [[0.0, 0.0]], "radius": 0.5, "fixed": True},
        {"position": [[0.0, 1.5]], "velocity": [0.0, -1.0], "radius": 0.5, "spin": 3.0},
    ]
    effects = FREE | ({"uniform_gravity": {"acceleration": [0.0, -gravity]}} if gravity else {})
    sim = simulation(2, pair, effects, step=0.2, output={"orientation": True})
    while sim.step_to_collision() is None:
        pass
    wanted = (np.sqrt(1.0 + gravity) - 1.0) / gravity if gravity else 0.5
    assert sim.time == pytest.approx(wanted, abs=1e-12)
    assert sim.rows.orientation[sim.rows.id == 1, 0][0] == pytest.approx(3.0 * sim.time, abs=1e-12)
    assert sim.rows["spin"][sim.rows.id == 1, 0][0] != 3.0


def test_each_turns_by_its_own_spin_until_a_collision():
    """Whatever order they are given in, and lie in: three turn freely while two others meet; and again after a change."""
    places = [[5.0, 5.0], [-3.0, 4.0], [4.0, -5.0], [0.0, 0.0], [2.0, 0.0]]
    balls = [
        {"position": [place], "velocity": [float(k == 3), 0.0], "radius": 0.5, "spin": float(k + 1)}
        for k, place in enumerate(places)
    ]
    sim = simulation(2, balls, FREE, step=2.0, output={"orientation": True})
    assert sim.step_to_collision() == (3, 4) and sim.time == pytest.approx(1.0)
    for k in range(5):
        assert sim.rows.orientation[sim.rows.id == k, 0][0] == pytest.approx((k + 1) * sim.time, abs=1e-12)


def test_only_where_a_scene_asks_for_it():
    assert "orientation" not in slope(3, 0.3, 0.5).rows.arrays
    with pytest.raises(SceneError, match=r"output\.orientation: spheres turn only with friction"):
        Scene(dimension=2, time={"step": 0.1, "steps": 1}, particles=[], output={"orientation": True})
