"""Bounces are of second order in the step: under every force, on every obstacle, with every loss; some are exact."""

from functools import cache
from itertools import product
from math import log

import numpy as np
import pytest

from particles_mpi import Scene, Simulation
from particles_mpi.study.accuracy.bouncing import DURATION, FORCES, LOSSES, OBSTACLES, bounces, mean_errors, scene

STEPS = 0.01, 0.00125
EXACT = 1e-8  # two that fall alike meet as if nothing pulled: no order is seen in errors of the reference


@cache
def start_and_end(d, force, loss, cases, h):
    """The problems at their start, and at their true end."""
    end = bounces(d, force, loss, cases, h)
    end.advance(np.full(len(end.x), DURATION))
    return bounces(d, force, loss, cases, h), end


def errors(force, mode, h, start, end):
    """Distance of the balls from their true places, the mean over the phases, of each case."""
    tables, shift = scene(force, mode, h, start)
    sim = Simulation(Scene(**tables))
    sim.run()
    return mean_errors(sim, shift, end)


def parameters():
    """All of them; in 3D with losses, where they take seconds, and with damping, only under one force without --all."""
    for dimension, force, loss in product((2, 3), FORCES, LOSSES):
        once = force == FORCES[0] and (dimension == 2 or loss == "e = 0.5")
        tree = force.endswith("tree")  # of so few bodies it sums all pairs, as the direct sum does
        quick = (loss == "e = 1" and not tree) or (dimension == 2 and loss == "e = 0.5") or once
        yield pytest.param(dimension, force, loss, marks=() if quick else pytest.mark.slow)


@pytest.mark.parametrize(("dimension", "force", "loss"), list(parameters()))
def test_bounces_are_of_second_order(dimension, force, loss):
    """A ball a second long, mean over phases of a step: slope 2.0 +- 0.2, at most 3e-4 at h = 0.01; modes do the same."""
    for friction in (False, True):
        cases = tuple(case for case in product(OBSTACLES, ("none", "drag", "friction")) if (case[1] == "friction") == friction)
        problems = [start_and_end(dimension, force.split()[0], loss, cases, h) for h in STEPS]
        found = [errors(force, "rewind", h, *problem) for h, problem in zip(STEPS, problems, strict=True)]
        for case, coarse, fine in zip(cases, *found, strict=True):
            assert coarse <= 3e-4, case
            slope = log(coarse / fine) / log(STEPS[0] / STEPS[1])
            assert slope == pytest.approx(2.0, abs=0.2) or coarse < EXACT, case
        assert errors(force, "event", STEPS[0], *problems[0]) == pytest.approx(found[0], abs=1e-9)


def rough_bounces(h, mode):
    """Places after one hit of rough balls, which friction slows: 16 on a floor, 16 pairs in flight, at various times."""
    k = np.arange(16.0)
    over_floor = {"position": np.column_stack((3.0 * k, 0.4 + 0.013 * k)).tolist(), "velocity": [1.5, -1.0], "spin": 7.0}
    left, right = np.column_stack((4.0 * k, 20.0 + 0.0 * k)), np.column_stack((4.0 * k + 0.5 + 0.011 * k, 20.12 + 0.0 * k))
    pairs = (
        {"position": left.tolist(), "velocity": [1.0, 0.3], "mass": 1.0, "spin": -3.0},
        {"position": right.tolist(), "velocity": [-1.0, -0.2], "mass": 2.5, "spin": 5.0},
    )
    surface = {"restitution": 0.8, "friction": 0.4, "tangential_restitution": 0.3}
    sim = Simulation(
        Scene(
            dimension=2,
            time={"step": h, "end": 0.5},
            particles=[{"radius": 0.1} | population for population in (over_floor, *pairs)],
            effects={
                "uniform_gravity": {"acceleration": [0.0, -2.0]},
                "friction": {"strength": 1.5},
                "collisions": {"mode": mode} | surface,
                "walls": {"planes": [{"point": [0, 0], "normal": [0, 1]}]} | surface,
            },
        )
    )
    sim.run()
    assert (sim.totals["collisions"], sim.totals["wall_hits"]) == (16, 16)
    return sim.particles.position[np.argsort(sim.particles.id)].reshape(3, 16, 2).copy()


@pytest.mark.parametrize("mode", ["rewind", "event"])
def test_rough_bounces_are_of_second_order(mode):
    """With friction, which depends on the speed that a contact leaves: on the floor, and of either partner in flight."""
    true = rough_bounces(1e-4, mode)
    coarse, fine = (np.abs(rough_bounces(h, mode) - true).max(axis=2).mean(axis=1) for h in STEPS)
    np.testing.assert_allclose(np.log(coarse / fine) / log(STEPS[0] / STEPS[1]), 2.0, atol=0.2)


def energies(tables):
    """Largest relative change of the energy from step to step, and the simulation."""
    sim = Simulation(Scene(**tables))
    start, worst = sim.measure()["total_energy"], 0.0
    while sim.steps_done < sim.scene.steps:
        sim.step()
        worst = max(worst, abs(sim.measure()["total_energy"] / start - 1.0))
    return worst, sim


CONSTANT = {
    "uniform_gravity": ({"uniform_gravity": {"acceleration": [0.4, -9.81]}}, {}, {}),
    "user_acceleration": ({"user_acceleration": {}}, {"acceleration": [0.4, -9.81]}, {"acceleration": [-0.3, -7.0]}),
}


@pytest.mark.parametrize("mode", ["rewind", "event"])
@pytest.mark.parametrize("step", [0.05, 0.013, 0.002])
@pytest.mark.parametrize("force", CONSTANT)
def test_elastic_bounces_under_constant_forces_keep_the_energy(force, step, mode):
    """On a floor, a tilted plane, a fixed sphere, and of two free spheres with accelerations of their own."""
    effects, one, other = CONSTANT[force]
    planes = [{"point": [0, 0], "normal": [0, 1]}, {"point": [0, 0], "normal": [1, 1]}, {"point": [8, 0], "normal": [-1, 0]}]
    worst, sim = energies(
        {
            "dimension": 2,
            "time": {"step": step, "end": 2.0},
            "particles": [
                {"position": [[4.0, 0.0]], "radius": 0.7, "fixed": True},
                {"position": [[1.0, 1.5], [3.8, 1.9]], "radius": 0.1, "velocity": [0.7, 0.0], **one},
                {"position": [[1.6, 2.5], [6.0, 2.0], [3.9, 2.6]], "radius": 0.15, "mass": 3.0, "velocity": [-0.7, 0.0], **other},
            ],
            "effects": {**effects, "walls": {"planes": planes}, "collisions": {"mode": mode}},
        }
    )
    assert sim.totals["collisions"] > 2 and sim.totals["wall_hits"] > 5
    assert worst <= 1e-13


def fallen(height, g, friction, e, time):
    """Height after a fall from rest against friction (both per mass), exactly: piece by piece."""
    x, v, left = height, 0.0, time
    while True:
        a = g - friction if v <= 0.0 else g + friction
        lasts = ((v * v + 2.0 * a * x) ** 0.5 + v) / a if v <= 0.0 else v / a
        h = min(lasts, left)
        x, v, left = x + v * h - 0.5 * a * h * h, v - a * h, left - h
        if left <= 0.0:
            return x
        x, v = (0.0, -e * v) if v < -1e-9 else (x, 0.0)


@pytest.mark.parametrize(("loss", "e"), [({}, 1.0), ({"restitution": 0.5}, 0.5), ({"damping": 0.5}, 0.5**0.5)])
def test_a_fall_from_rest_against_friction_is_of_second_order(loss, e):
    """At rest and at the top of a bounce friction turns round within a step."""
    for h in STEPS:
        heights = 0.9 + 0.021 * np.arange(5)
        sim = Simulation(
            Scene(
                dimension=2,
                time={"step": h, "end": DURATION},
                particles=[{"position": [[k, 0.1 + height] for k, height in enumerate(heights)], "radius": 0.1}],
                effects={
                    "uniform_gravity": {"acceleration": [0.0, -9.81]},
                    "friction": {"strength": 1.5},
                    "walls": {"planes": [{"point": [0, 0], "normal": [0, 1]}], **loss},
                },
            )
        )
        sim.run()
        true = [fallen(height, 9.81, 1.5, e, DURATION) for height in heights]
        assert np.abs(sim.particles.position[:, 1] - 0.1 - true).max() <= 3.0 * h**2


def test_a_ball_in_thick_oil_does_not_jump_off_the_floor():
    """k h = 20: at the contact it has its terminal speed g/k, and cannot leave by more than a few times that in a step."""
    sim = Simulation(
        Scene(
            dimension=2,
            time={"step": 0.1, "steps": 40},
            particles=[{"position": [[0.0, 0.2]], "radius": 0.1}],
            effects={
                "uniform_gravity": {"acceleration": [0.0, -10.0]},
                "drag": {"rate": 200.0},
                "walls": {"planes": [{"point": [0, 0], "normal": [0, 1]}]},
            },
        )
    )
    heights = []
    for _ in range(40):
        sim.step()
        heights.append(sim.particles.position[0, 1] - 0.1)
    assert sim.totals["wall_hits"] > 1
    assert max(heights[25:]) <= 5.0 * 10.0 / 200.0 * sim.h
