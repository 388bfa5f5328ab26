"""The study's experiments on gravity: errors that are known, in proportions that are known. Times are not looked at."""

import numpy as np
import pytest

from particles_mpi.study.accuracy import softening, tree
from particles_mpi.study.accuracy.command import measure_letter
from particles_mpi.study.experiment import Benchmark, Experiment, Row, Setting, slope
from particles_mpi.study.timing import Seconds


@pytest.fixture(scope="module")
def trees():
    return tree.experiments(Benchmark(quick=True, samples=1))


@pytest.fixture(scope="module")
def softened():
    return measure_letter("F", Benchmark(quick=True, samples=1))


def errors(found, curve, name):
    return np.array([row.errors[name] for row in found.curve(curve)])


def test_quadrupoles_are_closer_than_monopoles_and_small_angles_than_large_ones(trees):
    """The same cells act on the same particles, so that interactions are the same; a smaller angle costs more of them."""
    for found in trees:
        mono, quad = found.curve("monopoles"), found.curve("quadrupoles")
        for a, b in zip(mono, quad, strict=True):
            assert all(b.errors[name] < a.errors[name] for name in tree.ERRORS)
            assert a.work == b.work and a.work["forces"] == 1
        for curve in ("monopoles", "quadrupoles"):
            assert (np.diff(errors(found, curve, "median")) < 0.0).all()
            assert (np.diff([row.work["interactions"] for row in found.curve(curve)]) > 0).all()
    medians = [errors(trees[1], curve, "median") for curve in ("monopoles", "quadrupoles")]
    assert (medians[0] < [1.1e-2, 3.5e-3, 1.5e-3, 6e-4]).all() and (medians[1] < [7.5e-3, 1.6e-3, 4.3e-4, 1.3e-4]).all()


def test_the_reference_of_trees_is_the_direct_sum(trees):
    """Its own error is round-off, and far below that of every tree."""
    for found, n in zip(trees, tree.QUICK_SIZES, strict=True):
        direct = found.curve("direct sum")[0]
        assert direct.work["interactions"] == n * n
        assert 1e-17 < direct.errors["median"] < 3e-15 and found.floor < 1e-14
        assert min(row.errors["median"] for row in found.rows if row is not direct) > 1e9 * direct.errors["median"]
        assert any("by monopoles" in answer for answer in found.answers)
    assert any("costs less than the direct sum" in answer for answer in trees[-1].answers)


def test_errors_are_the_same_bits_every_time(trees):
    again = tree.experiment(Benchmark(quick=True, samples=1), 1, tree.QUICK_SIZES[0])
    assert [row.errors for row in again.rows] == [row.errors for row in trees[0].rows]


def made_up(n, direct, trees):
    """An experiment with these seconds: of the direct sum, and (median error, seconds) of trees."""

    def row(curve, error, seconds):
        setting = Setting(curve, 1.0, lambda: None, 1, lambda sim: {})
        return Row(setting, {"median": error}, {"interactions": int(1e9 * seconds)}, Seconds(seconds, seconds, seconds))

    rows = [row("direct sum", 1e-15, direct), *(row(curve, *pair) for curve in tree.TREE_CURVES.values() for pair in trees)]
    return Experiment(f"D{n}", "", "", tree.ERRORS, "", rows)


def test_costs_and_crossover_lie_between_what_was_measured():
    """Direct ~ N^2, tree ~ N, equal at 3162: straight lines in logarithms."""
    sizes = (1000, 10_000)
    found = [made_up(n, n * n / 3162.2776, [(1e-2, 0.1 * n), (1e-4, 10.0 * n)]) for n in sizes]
    rows = found[0].curve("quadrupoles")
    assert tree.at_error(rows, 1e-3) == pytest.approx(1000.0)
    assert tree.at_error(rows, 0.5) == pytest.approx(100.0)  # the coarsest is better than that
    assert np.isnan(tree.at_error(rows, 1e-5))
    assert tree.crossover(sizes, found, "quadrupoles") == pytest.approx(3162.2776)
    assert tree.crossover(sizes[1:], found[1:], "quadrupoles") == 0.0
    assert tree.crossover(sizes[:1], found[:1], "quadrupoles") == np.inf


def test_softening_of_an_orbit(softened):
    """Errors of the model grow as the square of softening and do not care for steps; numerical ones fall with their square."""
    orbit = softened[0]
    soft = [errors(orbit, curve, "model") for curve in orbit.curves]
    assert all((np.diff(model) == 0.0).all() for model in soft)
    assert soft[0][0] < 1e-13 and orbit.floor < 1e-10
    assert soft[2][0] / soft[1][0] == pytest.approx(100.0, rel=0.05)
    for curve in orbit.curves:
        assert slope(orbit.curve(curve), "numerical") == pytest.approx(2.0, abs=0.05)
        total, model, numerical = (errors(orbit, curve, name) for name in ("total", "model", "numerical"))
        assert (np.abs(model - numerical) <= total * (1 + 1e-9)).all() and (total <= (model + numerical) * (1 + 1e-9)).all()
    point = errors(orbit, "softening 0", "numerical")
    assert (errors(orbit, "softening 0.01", "numerical") < point).all()
    assert "thrown out" in orbit.answers[-1]


def test_softening_of_particles_that_stand_for_a_smooth_sphere(softened):
    """Bias grows, noise falls, and between them is the softening of least error that Athanassoula et al. (2000) found."""
    sphere = softened[1]
    total, bias, noise = (errors(sphere, "direct sum", name) for name in ("total", "model", "numerical"))
    assert (np.diff(bias) > 0.0).all() and (np.diff(noise) < 0.0).all()
    assert np.allclose(total**2, bias**2 + noise**2, rtol=1e-12)
    assert softening.FIELD_SOFTENINGS[np.argmin(total)] == pytest.approx(0.98 * softening.N**-0.26, rel=0.2)


def test_the_smooth_field_is_plummers_and_that_of_a_point_from_afar():
    r = np.array([0.1, 1.0, 5.0])
    np.testing.assert_allclose(softening.smooth_field(r, 1e-3), r * (r * r + 1.0) ** -1.5 / softening.MASS_SHARE, rtol=1e-3)
    assert softening.smooth_field(np.array([1e4]), 5e3)[0] == pytest.approx(1e4 / (1e8 + 2.5e7) ** 1.5, rel=1e-4)


def test_noise_falls_with_the_number_of_particles():
    """As N^(-1/2), with whatever softening."""
    few, many = (softening.fields(n) for n in (1000, 4000))
    for eps in softening.FIELD_SOFTENINGS[1:]:
        assert few[eps]["numerical"] / many[eps]["numerical"] == pytest.approx(2.0, rel=0.1)
        assert few[eps]["model"] == many[eps]["model"]
