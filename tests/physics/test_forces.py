"""Forces, drag and friction against exact solutions; the order of the splitting; PBPhys's printed figures."""

import csv
from itertools import pairwise
from math import exp, log2
from pathlib import Path

import numpy as np
import pytest

from particles_mpi import Scene, Simulation
from particles_mpi.kernels.sliding import kick_with_friction

FIGURES = Path(__file__).parent / "figures"


def single(step, end, velocity, effects, integrator="leapfrog", **population):
    """(position, velocity) at `end` of one particle that starts at the origin."""
    scene = Scene(
        dimension=len(velocity),
        time={"step": step, "end": end, "integrator": integrator},
        particles=[{"position": [[0.0] * len(velocity)], "velocity": velocity, "mass": 1.0, **population}],
        effects=effects,
    )
    sim = Simulation(scene)
    sim.run()
    return sim.particles.position[0], sim.particles.velocity[0]


def order(error):
    """Observed order from errors at h, h/2."""
    return log2(error[0] / error[1])


@pytest.mark.parametrize("step", [0.7, 0.1, 0.013])
def test_friction_stops_at_the_exact_distance_and_stays(step):
    """m v0^2 / (2 alpha), at every step; v is exactly 0 afterwards."""
    x, v = single(step, 30.0, [3.0, 4.0], {"friction": {"strength": 0.5}}, mass=2.0)
    assert np.abs(x - np.array([0.6, 0.8]) * 2.0 * 25.0 / (2 * 0.5)).max() <= 1e-12 * 50
    assert v.tolist() == [0.0, 0.0]


def test_friction_at_rest_stays_at_rest_under_a_weak_force():
    """|F| <= alpha: displacement exactly 0. The course code gives NaN."""
    x, v = single(
        0.1, 5.0, [0.0, 0.0], {"friction": {"strength": 2.0}, "uniform_gravity": {"acceleration": [0.5, -0.9]}}, mass=1.5
    )
    assert x.tolist() == [0.0, 0.0] and v.tolist() == [0.0, 0.0]


@pytest.mark.parametrize("ratio", [0.3, 0.55, 0.8, 0.99])
@pytest.mark.parametrize("angle", [0.0, 1.0, 2.5, np.pi])
@pytest.mark.parametrize("drag", [False, True])
def test_friction_that_is_stronger_than_the_force_stops_at_the_exact_time(ratio, angle, drag):
    """d/dt (b |v| + v.a) = a^2 - b^2, so v is 0 from t = (b |v| + v.a)/(b^2 - a^2) on, and not before; at any step."""
    a, b, v = ratio * np.array([np.cos(angle), np.sin(angle)]), 1.0, np.array([2.0, 0.0])
    stop = (b * 2.0 + v @ a) / (b**2 - a @ a)
    effects = {"friction": {"strength": b}, "uniform_gravity": {"acceleration": a.tolist()}}
    effects |= {"drag": {"rate": 1e-9}} if drag else {}
    for steps in (7, 50, 400):
        h = stop / (steps + 0.4)
        scene = Scene(
            dimension=2,
            time={"step": h, "steps": 2 * steps},
            particles=[{"position": [[0.0, 0.0]], "velocity": v.tolist()}],
            effects=effects,
        )
        sim, speed = Simulation(scene), []
        for _ in range(2 * steps):
            sim.step()
            speed.append(float(np.linalg.norm(sim.particles.velocity)))
        moving = np.count_nonzero(speed)
        assert abs(moving - steps) <= (1 if steps > 7 else 2) and not any(speed[moving:])


def test_friction_and_a_force_near_a_standstill_are_exact():
    """b |v| + v.a falls at the rate b^2 - a^2 as long as it moves: one kick, for forces of any direction and size."""
    rng, moved = np.random.default_rng(0), 0
    for _ in range(3000):
        d, b, h = rng.integers(1, 4), 10.0 ** rng.uniform(-3, 3), 10.0 ** rng.uniform(-3, 3)
        near = 10.0 ** rng.uniform(-15, -1)
        along = rng.normal(size=d)
        a = b * rng.choice([rng.uniform(0.0, 3.0), 1.0, 1.0 + near, 1.0 - near]) * along / np.linalg.norm(along)
        v = rng.choice([rng.normal(size=d), a / b, -a / b, 0.0 * a]) * 10.0 ** rng.uniform(-3, 3)
        after = v[None, :].copy()
        kick_with_friction(after, a[None, :], np.ones(1), np.ones(1), np.full(1, h), b, h, 0.0)
        size, pull = np.linalg.norm(v), np.linalg.norm(a)
        before, left = b * size + v @ a - (b * b - a @ a) * h, b * np.linalg.norm(after) + after[0] @ a
        scale = b * size + (b * b + a @ a) * h
        if after.any() and size < 8.0 * (b + pull) * h:
            moved += 1
            assert left == pytest.approx(before, abs=1e-12 * scale)
        elif not after.any():
            assert before <= 1e-12 * scale and b >= pull * (1.0 - 1e-15)
    assert moved > 1000


def test_friction_with_gravity_reaches_half_the_launch_speed():
    """alpha = m g, horizontal launch: terminal speed v0/2; second order in the step."""
    effects = {"friction": {"strength": 9.81}, "uniform_gravity": {"acceleration": [0.0, -9.81]}}
    _, v = single(0.001, 6.0, [5.0, 0.0], effects)
    assert np.hypot(*v) == pytest.approx(2.5, abs=1e-5)
    fine = single(0.25 / 64, 1.0, [5.0, 0.0], effects)[0]
    errors = [np.abs(single(h, 1.0, [5.0, 0.0], effects)[0] - fine).max() for h in (0.03125, 0.015625)]
    assert order(errors) == pytest.approx(2.0, abs=0.15)


def test_drag_is_exact_in_velocity_and_second_order_in_position():
    """reference/: k = 0.5, g = 9.81, v0 = (10, 10), t = 2."""
    effects = {"drag": {"rate": 0.5}, "uniform_gravity": {"acceleration": [0.0, -9.81]}}
    exact_x = np.array([12.642411176571, -1.793178094996])
    exact_v = np.array([10.0 * exp(-1.0), (10.0 + 19.62) * exp(-1.0) - 19.62])
    errors = []
    for step in (0.02, 0.01):
        x, v = single(step, 2.0, [10.0, 10.0], effects)
        assert np.abs(v - exact_v).max() <= 1e-12
        errors.append(np.abs(x - exact_x).max())
    assert order(errors) == pytest.approx(2.0, abs=0.05)


def test_strong_drag_decays_monotonically():
    """k dt = 10: an explicit rule explodes."""
    scene = Scene(
        dimension=1,
        time={"step": 1.0, "steps": 1},
        particles=[{"position": [[0.0]], "velocity": [7.0]}],
        effects={"drag": {"rate": 10.0}, "uniform_gravity": {"acceleration": [-10.0]}},
    )
    sim = Simulation(scene)
    speeds = [7.0]
    for _ in range(8):
        sim.step()
        speeds.append(float(sim.particles.velocity[0, 0]))
    assert all(b <= a for a, b in pairwise(speeds)) and speeds[-1] == pytest.approx(-1.0, abs=1e-12)


@pytest.mark.parametrize("mode", ["rewind", "event"])
def test_drag_to_a_standstill_goes_through_the_smallest_numbers(mode):
    """exp(-34) of the velocity is left after a step; speeds are below the least number in the end, their squares halfway."""
    discs = {"count": 20, "position": "random", "radius": 0.2, "velocity": {"speed": 0.01}}
    tables = {
        "dimension": 2,
        "box": {"lower": [0, 0], "upper": [10, 10]},
        "time": {"step": 1.0, "steps": 30},
        "particles": [discs],
        "effects": {"drag": {"rate": 34.0}, "collisions": {"mode": mode}, "walls": {}},
        "output": {"observables": True},
    }
    sim = Simulation(Scene.from_dict(tables))
    speeds = []
    for _ in range(30):
        sim.step()
        sim.measure()
        speeds.append(np.abs(sim.particles.velocity).max())
    assert any(0.0 < speed < 1e-308 for speed in speeds) and speeds[-1] == 0.0


def test_leapfrog_parabola_is_exact():
    x, v = single(0.1, 2.0, [1.0, 2.0], {"uniform_gravity": {"acceleration": [0.0, -9.80665]}})
    assert np.abs(x - [2.0, 4.0 - 2.0 * 9.80665]).max() <= 1e-12 and np.abs(v - [1.0, 2.0 - 19.6133]).max() <= 1e-12


def test_user_acceleration_stays():
    """PBPhys lost it after the first step."""
    x, _ = single(0.1, 1.0, [0.0, 0.0], {"user_acceleration": {}}, acceleration=[1.0, -0.5])
    assert np.abs(x - [0.5, -0.25]).max() <= 1e-14


@pytest.mark.parametrize("drag", [0.0, 0.2])
def test_pbphys_trajectory(drag):
    """All its printed points, to its float32 accuracy."""
    rows = [
        r for r in csv.reader((FIGURES / "pbphys_trajectory.csv").read_text().splitlines()) if not r[0].startswith(("#", "t"))
    ]
    scene = Scene(
        dimension=2,
        time={"step": 0.01, "steps": len(rows), "integrator": "taylor"},
        particles=[{"position": [[0.0, 0.0]], "velocity": [4.0, 4.0], "drag": drag}],
        effects={"drag": {}, "uniform_gravity": {"acceleration": [0.0, -9.80665]}},
    )
    sim = Simulation(scene)
    for row in rows:
        sim.step()
        expected = [float(s) for s in (row[3:5] if drag else row[1:3])]
        assert np.abs(sim.particles.position[0] - expected).max() <= 5e-6


def test_pbphys_steps():
    """Its tests of acceleration, drag and gravity."""
    cases = {
        "accel": ([0.0, 0.0], 0.1, {"user_acceleration": {}}, {"acceleration": [1.0, -0.5]}),
        "accel_drag": ([0.0, 0.0], 0.1, {"user_acceleration": {}, "drag": {"rate": 0.1}}, {"acceleration": [1.0, -0.5]}),
        "down_gravity": ([1.0, 0.5], 0.01, {"uniform_gravity": {"acceleration": [0.0, -9.80665]}}, {}),
    }
    rows = [r for r in csv.reader((FIGURES / "pbphys_steps.csv").read_text().splitlines()) if r[0] in cases]
    assert len(rows) == 30
    for name, number, *expected in rows:
        velocity, step, effects, population = cases[name]
        x, _ = single(step, int(number) * step, velocity, effects, "taylor", **population)
        assert np.abs(x - [float(s) for s in expected]).max() <= 5e-6


def off_after_a_bounce(e, step):
    """Worst relative error of the energy that is left of a fall from about 1 m, for several moments of a step."""
    worst = 0.0
    for height in np.linspace(1.0, 1.1, 7):
        scene = Scene(
            dimension=2,
            box={"lower": [-1.0, 0.0], "upper": [1.0, 3.0]},
            time={"step": step, "end": 0.6},
            particles=[{"position": [[0.0, 0.05 + float(height)]], "radius": 0.05}],
            effects={"uniform_gravity": {"acceleration": [0.0, -9.81]}, "walls": {"restitution": e}},
        )
        sim = Simulation(scene)
        sim.run()
        assert sim.totals["wall_hits"] == 1
        left = sim.measure()["total_energy"] - 9.81 * 0.05
        worst = max(worst, abs(left / (9.81 * height * e * e) - 1.0))
    return worst


@pytest.mark.parametrize("e", [0.9, 0.5])
def test_a_bounce_leaves_e_squared_of_the_energy_to_second_order(e):
    errors = [off_after_a_bounce(e, step) for step in (0.02, 0.01, 0.005, 0.0025)]
    assert errors[0] <= 2e-3
    assert np.log2(errors[0] / errors[-1]) / 3.0 == pytest.approx(2.0, abs=0.1)


def test_an_elastic_bounce_takes_no_energy_at_any_step():
    assert max(off_after_a_bounce(1.0, step) for step in (0.05, 0.013, 0.002)) <= 1e-13
