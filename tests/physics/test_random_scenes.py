"""Scenes at random, with any effects at once: every way to go on from a state takes the same steps, to the bit."""

import numpy as np
import pytest
from random_scenes import random_scenes
from with_all import with_all, with_search

from particles_mpi import Scene, Simulation
from particles_mpi.integrators.length_search import PAST_JUMP
from particles_mpi.timers import Stopwatch

COUNT = 25
OVERLAP, UNTOLD = 1e-9, 1e-6  # of the smaller radius
TOUCHING = 1e-9
FOUR_AXES = with_all((3, 4))
MORE = with_search(*((seed, 4) for seed in range(4, 12)))


@pytest.fixture(autouse=True)
def phases_are_not_nested(monkeypatch):
    """Seconds of a phase within another would be counted twice."""
    running, enter, leave = [], Stopwatch.__enter__, Stopwatch.__exit__

    def begin(phase):
        assert not running, "a phase begins within another"
        running.append(phase)
        enter(phase)

    def end(phase, *error):
        running.pop()
        leave(phase, *error)

    monkeypatch.setattr(Stopwatch, "__enter__", begin)
    monkeypatch.setattr(Stopwatch, "__exit__", end)


@pytest.mark.parametrize(("seed", "axes"), [(26, 3), *FOUR_AXES, *with_search((27, 3), (1, 3), (2, 3)), *MORE])
def test_every_way_on_is_the_same(seed, axes, tmp_path):
    for name, tables, at_once in random_scenes(seed, COUNT, axes):
        assert outside(at_once) == 0, name
        steps = tables["time"]["steps"]
        assert all(np.isfinite(column).all() for key, column in at_once.particles.arrays.items() if key != "contacted"), name
        one_by_one = Simulation(Scene.from_dict(tables))
        for _ in range(steps // 2):
            copy = one_by_one.copy()
            copy.step()
            one_by_one.step()
            assert outside(one_by_one) == 0, (name, one_by_one.steps_done)
            assert copy == one_by_one, (name, one_by_one.steps_done)
        one_by_one.to_json(tmp_path / "half.json")
        others = {"copy": one_by_one.copy(), "JSON": Simulation.from_json(tmp_path / "half.json")}
        stopped = Simulation(Scene.from_dict(tables))
        stopped.run(tmp_path / name, steps=steps // 2, quiet=True)
        others |= {"resumed": Simulation.resume(tmp_path / name / "checkpoint.h5"), "one by one": one_by_one}
        for way, other in others.items():
            other.steps(steps - steps // 2)
            assert other == at_once, (name, way)


@pytest.mark.parametrize(("seed", "axes"), [(2, 3), *FOUR_AXES, *with_search((1, 3)), *MORE])
def test_nothing_overlaps_that_did_not_at_the_start(seed, axes):
    """Whatever moves, slows or presses the spheres, in mode event."""

    def look(sim):
        before = overlaps(sim) > OVERLAP
        for _ in range(sim.scene.steps):
            sim.step()
            assert overlaps(sim)[~before].max(initial=0.0) <= OVERLAP, (sim.scene.to_dict(), sim.steps_done)

    assert len(list(random_scenes(seed, COUNT, axes, "event", look))) == COUNT


@pytest.mark.parametrize(("seed", "axes"), [(2, 3), *FOUR_AXES, *with_search((1, 3)), *MORE])
def test_no_overlap_stays_untold_in_mode_rewind(seed, axes):
    """Where spheres overlap, collisions were missed or came late, or spheres were too fast for the step, and a user is told."""

    def look(sim):
        allowed = np.maximum(overlaps(sim), UNTOLD)
        for _ in range(sim.scene.steps):
            sim.step()
            if (overlaps(sim) > allowed).any():
                told = sim.totals["missed"] or any(word in " ".join(sim.remarks()) for word in ("late", "diameter"))
                assert told, (sim.scene.to_dict(), sim.steps_done)
                break

    assert len(list(random_scenes(seed, COUNT, axes, "rewind", look))) == COUNT


@pytest.mark.parametrize(("seed", "axes"), [(1, 3), *FOUR_AXES, *with_search((2, 3)), *MORE[-3:]])
@pytest.mark.parametrize("mode", ["event", "rewind"])
def test_a_step_to_a_collision_ends_with_it(mode, seed, axes):
    """The two touch; the time gone by is the length of a step that leads everybody to the same places."""
    met = 0
    for name, tables, _ in random_scenes(seed, COUNT, axes, mode):
        sim = Simulation(Scene.from_dict(tables))
        for _ in range(25):
            twin, before, lasting = sim.copy(), sim.time, len(sim.lasting_contacts().id)
            pair = sim.step_to_collision()
            length = sim.time - before
            assert 0.0 <= length <= sim.h * (1.0 + 1e-12), (name, before)
            if not pair:
                continue
            met += 1
            rows = [int(np.flatnonzero(sim.particles.id == member)[0]) for member in pair]
            assert abs(gaps(sim)[tuple(rows)]) <= TOUCHING, (name, before)
            # Contacts that last may be solved in another way in a step that is shorter by round-off.
            if length > PAST_JUMP * sim.h and lasting == len(sim.lasting_contacts().id) == 0:
                twin.h = length * (1.0 - 1e-13)
                twin.step()
                here, there = (one.particles.position[np.argsort(one.particles.id)] for one in (sim, twin))
                apart = np.abs(here - there)
                if sim.scene.box:
                    apart = np.minimum(apart, np.abs(apart - np.subtract(sim.scene.box.upper, sim.scene.box.lower)))
                assert apart.max() <= TOUCHING, (name, before)
    assert met > COUNT


def outside(sim):
    """How many places are outside a periodic box."""
    if sim.scene.box is None:
        return 0
    x, box = sim.particles.position, sim.scene.box
    return int((((x < box.lower) | (x > box.upper)) & np.array(sim.scene.periodic)).sum())


def gaps(sim):
    """Between the surfaces of each pair (i, j) of spheres: (n, n), negative where they overlap."""
    p, box = sim.particles, sim.scene.box
    apart = p.position[:, None] - p.position[None, :]
    if box:
        length = np.subtract(box.upper, box.lower)
        apart -= np.where(box.periodic, length * np.round(apart / length), 0.0)
    return np.sqrt((apart**2).sum(axis=-1)) - p.radius[:, None] - p.radius[None, :]


def overlaps(sim):
    """How deep each pair (i, j) of spheres, not both fixed, is in one another: (n, n), in units of the smaller radius."""
    p, fixed = sim.particles, sim.particles.fixed != 0
    smaller = np.minimum(p.radius[:, None], p.radius[None, :])
    pairs = (smaller > 0.0) & ~(fixed[:, None] & fixed[None, :]) & ~np.eye(len(p), dtype=bool)
    return np.where(pairs, -gaps(sim) / np.where(pairs, smaller, 1.0), 0.0)


@pytest.mark.parametrize("mode", ["rewind", "event"])
@pytest.mark.parametrize("periodic", [True, False])
@pytest.mark.parametrize("effects", [{}, {"uniform_gravity": {"acceleration": [0.0, -3.0]}}])
def test_after_steps_without_collisions_a_copy_goes_on_the_same(effects, periodic, mode):
    """Nothing that was known of neighbours holds after them."""
    discs = {"count": 60, "position": "random", "velocity": {"speed": 4.0}, "radius": 0.15}
    box = {"lower": [0.0, 0.0], "upper": [6.0, 6.0], "periodic": periodic}
    effects = effects | {"collisions": {"mode": mode}} | ({} if periodic else {"walls": {}})
    tables = {"dimension": 2, "time": {"step": 0.02, "steps": 200}, "box": box, "particles": [discs], "effects": effects}
    for seed in range(3):
        sim = Simulation(Scene.from_dict(tables | {"seed": seed}))
        sim.steps(3)
        for _ in range(7):
            sim.step(collisions=False)
        copy = sim.copy()
        for one in (sim, copy):
            one.steps(6)
        assert sim == copy
