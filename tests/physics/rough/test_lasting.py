"""Contacts of rough spheres that last: rolling, sliding, sticking, and rest; against formulas of mechanics."""

from math import atan, cos, sin

import numpy as np
import pytest
from scenes import G, simulation, slope
from with_all import with_all

from particles_mpi.errors import SceneError
from particles_mpi.particles import same_bits

FLOOR = {"point": [0.0] * 3, "normal": [0.0, 0.0, 1.0]}
MODES = (None, "rewind", "event")  # None: walls alone


def run(sim, time):
    for _ in range(round(time / sim.h)):
        sim.step()
    return sim.rows


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("d", "part"), [(2, 0.5), (3, 0.4)])
def test_a_ball_rolls_or_slides_down_an_incline(d, part, mode):
    """g sin/(1 + I/(m R^2)) up to tan = mu (1 + m R^2/I): 7/2 mu for a sphere, 3 mu for a disc; above, g (sin - mu cos)."""
    mu = 0.3
    for tangent in (0.2, 0.99 * mu * (1.0 + 1.0 / part), 1.01 * mu * (1.0 + 1.0 / part), 2.0):
        angle = atan(tangent)
        rolls = tangent < mu * (1.0 + 1.0 / part)
        wanted = G * sin(angle) / (1.0 + part) if rolls else G * (sin(angle) - mu * cos(angle))
        p = run(slope(d, tangent, mu, mode=mode), 0.1)
        assert abs(p.velocity[0, 0] / (0.1 * wanted) - 1.0) <= 1e-6
        assert abs(p.position[0, 0] / (0.005 * wanted) - 1.0) <= 1e-6
        assert abs(p.position[0, -1] - 0.5) <= 1e-12


def test_the_moment_of_inertia_counts():
    """A hoop, I = m R^2, has half of the acceleration of a block."""
    p = run(slope(2, 0.3, 0.5, moment_of_inertia=2.0 * 0.25), 0.1)
    assert abs(p.velocity[0, 0] / (0.05 * G * sin(atan(0.3))) - 1.0) <= 1e-6


@pytest.mark.parametrize("d", [3, *with_all(2)])
def test_a_sliding_ball_starts_to_roll(d):
    """At t = 2 v/(7 mu g) in space, at 5/7 v; what is off in the place falls with the step."""
    part, mu, speed = (0.5 if d == 2 else 0.4), 0.2, 1.0
    final = speed / (1.0 + part)
    begins = (speed - final) / (mu * G)
    exact = 0.5 * (speed + final) * begins + final * (0.5 - begins)
    errors = []
    for step in (0.002, 0.001, 0.0005):
        p = run(slope(d, 0.0, mu, step=step, velocity=[[speed] + [0.0] * (d - 1)]), 0.5)
        assert abs(p.velocity[0, 0] / final - 1.0) <= 1e-10
        errors.append(abs(p.position[0, 0] / exact - 1.0))
    assert errors[1] <= 1e-5 and errors[2] < errors[0]


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("d", "e"), [(2, 0.0), (2, 0.9), (3, 0.9)])
def test_a_spinning_cylinder_in_a_corner(d, e, mode):
    """Friction at the floor is all that presses it onto the wall (I. Irodov, Problems in General Physics, 1.253): it stays, and
    its spin falls at mu (1 + mu)/(1 + mu^2) g R m/I."""
    mu, radius, spin = 0.3, 0.5, 20.0
    planes = [{"point": [0.0] * d, "normal": [float(k == axis) for k in range(d)]} for axis in (0, d - 1)]
    effects = {
        "uniform_gravity": {"acceleration": [0.0] * (d - 1) + [-G]},
        "walls": {"restitution": e, "friction": mu, "planes": planes},
    }
    turning = {"radius": radius, "spin": [spin if d == 2 else [0.0, -spin, 0.0]]}
    ball = {"position": [[radius] + [0.0] * (d - 2) + [radius]]} | turning
    sim = simulation(d, [ball], effects | ({"collisions": {"mode": mode}} if mode else {}), 0.002)
    rate = mu * (1.0 + mu) / (1.0 + mu**2) * G / ((0.5 if d == 2 else 0.4) * radius)
    run(sim, 0.5)
    twin = sim.copy()  # what contacts took goes with it
    for each in (sim, twin):
        p = run(each, 0.5)
        assert abs(np.linalg.norm(p["spin"]) - (spin - rate * sim.time)) <= 1e-9
        assert np.abs(p.velocity).max() <= 1e-12
    assert sim == twin
    p = run(sim, 2.0 * spin / rate - 1.0)
    assert not p["spin"].any() and not p.velocity.any()
    assert np.abs(p.position[0, [0, d - 1]] - radius).max() <= 1e-5


@pytest.mark.parametrize("mode", MODES)
def test_balls_side_by_side_start_to_roll(mode):
    """Each as if it were alone: they have contacts with the floor only, and none of them is asleep."""
    speeds = np.linspace(0.8, 1.2, 60)
    balls = {"position": [[0.0, 1.5 * k, 0.5] for k in range(60)], "velocity": [[v, 0.0, 0.0] for v in speeds], "radius": 0.5}
    law = {"restitution": 0.5, "friction": 0.2}
    effects = {"uniform_gravity": {"acceleration": [0.0, 0.0, -G]}, "walls": law | {"planes": [FLOOR]}}
    effects |= {"collisions": law | {"mode": mode}} if mode else {}
    p = run(simulation(3, [balls], effects, step=0.005), 0.6)
    np.testing.assert_allclose(p.velocity[np.argsort(p.id), 0], speeds / 1.4, rtol=1e-10)


def test_with_back_spin_it_returns():
    """A ball with v and R s = -4 v against it ends at 5/7 v - 2/7 (4 v) = -3/7 v."""
    p = run(slope(3, 0.0, 0.2, velocity=[[1.0, 0.0, 0.0]], spin=[[0.0, -8.0, 0.0]]), 1.0)
    assert abs(p.velocity[0, 0] + 3.0 / 7.0) <= 1e-10
    assert abs(p.spin[0, 1] * 0.5 - p.velocity[0, 0]) <= 1e-10


def test_resistance_to_rolling_stops_a_ball():
    """It slows down by b g/R / (1 + 2/5) until it stands; on a slope with tan < b/R it does not start."""
    b = 0.02
    sim = slope(3, 0.0, 0.5, effects={"rolling": {"resistance": b}}, velocity=[[0.2, 0.0, 0.0]], spin=[[0.0, 0.4, 0.0]])
    slowing = b * G / 0.5 / 1.4
    p = run(sim, 0.3)
    assert abs(p.velocity[0, 0] / (0.2 - 0.3 * slowing) - 1.0) <= 1e-9
    p = run(sim, 0.7)
    assert not p.velocity.any() and not p.spin.any()
    held = run(slope(3, 0.9 * b / 0.5, 0.5, effects={"rolling": {"resistance": b}}), 0.2)
    assert np.abs(held.velocity).max() <= 1e-13
    goes = run(slope(3, 1.1 * b / 0.5, 0.5, effects={"rolling": {"resistance": b}}), 0.2)
    assert goes.velocity[0, 0] > 1e-3


def block(angle, mu, mode):
    """A block: nine spheres in a square that touch, too rough to roll against one another, on an incline."""
    places = [[x + 0.0, y + 0.0, 0.5] for x in range(3) for y in range(3)]
    down = [G * sin(angle), 0.0, -G * cos(angle)]
    plane = {"point": [0, 0, 0], "normal": [0, 0, 1]}
    effects = {
        "uniform_gravity": {"acceleration": down},
        "collisions": {"mode": mode, "restitution": 0.0},
        "walls": {"planes": [plane], "restitution": 0.0, "friction": mu},
    }
    return simulation(3, [{"position": places, "radius": 0.5, "moment_of_inertia": 1e6}], effects, step=0.002)


@pytest.mark.parametrize("mode", ["rewind", "event"])
def test_a_block_slips_where_the_slope_is_mu(mode):
    """Within 0.1 degree on both sides; what slides has the acceleration g (sin - mu cos). A large I keeps it from turning."""
    mu = 0.4
    for more in (-0.1, 0.1):
        angle = atan(mu) + np.radians(more)
        p = run(block(angle, mu, mode), 0.2)
        if more < 0.0:
            assert np.abs(p.velocity[:, 0]).max() <= 1e-4 * G * 0.2
        else:
            wanted = 0.2 * G * (sin(angle) - mu * cos(angle))
            assert np.abs(p.velocity[:, 0] / wanted - 1.0).max() <= 1e-3


def test_a_ball_in_a_groove_rolls_with_its_smaller_radius():
    """Between two planes at +-45 degrees it rolls on arms R cos 45: a = g sin/(1 + 2/5/cos^2 45) = g sin/1.8."""
    angle, s = atan(0.2), 0.5**0.5
    down = [G * sin(angle), 0.0, -G * cos(angle)]
    planes = [{"point": [0, 0, 0], "normal": [0, side * s, s]} for side in (1, -1)]
    effects = {"uniform_gravity": {"acceleration": down}, "walls": {"planes": planes, "restitution": 0.5, "friction": 0.6}}
    sim = simulation(3, [{"position": [[0, 0, 0.5 / s]], "radius": 0.5}], effects, step=0.001)
    p = run(sim, 0.2)
    assert abs(p.velocity[0, 0] / (0.2 * G * sin(angle) / 1.8) - 1.0) <= 1e-6


@pytest.mark.parametrize(("mu", "stands"), [(0.2, False), (0.35, True)])
def test_three_cylinders_stand_only_with_friction(mu, stands):
    """Two discs on a floor bear a third: they stay if mu >= tan(angle/2), the angle from the vertical being 30 degrees: 0.268."""
    effects = {
        "uniform_gravity": {"acceleration": [0.0, -G]},
        "collisions": {"mode": "event", "restitution": 0.0, "friction": mu},
        "walls": {"planes": [{"point": [0, 0], "normal": [0, 1]}], "restitution": 0.0, "friction": mu},
    }
    discs = [{"position": [[-0.5, 0.5], [0.5, 0.5], [0.0, 0.5 + 3**0.5 / 2]], "radius": 0.5}]
    p = run(simulation(2, discs, effects, step=0.002), 0.5)
    top = p.position[p.id == 2][0, 1]
    assert (top > 0.5 + 3**0.5 / 2 - 1e-3) == stands


@pytest.mark.parametrize(("count", "large"), [(100, True), *with_all((100, False), (200, True))])
def test_a_bed_comes_to_rest_and_then_takes_no_work(count, large):
    """With resistance to rolling, K falls to nothing at all; without it only what rolls or spins freely on the floor goes on.

    large: solved to a tolerance, as piles of thousands are.
    """
    grains = [{"count": count, "position": "random", "radius": {"min": 0.045, "max": 0.05}}]
    surfaces = {"restitution": 0.5, "friction": 0.3}
    effects = {
        "uniform_gravity": {"acceleration": [0.0, 0.0, -G]},
        "collisions": {"mode": "event"} | surfaces,
        "walls": surfaces,
        "rolling": {"resistance": 1e-3},
    }
    box = {"lower": [0, 0, 0], "upper": [0.5, 0.5, 1.4], "periodic": [True, True, False]}
    sim = simulation(3, grains, effects, step=0.005, box=box)
    if large:
        sim.persistent.slow.effort = 0
    most, lowest, rise, iterations = 0.0, np.inf, 0.0, []
    for _ in range(700 if count == 100 else 800):  # beds of 200, by four seeds: at rest after 420 to 660
        sim.step()
        row = sim.measure()
        most, lowest = max(most, row["kinetic"]), min(lowest, row["total_energy"])
        rise = max(rise, row["total_energy"] - lowest)
        iterations.append(sim.persistent.slow.solver.iterations)
    assert row["kinetic"] == row["rotational"] == 0.0
    assert iterations[-1] == iterations[-50]
    assert rise <= 1e-5 * most


@pytest.mark.parametrize("field", ["mass", "radius"])
@pytest.mark.parametrize("given", [None, 0.2])
def test_masses_and_radii_that_change_between_two_steps(given, field):
    """A solid sphere stays one; a moment of inertia that was given stays as it is."""
    effects = {"collisions": {"friction": 0.3}}
    more = {} if given is None else {"moment_of_inertia": given}
    tables = {"position": [[0.0, 0.0], [3.0, 0.0]], "radius": [0.5, 0.5], "mass": [1.0, 1.0], **more}
    changed = simulation(2, [tables], effects)
    changed.particles[field][1] = 0.75
    tables[field] = [tables[field][0], 0.75]
    expected = simulation(2, [tables], effects).particles
    assert same_bits(changed.particles.arrays["moment_of_inertia"], expected.arrays["moment_of_inertia"])


def test_a_sphere_that_turns_has_a_moment_of_inertia():
    with pytest.raises(SceneError, match=r"particles\[0\]\.moment_of_inertia: 0 for particle 0"):
        slope(2, 0.3, 0.5, moment_of_inertia=0.0)
