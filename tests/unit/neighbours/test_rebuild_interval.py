"""For how many steps a search is made to hold: the cheapest number, also where some searches end before that."""

import numpy as np
import pytest

from particles_mpi import Scene, Simulation
from particles_mpi.neighbours.rebuild_interval import RebuildTuner

BEST = 12  # steps


def work(rows, made_for, lasted):
    """Of a search: its own part, the candidates that grow with the time they are made for, and what each step takes."""
    return rows * (BEST**2 + made_for**2 + 10.0 * lasted)


@pytest.mark.parametrize("early", [0.0, 0.1, 0.3])
def test_the_cheapest_number_is_found(early):
    """A share `early` of the searches ends anywhere before its time, because a row got too far."""
    random, tuner, steps = np.random.default_rng(3), RebuildTuner(), []
    cost = 0.0
    for _ in range(200):
        made_for = tuner.next(cost, 5.0)
        steps.append(made_for)
        lasted = int(random.integers(1, made_for + 1)) if random.random() < early else made_for
        for _ in range(lasted):
            tuner.step(0)
        cost = work(1e5, made_for, lasted)
    settled = np.array(steps[50:])
    assert abs(settled.mean() - BEST) < 0.25 * BEST
    assert settled.min() > 1


def test_searches_that_never_last_get_shorter_and_then_longer_again():
    """Where none lasts more than two steps, none is made for many more: ghosts and candidates would be for nothing."""
    tuner, steps = RebuildTuner(), []
    for number in range(200):
        most = 2 if number < 60 else 400
        steps.append(tuner.next(work(1e5, tuner.steps, min(tuner.steps, most)), 200.0))
        for _ in range(min(steps[-1], most)):
            tuner.step(0)
    assert max(steps[8:60]) <= 20 and max(steps[20:60]) <= 3
    assert abs(np.mean(steps[100:]) - BEST) < 0.25 * BEST


def test_steps_in_order_of_time_count():
    """Discs that fall on one another without bouncing: most steps are done in order of time, after which all is sought anew."""
    lossy = {"restitution": 0.0}
    sim = Simulation(
        Scene(
            dimension=2,
            seed=1,
            box={"lower": [0.0, 0.0], "upper": [1.5, 4.0]},
            time={"step": 0.01, "steps": 80},
            particles=[{"count": 150, "position": "random", "radius": {"min": 0.03, "max": 0.05}}],
            effects={"uniform_gravity": {"acceleration": [0.0, -9.81]}, "collisions": lossy, "walls": lossy},
        )
    )
    sim.steps(5)
    assert sim.near.tuner.steps > 100  # they begin at rest
    sim.steps(75)
    assert sim.near.searches > 40 and sim.near.tuner.steps < 10
