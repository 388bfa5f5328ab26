"""The recommended setting reaches the tolerance in truth, and nothing measured that does is much cheaper."""

import numpy as np
import pytest
from recommend_cases import CASES, kepler, thrown

from particles_mpi import Scene, Simulation
from particles_mpi.errors import SceneError
from particles_mpi.study.experiment import Benchmark
from particles_mpi.study.recommend.recommend import recommend
from particles_mpi.study.recommend.reference import extrapolated, reference
from particles_mpi.study.recommend.runs import Start

PLENTY = 300.0  # seconds that measuring may take: none of these comes near it


QUICK = (0, 5, 6)  # of the cases: with others measuring takes seconds


@pytest.mark.parametrize("number", [k if k in QUICK else pytest.param(k, marks=pytest.mark.slow) for k in range(len(CASES))])
def test_its_setting_reaches_the_tolerance_in_truth(number):
    case = CASES[number]()
    found = recommend(Benchmark(quick=True, samples=3), case.scene, case.tolerance, case.error, PLENTY)
    sim = Simulation(Scene.from_dict(found.tables))
    sim.run()
    assert sim.time == pytest.approx(case.scene.steps * case.scene.time.step, rel=1e-12)
    assert case.truth(sim, found.search.metric.size) <= case.tolerance
    reached = [one for one in found.timed if one.errors[found.search.error] <= case.tolerance]
    assert found.best in reached and found.best.timed.median <= 1.2 * min(one.timed.median for one in reached)
    assert found.half[found.search.error] <= case.tolerance and found.difference <= 2.0 * case.tolerance


def test_the_cases_are_nine_and_careless():
    """As they are, those with a state are off by more than their tolerance: there is something to recommend."""
    assert len(CASES) == 9
    for case in (CASES[k]() for k in (0, 1, 3, 5, 6)):
        sim = Simulation(case.scene)
        sim.run()
        assert case.truth(sim, 1.0) > case.tolerance


def test_it_refuses_what_cannot_be_measured():
    with pytest.raises(SceneError, match=r"--tolerance 1e-14 is below what can be measured here: state \d+e-1\d \("):
        recommend(Benchmark(), kepler(1e-9).scene, 1e-14, "", PLENTY)
    with pytest.raises(SceneError, match="collision rate: cannot be measured here"):
        recommend(Benchmark(), thrown().scene, 1e-2, "collision rate", PLENTY)
    with pytest.raises(SceneError, match="must be above 0 and below 1"):
        recommend(Benchmark(), thrown().scene, 2.0)


def test_errors_of_a_reference_are_those_of_the_exact_solution():
    """The place on the ellipse at the end, and the size: of a planet and a sun."""
    case = kepler(1e-9)
    found = reference(Start(Benchmark(), case.scene), PLENTY)
    sim = Simulation(case.scene)
    sim.particles.position[:] = found.places[-1]
    sim.steps_done = case.scene.steps
    assert case.truth(sim, found.size) < found.limits["state"] < 1e-12
    assert 5.0 < found.growth < 100.0 and found.part == 1.0


def test_little_time_gives_the_first_part_of_the_run():
    found = reference(Start(Benchmark(), kepler(1e-9).scene), 0.02)
    assert found.part < 1.0 and np.log2(found.part).is_integer() and found.span == pytest.approx(found.part * 4.0 * np.pi)


def test_extrapolation_finds_the_limit_and_knows_how_well():
    def run(h):
        return np.array([1.0 + 0.3 * h**2 + 0.2 * h**4, -2.0 * h**2])

    value, wrong = extrapolated([run(2.0**-k) for k in range(5)])
    assert np.abs(value - [1.0, 0.0]).max() <= wrong < 1e-12

    def kinked(h):
        return np.array([abs(np.sin(1e3 * h)) * h])

    value, wrong = extrapolated([kinked(2.0**-k) for k in range(8)])
    assert abs(value[0]) < 5.0 * wrong  # no smooth expansion: it says so
