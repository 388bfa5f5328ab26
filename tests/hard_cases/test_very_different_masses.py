"""Heavy spheres on light ones come to rest on them, and stay: iterations alone do not get there."""

import numpy as np
import pytest
from with_all import with_all

from particles_mpi import Scene, Simulation
from particles_mpi.contacts.persistent import solution, solver  # noqa: F401  loaded before tests replace what is in `solver`
from particles_mpi.contacts.persistent.descent import Iteration
from particles_mpi.contacts.persistent.iterations import MOST_ITERATIONS
from particles_mpi.contacts.persistent.problem import EXTRAPOLATED, IMPULSE, Problem

R = 0.3
COLUMNS = {
    "heavy on light": lambda ratio: [1.0, ratio],
    "by turns": lambda ratio: [1.0, ratio] * 3,
    "heavier and heavier": lambda ratio: (ratio ** np.linspace(0.0, 1.0, 6)).tolist(),
    "between heavy ones": lambda ratio: [1.0, ratio**0.5, ratio**-0.5, ratio**0.5, 1.0],
}


def column(d, masses, mode, more, push=0.0, step=0.02):
    surfaces = {"restitution": 0.5} | more
    return Simulation(
        Scene(
            dimension=d,
            box={"lower": [0.0] * d, "upper": [4.0] * (d - 1) + [8.0]},
            time={"step": step, "steps": 1},
            particles=[
                {"position": [[2.0] * (d - 1) + [R + 2.0 * R * k] for k in range(len(masses))], "radius": R, "mass": masses}
            ],
            effects={
                "collisions": surfaces | {"mode": mode},
                "walls": surfaces,
                "uniform_gravity": {"acceleration": [push] * (d - 1) + [-9.81]},
            },
        )
    )


@pytest.mark.parametrize("mode", ["rewind", "event"])
@pytest.mark.parametrize("more", [{}, {"friction": 0.3}], ids=["smooth", "rough"])
@pytest.mark.parametrize("kind", COLUMNS)
@pytest.mark.parametrize("d", [1, 3, *with_all(2)])
@pytest.mark.parametrize("ratio", [1e2, 1e6, 1e12, *with_all(1e4, 1e8)])
def test_a_column_stands_still(ratio, d, kind, more, mode):
    """Speeds are below 1e-8 of what gravity does in two steps; of the light ones between heavy ones, and round-off of what these
    would do to them. None of it is a collision. Rough ones between heavy ones may shift once, by less than errors may be."""
    if d == 1 and more:
        return
    masses = COLUMNS[kind](ratio)
    sim = column(d, masses, mode, more)
    start = sim.particles.position.copy()
    sim.steps(40)
    hits = sim.totals["collisions"]
    sim.steps(20)
    assert sim.totals["collisions"] == hits
    speeds, mass = np.abs(sim.particles.velocity).max(axis=1), np.array(masses)
    shift = 1e-4 if more and kind == "between heavy ones" else 1e-7
    assert np.abs(sim.particles.position - start).max() < shift * R
    assert (speeds <= 1e-8 * 2.0 * 9.81 * 0.02 + 1e-14 * mass.max() / mass).all(), speeds
    assert sim.totals["unconverged"] == 0


@pytest.mark.parametrize(("d", "seed"), [(2, 4), (2, 5), (3, 4), (3, 5)])
def test_what_is_solved_directly_is_what_iterations_lead_to(d, seed, monkeypatch):
    """Velocities of a few spheres that fall, meet and come to rest: there is one solution, whatever the contacts take."""
    random, found = np.random.default_rng(seed), []
    grid = [[0.6 + 1.1 * (k % 4), *[0.8] * (d - 2), 0.6 + 1.1 * (k // 4)] for k in range(8)]
    pile = [{"position": (grid + 0.2 * random.random((8, d))).tolist(), "radius": 0.4, "mass": {"min": 0.5, "max": 2.0}}]
    effects = {"collisions": {"restitution": 0.0}, "walls": {"restitution": 0.0}}
    effects["uniform_gravity"] = {"acceleration": [1.0] * (d - 1) + [-9.81]}
    box = {"lower": [0.0] * d, "upper": [5.0] + [1.6] * (d - 2) + [9.0]}

    def both(axes, problem, w, v):
        iterated = Problem(*(column.copy() for column in problem))
        iterated.table[:, [IMPULSE, EXTRAPOLATED]] = 0.0
        iterated.per_round_off[:] = 1e12  # to round-off, in crowds too
        done = direct(axes, problem, w, v)
        result = Iteration(axes, Problem(*problem), w, v).result
        iteration = Iteration(axes, iterated, w, v)
        good, _ = iteration.until_good(len(iterated.partner), MOST_ITERATIONS)
        found.append((done and good, np.abs(iteration.result - result).max()))
        return done

    direct = solver.solve_directly
    monkeypatch.setattr(solver, "solve_directly", both)
    monkeypatch.setattr(solver, "TRIED", 0)
    Simulation(Scene(dimension=d, box=box, time={"step": 0.01, "steps": 150}, particles=pile, effects=effects)).run()
    done, apart = np.array(found).T
    assert len(found) > 90 and done.all() and apart.max() < 1e-9


def test_contacts_that_depend_on_others_are_solved_directly_too(monkeypatch):
    """A pile in which discs touch more others than carry them: contacts take over from one another, none is iterated."""
    found, direct = [], solver.solve_directly

    def noted(*arguments):
        found.append(direct(*arguments))
        return found[-1]

    monkeypatch.setattr(solver, "solve_directly", noted)
    monkeypatch.setattr(solver, "TRIED", 0)
    places = [[0.3 + 0.6 * i + 0.3 * (row % 2), 0.3 + 0.52 * row] for row in range(4) for i in range(4 - row % 2)]
    effects = {"collisions": {"restitution": 0.3, "allow_overlap": True}, "walls": {"restitution": 0.3}}
    effects["uniform_gravity"] = {"acceleration": [0.0, -9.81]}
    box, discs = {"lower": [0.0, 0.0], "upper": [2.45, 4.0]}, {"position": places, "radius": 0.3, "mass": 1.0}
    Simulation(Scene(dimension=2, box=box, time={"step": 0.01, "steps": 80}, particles=[discs], effects=effects)).run()
    assert len(found) > 60 and all(found)
