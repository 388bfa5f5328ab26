"""The integrator `adaptive`: its order, its tolerance down to round-off, far from the origin, and where it must stop."""

import numpy as np
import pytest

from particles_mpi import Scene, SceneError, Simulation, StoppedError
from particles_mpi.integrators.collocation import add
from particles_mpi.integrators.shaking import SHAKEN, random_factor, shake
from particles_mpi.particles import Particles
from particles_mpi.scene.schema import TOLERANCES
from particles_mpi.study.accuracy.orbits import PYTHAGOREAN as BODIES
from particles_mpi.study.accuracy.orbits import E, place_on_ellipse
from particles_mpi.study.hard_cases.catalogue import CaseRun
from particles_mpi.study.hard_cases.orbits import encounter

M3 = 3.00429263669639920545, 0.51192523502468586560  # Pythagorean, t = 20, by integrations of 72 and of 34 digits
FAR = [(0.01, 100.0), (1.0, 1e4), (1.0, 1e6)]  # separation of a binary, and place on every axis


def bodies(position, velocity, mass, step, steps, tolerance=None):
    time = {"step": step, "steps": steps, "integrator": "adaptive"} | ({"tolerance": tolerance} if tolerance else {})
    particles = [{"position": position, "velocity": velocity, "mass": mass}]
    return Simulation(Scene(dimension=len(position[0]), G=1.0, time=time, particles=particles, effects={"mutual_gravity": {}}))


def binary(apart, place, steps, orbits, q=0.5):
    """Masses q and 1 - q on a circle, `steps` of the scene an orbit."""
    rate = apart**-1.5
    x = [[place + (1.0 - q) * apart, place], [place - q * apart, place]]
    v = [[0.0, (1.0 - q) * apart * rate], [0.0, -q * apart * rate]]
    return bodies(x, v, [q, 1.0 - q], 2.0 * np.pi / rate / steps, steps * orbits)


@pytest.mark.parametrize("q", [0.5, 1e-3])
@pytest.mark.parametrize(("apart", "place"), FAR)
def test_binaries_far_from_the_origin(apart, place, q):
    """Energy within 1e-9 or what rounding of n positions does by chance, and no crowd of steps: 445, 440 and 315 forces an
    orbit were seen, where the same orbit at the origin takes 670."""
    sim = binary(apart, place, 1, 4, q)
    start = sim.measure()["total_energy"]
    sim.run()
    round_off = 4.0 * np.spacing(place) / apart * np.sqrt(sim.integrator.substeps)
    assert abs(sim.measure()["total_energy"] / start - 1.0) <= max(1e-9, round_off)
    assert sim.calls["mutual_gravity"] < 4 * 700


def test_no_place_is_round_off_for_a_whole_orbit():
    """A binary that coordinates do not resolve is an error and no endless run: separation 1e-4 at 1e6, a million units in the
    last place. They do not meet, and softening would not help: what it is, is told."""
    sim = binary(1e-4, 1e6, 1, 1)
    match = r"positions of 1e\+06 are rounded to 1e-10, which hides the motion of particles 0 and 1, 0\.0001 apart"
    with pytest.raises(StoppedError, match=match):
        sim.run()


@pytest.mark.parametrize("finest", [(1e-5,), pytest.param((1e-5, 1e-7, TOLERANCES[0]), marks=pytest.mark.slow)])
def test_error_falls_with_the_tolerance_until_round_off(finest):
    """Pythagorean problem, after an encounter of 0.0004: round-off of its coordinates, 2e-16 of them in 4e-4, grows to 1e-9."""
    errors = {}
    for tolerance in (TOLERANCES[1], 1e-4, *finest):
        sim = bodies(BODIES["position"], BODIES["velocity"], BODIES["mass"], 0.1, 200, tolerance)
        sim.run()
        errors[tolerance] = float(np.abs(sim.particles.position[0] - M3).max())
    coarse, finer, *fine = errors.values()
    assert 1e-6 < coarse < 1e-4 and finer < 0.01 * coarse and max(fine) < 0.1 * finer
    assert max(fine) < 3e-9


def test_order():
    """One step on an ellipse, from places around the pericentre: its error falls as the 15th power of its length."""
    worst = []
    for h in (0.5, 0.25):
        errors = []
        for t in np.arange(5.0, 6.8, 0.15):
            u = t
            for _ in range(60):
                u -= (u - E * np.sin(u) - t) / (1.0 - E * np.cos(u))
            v = np.array([-np.sin(u), np.sqrt(1.0 - E * E) * np.cos(u)]) / (1.0 - E * np.cos(u))
            sim = bodies([place_on_ellipse(t).tolist(), [0.0, 0.0]], [v.tolist(), [0.0, 0.0]], [0.0, 1.0], h, 1, 1e-3)
            sim.run()
            assert sim.integrator.substeps == 1
            errors.append(np.abs(sim.particles.position[0] - place_on_ellipse(t + h)).max())
        worst.append(max(errors))
    assert np.log2(worst[0] / worst[1]) == pytest.approx(15.0, abs=0.6)


def test_forces_it_takes():
    """No more than before it knew its round-off: 26 343 for two periods of e = 0.999, 9163 for 399 steps of the figure eight."""
    bench = CaseRun(None, 2)
    worst, _ = encounter(bench, "adaptive", 0.0, 2.0, 1)
    assert worst < 1e-11 and bench.built[0].calls["mutual_gravity"] < 0.8 * 26_343
    tables = Scene.load("particles_mpi/scenes/figure_eight.toml").to_dict()
    tables["time"] = {"step": tables["time"]["step"], "steps": 399, "integrator": "adaptive"}
    sim = Simulation(Scene.from_dict(tables))
    sim.run()
    assert sim.calls["mutual_gravity"] < 0.75 * 9163


@pytest.mark.parametrize("place", [0.0, 1e4])
def test_masses_that_meet_head_on_are_named(place):
    """Ids and time: free fall from 2 in the time pi sqrt(8/(8 M)) = pi/sqrt(3), M = 3; a third one looks on."""
    x = [[place + 50.0, 0.0], [place + 1.1, 0.2], [place - 0.9, 0.2]]
    sim = bodies(x, [0.0, 0.0], [0.0, 1.0, 2.0], 0.1, 50)
    match = r"step 19: time.integrator: 0\.01379\d* into the step, steps get shorter than .*: particles 1 and 2 meet, .* apart; "
    with pytest.raises(StoppedError, match=match + "softening"):
        sim.run()
    assert sim.time + 0.0138 == pytest.approx(np.pi / np.sqrt(3.0), abs=1e-4)


def test_nothing_is_kept_between_steps_but_the_state():
    """In the middle of a run, far from the origin, a fresh start from the particles has the same bits; so has a copy."""
    sim = binary(0.01, 100.0, 2, 3)
    for _ in range(3):
        sim.step()
    rows = Particles(2, {name: array.copy() for name, array in sim.particles.arrays.items()})
    others = [Simulation(sim.scene, start=rows), sim.copy()]
    for one in (sim, *others):
        for _ in range(2):
            one.step()
    for other in others:
        assert other.particles.position.tobytes() == sim.particles.position.tobytes()
        assert other.particles.velocity.tobytes() == sim.particles.velocity.tobytes()


def test_tolerances_that_are_refused():
    for tolerance in (0.1 * TOLERANCES[0], 10.0 * TOLERANCES[1]):
        with pytest.raises(SceneError) as error:
            bodies([[0.0]], [0.0], 1.0, 0.1, 1, tolerance)
        assert len(error.value.faults) == 1 and error.value.faults[0].startswith("time.tolerance: must be ")


def test_a_sum_with_what_it_lost():
    """1e16 and 1000 times 0.3: the sum alone would not move."""
    total, lost = np.array([1e16]), np.zeros(1)
    for _ in range(1000):
        add(total, lost, 0.3, 0)
    assert total[0] - 1e16 + lost[0] == pytest.approx(300.0, abs=1e-9)


def test_signs_of_numbers_in_a_row():
    """In [-1, 1), evenly, another set at each try, and no two numbers near one another have much in common."""
    signs, others = (np.array([random_factor(number, attempt) for number in range(30_000)]) for attempt in (7, 8))
    assert signs.min() >= -1.0 and signs.max() < 1.0 and np.abs(signs.reshape(-1, 3).mean(axis=0)).max() < 0.03
    for partner in (others, np.roll(signs, 1), np.roll(signs, 3)):
        assert abs(np.corrcoef(signs, partner)[0, 1]) < 0.05


@pytest.mark.parametrize("spacing", [1.0, 0.1, 2.0**-40])  # the numbers of a lattice end with many zero bits
def test_each_place_is_shaken_by_itself(spacing):
    """By up to SHAKEN units in the last place, evenly and without relation between axes, neighbours and attempts."""
    lattice = 1.0 + spacing * np.indices((20, 20, 20)).reshape(3, -1).T
    shifts = []
    for attempt in (0, 1):
        x = lattice.copy()
        shake(x.reshape(-1), 3, attempt)
        shifts.append((x - lattice) / np.spacing(lattice) / SHAKEN)
    columns = np.column_stack([*shifts, np.roll(shifts[0], 1, axis=0), np.roll(shifts[0], 20, axis=0)])
    assert np.abs(columns).max() <= 1.0 and np.abs(columns.mean(axis=0)).max() < 0.03
    assert np.abs(np.corrcoef(columns.T) - np.eye(12)).max() < 0.06


@pytest.mark.parametrize("place", [0.0, 17.3, 1e3 / 3.0])
def test_two_at_the_same_place_stay_one(place):
    """No force acts between them, so they move as one body of both masses; if they do not start alike, they are what is named."""
    x = [[place] * 3, [place + 1.0, place, place], [place] * 3]
    v = [[0.0] * 3, [0.0, 1.0, 0.0], [0.0] * 3]
    sim, one = bodies(x, v, [0.5, 0.5, 1.5], 0.1, 10), bodies(x[:2], v[:2], [2.0, 0.5], 0.1, 10)
    sim.run()
    one.run()
    assert sim.particles.position[0].tobytes() == sim.particles.position[2].tobytes()
    assert np.abs(sim.particles.position[:2] - one.particles.position).max() < 1e-13 * max(1.0, place)
    v[2] = [0.0, 0.0, 0.5]
    with pytest.raises(StoppedError, match="particles 0 and 2 meet, 0 apart"):
        bodies(x, v, [0.5, 0.5, 1.5], 0.1, 10).run()


def on_hyperbola(anomaly, eccentricity):
    """(place, velocity) with G M = 1 and a semi-major axis of -1, around a mass in the origin; the pericentre has x > 0."""
    e, across = eccentricity, np.sqrt(eccentricity**2 - 1.0)
    x = np.array([e - np.cosh(anomaly), across * np.sinh(anomaly)])
    return x, np.array([-np.sinh(anomaly), across * np.cosh(anomaly)]) / (e * np.cosh(anomaly) - 1.0)


def test_a_close_encounter_in_one_very_long_step():
    """How short a substep may be follows from the motion, not from the length of the step: here 1e16 times as long."""
    e, step, begin = 1.0 + 1e-6, 1e7, -3.0
    x, v = on_hyperbola(begin, e)
    sim = bodies([[0.0, 0.0], x], [[0.0, 0.0], v], [1.0, 0.0], step, 1)
    sim.run()
    mean = e * np.sinh(begin) - begin + step  # Kepler's equation e sinh(H) - H = mean anomaly, by Newton's method
    end = np.arcsinh(mean / e)
    for _ in range(20):
        end -= (e * np.sinh(end) - end - mean) / (e * np.cosh(end) - 1.0)
    assert np.abs(sim.particles.position[1] / on_hyperbola(end, e)[0] - 1.0).max() < 1e-6
