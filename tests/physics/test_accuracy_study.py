"""The built-in experiments: figures of theory and of reference/, and the same errors to the bit each time."""

import re

import numpy as np
import pytest

from particles_mpi.study.accuracy import fluid, losses, orbits, rough
from particles_mpi.study.accuracy.command import measure_letter
from particles_mpi.study.experiment import Benchmark, slope


@pytest.fixture(scope="module")
def lab():
    return Benchmark(quick=True, samples=1)


def quick(lab):
    """Orbits, drag and friction: what takes no time."""
    return [*measure_letter("A", lab), *losses.throws(lab)]


@pytest.fixture(scope="module")
def found(lab):
    """The quick experiments by key."""
    return {one.key: one for one in quick(lab)}


def test_orders_that_the_study_tells(found):
    """Leapfrog 2.0 +- 0.05, order4 4.0 +- 0.1 (reference/README.md), in the energy and in the place, of both problems."""
    for problem in ("A1", "A2"):
        told = [re.fullmatch(r"(leapfrog|order4): order (\S+) in (energy|place)", line) for line in found[problem].answers]
        orders = {(line[1], line[3]): float(line[2]) for line in told if line}
        for error in ("energy", "place"):
            assert orders["leapfrog", error] == pytest.approx(2.0, abs=0.05)
            assert orders["order4", error] == pytest.approx(4.0, abs=0.1)


def test_short_orbits_are_timed_as_parts_of_long_ones(found):
    """One of a few hundred steps is over before a call from Python is: then ten times more accuracy would cost nothing."""
    stages = {"leapfrog": 1, "order4": 6}
    for row in found["A1"].rows + found["A2"].rows:
        assert row.setting.steps >= 10**6
        if kicks := stages.get(row.setting.curve):  # seconds are those of the run whose errors are told
            assert row.setting.seconds_of * kicks + 1 == row.work["forces"]


def test_order4(lab):
    """With the steps of the full study, errors only."""
    fall = {"position": [[0.5, 0.0], [0.0, 0.0]], "velocity": [[0.0, 3.0**0.5], [0.0, 0.0]], "mass": [0.0, 1.0]}
    errors = []
    for n in (200, 400):
        scene = orbits.gravity(fall, 2 * np.pi / n, 2 * n, "order4")
        errors.append(orbits.worst_energy(lab.simulate(scene), orbits.energy_of_planet))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.1)


def test_the_ellipse_is_that_of_kepler():
    """Where Kepler's equation can be solved by hand: pericentre, apocentre, and u = pi/2."""
    np.testing.assert_allclose(orbits.place_on_ellipse(0.0), (0.5, 0.0), atol=1e-15)
    np.testing.assert_allclose(orbits.place_on_ellipse(np.pi), (-1.5, 0.0), atol=1e-14)
    np.testing.assert_allclose(orbits.place_on_ellipse(20 * np.pi + np.pi / 2 - 0.5), (-0.5, 0.75**0.5), atol=1e-13)


def test_losses(found):
    """reference/README.md: linear drag; leapfrog of second order with the velocity exact, taylor of first order."""
    np.testing.assert_allclose(losses.thrown(0.5)[0], (12.642411176571, -1.793178094996), rtol=1e-12)
    drag = found["G1"]
    assert slope(drag.curve("leapfrog"), "place") == pytest.approx(2.0, abs=0.05)
    assert slope(drag.curve("taylor"), "place") == pytest.approx(1.0, abs=0.05)
    assert max(row.errors["velocity"] for row in drag.curve("leapfrog")) < 1e-12
    # With longer steps the kicks near the slowest speed are exact, and errors smaller than by the rule.
    fine = [row for row in found["G3"].curve("leapfrog") if row.setting.parameter < 0.1]
    assert len(fine) > 1 and slope(fine, "place") == pytest.approx(2.0, abs=0.05)


@pytest.mark.slow
def test_bounces_and_that_they_are_the_same_twice(lab):
    """Of second order, as test_order_of_bounces.py finds by itself."""
    (bounces,), (again,) = (losses.bouncing(lab) for _ in range(2))
    assert [(row.errors, row.work) for row in bounces.rows] == [(row.errors, row.work) for row in again.rows]
    assert all(max(row.errors.values()) <= 0.03 * row.setting.parameter for row in bounces.rows)
    assert all(slope(bounces.curve(curve), "fixed sphere") == pytest.approx(2.0, abs=0.3) for curve in bounces.curves)


def test_sliding_keeps_what_it_should():
    """Friction of the weight: |v| - v_y stays as it is, so it falls at half the speed in the end (reference/README.md)."""
    for t in (0.5, 20.0):
        _, v = losses.sliding(t)
        assert np.hypot(*v) - v[1] == pytest.approx(10.0, abs=1e-10)
    np.testing.assert_allclose(v, (0.0, -5.0), atol=1e-10)


def test_the_same_study_twice(lab, found, monkeypatch):
    monkeypatch.setattr(lab, "time", lambda rows, progress, sample_seconds=None: None)  # times are compared with nothing
    again = {one.key: one for one in quick(lab)}
    for key, one in found.items():
        assert [row.errors for row in one.rows] == [row.errors for row in again[key].rows]
        assert [row.work for row in one.rows] == [row.work for row in again[key].rows]


@pytest.mark.slow
def test_close_encounters(lab):
    (one,) = measure_letter("B", lab)
    fixed = [row.errors["place, t = 10"] for row in one.rows if row.setting.curve != "adaptive"]
    assert min(fixed) > 0.1 and max(row.errors["place, t = 10"] for row in one.curve("adaptive")) < 1e-6


@pytest.mark.parametrize(
    ("density", "z"),
    [(0.2, 1.55361), (0.4, 2.52162), (0.5, 3.26941), (0.6, 4.29498), (0.7, 5.72696), (0.8, 7.77009), (0.9, 10.76274)],
)
def test_equation_of_state(density, z):
    """reference/README.md, the figures of Kolafa, Labik and Malijevsky."""
    assert fluid.compressibility(density * np.pi / 6) == pytest.approx(z, rel=6e-4)


@pytest.mark.parametrize(("moment", "passes", "least"), [(0.1, 10, 0.98), (0.3, 10, 0.98), (1.0, 10, 0.965)])
def test_rewind_against_the_step(lab, moment, passes, least):
    """reference/README.md: (Z - 1)/(Z_ref - 1) at packing 0.30 is 1.00, 1.00, 0.98 at Gamma dt = 0.1, 0.3, 1.0, or better."""
    spheres = fluid.melted(lab, 0.30, 2000)
    rate = fluid.collision_rate(0.30)
    scene = fluid.fluid(0.30, 2000, moment / rate, round(40 / moment), spheres, passes=passes)
    errors = fluid.errors(0.30, lab.simulate(scene))
    assert errors["Z - 1"] < 1.0 - least + 2.0 * errors["noise"]
    assert errors["collision rate"] < 1.0 - least + 2.0 * errors["noise"]


def test_a_ball_that_slides_and_rolls(lab):
    """Second order in place, over all phases of the step in which it begins to roll; the speed is right at any step."""
    (found,) = rough.rolling(lab)
    for curve in found.curves:
        assert slope(found.curve(curve), "place") == pytest.approx(2.0, abs=0.1)
    assert max(row.errors["speed"] for row in found.rows) < 1e-13
