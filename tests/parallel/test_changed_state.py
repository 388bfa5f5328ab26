"""What a user changes between two steps counts: going on is the same, to the bit, as a new simulation of that state.

For every field, effect, mode and integrator, on one, two and three ranks, whose results are the same too.
"""

import json
import os
import signal
from contextlib import contextmanager
from functools import cache
from threading import Thread
from time import sleep

import numpy as np
import pytest
from changed_state import KINDS, SCENES, differences
from conftest import run_ranks
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from random_scenes import random_scenes
from with_all import with_all, with_search

from particles_mpi import Scene, SceneError, Simulation
from particles_mpi.errors import StateError
from particles_mpi.measure import snapshot
from particles_mpi.particles import Particles

RANKS = (1, 2, *with_all(3))
TOGETHER = (  # what is changed at once, so that all of it is tried in every scene within seconds
    ("reversed", "radius"),
    ("fixed", "velocity", "position"),
    ("loose", "mass", "swapped", "spin"),
    ("friction", "drag", "acceleration", "g", "G"),
    ("off", "on", "restitution", "time"),
    ("remove", "add", "h", "off"),
    ("met",),
)


def cases():
    """All changes in each scene; in mode event also with space divided between the ranks."""
    for name, tables in SCENES.items():
        after = 2 if name == "adaptive" else 3
        for seed, kinds in enumerate(TOGETHER):
            for divided in (False, True) if name.endswith("event") else (False,):
                changes = [[kind, seed] for kind in kinds]
                yield dict(tables=tables, before=4, changes=changes, after=after, divided=divided)


MORE = [(seed, 80) for seed in range(32, 36)]
assert {kind for kinds in TOGETHER for kind in kinds} == set(KINDS)
CASES = list(cases())
DIVIDED = {n for n, case in enumerate(CASES) if case["divided"]}  # before each the same without


def runs(n, ranks):
    """Does case n run? One rank has nothing to divide; on two, space is divided where it can be, and on more it is both."""
    return not ((ranks == 1 and n in DIVIDED) or (ranks == 2 and n + 1 in DIVIDED))


@contextmanager
def interrupts_of_a_terminal():
    """Ctrl-C raises KeyboardInterrupt: the tests may be a job in the background, which is to ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """results(ranks): what was printed, and {number: arrays} of cases. The first call for a number of ranks runs them."""
    folder = tmp_path_factory.mktemp("changed")

    @cache
    def run(ranks):
        cases = {n: case for n, case in enumerate(CASES) if runs(n, ranks)}
        (folder / "cases.json").write_text(json.dumps(cases))
        done = run_ranks(ranks, "tests/parallel/changed_state.py", folder / "cases.json", folder, timeout=500)
        assert done.returncode == 0, done.stderr[-2000:]
        return done.stdout.splitlines(), {n: dict(np.load(folder / f"{n}.{ranks}.npz")) for n in cases}

    return run


@pytest.mark.parallel
@pytest.mark.parametrize("ranks", RANKS)
def test_changed_is_the_same_as_started_fresh(results, ranks):
    assert results(ranks)[0] == []


@pytest.mark.parallel
@pytest.mark.parametrize("ranks", RANKS[1:])
def test_changed_on_ranks_is_the_same_as_on_one(results, ranks):
    one, many = results(1)[1], results(ranks)[1]
    assert len(many) >= len(one)
    wrong = []
    for n, arrays in many.items():
        alone = one[n - 1 if n in DIVIDED else n]
        wrong += [(n, CASES[n]["changes"], name) for name in alone if alone[name].tobytes() != arrays[name].tobytes()]
    assert not wrong


@pytest.mark.parallel
@pytest.mark.parametrize(
    ("seed", "count", "on_three"), [(31, 9, 4), *with_all((31, 20, 1)), *with_search(*((*one, 1) for one in MORE))]
)
def test_random_scenes_that_are_changed(seed, count, on_three, tmp_path):
    """A copy and a fresh start take the same steps, and so do two ranks, and three for one case of so many; or all refuse it."""
    rng = np.random.default_rng(seed)

    def some_changes():
        return [[KINDS[k], int(rng.integers(99))] for k in rng.integers(0, len(KINDS), rng.integers(1, 5))]

    cases = [
        dict(tables=tables, before=int(rng.integers(9)), changes=some_changes(), after=4, divided=number % 3 == 0)
        for number, (_, tables, _) in enumerate(random_scenes(seed, count))
        if tables["time"]["integrator"] != "adaptive"  # of which a fresh start tries other lengths of steps
    ]
    numbers = {1: range(len(cases)), 2: range(len(cases)), 3: range(0, len(cases), on_three)}
    for ranks, some in numbers.items():
        (tmp_path / "cases.json").write_text(json.dumps({n: cases[n] for n in some}))
        done = run_ranks(ranks, "tests/parallel/changed_state.py", tmp_path / "cases.json", tmp_path, timeout=500)
        assert (done.returncode, done.stdout) == (0, ""), done.stderr[-2000:]
    there = {n for n in numbers[1] if (tmp_path / f"{n}.1.npz").exists()}
    assert len(there) > len(cases) // 2
    for ranks in (2, 3):
        assert {n for n in numbers[ranks] if (tmp_path / f"{n}.{ranks}.npz").exists()} == there & set(numbers[ranks])
        for n in there & set(numbers[ranks]):
            one, many = (np.load(tmp_path / f"{n}.{number}.npz") for number in (1, ranks))
            assert [name for name in one if one[name].tobytes() != many[name].tobytes()] == [], (ranks, cases[n])


@settings(max_examples=100, suppress_health_check=list(HealthCheck))
@given(
    name=st.sampled_from([name for name in SCENES if name != "adaptive"]),
    before=st.integers(0, 8),
    changes=st.lists(st.tuples(st.sampled_from(KINDS), st.integers(0, 99)), min_size=1, max_size=4),
)
def test_any_changes_are_the_same_as_a_fresh_start(name, before, changes):
    assert differences(SCENES[name], before, changes, 3)[1] == []


@pytest.mark.parametrize("mode", ["rewind", "event"])
def test_velocities_reversed_lead_back_to_the_start(mode):
    """50 elastic discs in a box, 20 collisions and back; what is written in the middle of a run counts."""
    discs = {"count": 50, "position": "random", "radius": 0.2, "velocity": {"speed": 1.0}}
    effects = {"collisions": {"mode": mode}, "walls": {}}
    box, time = {"lower": [0, 0], "upper": [10, 10]}, {"step": 0.01, "steps": 1}
    sim = Simulation(Scene(dimension=2, seed=1, box=box, time=time, particles=[discs], effects=effects))
    start = snapshot.gather_all(sim.ranks, sim.particles)
    while sim.totals["collisions"] < 20:
        sim.step()
    sim.particles.velocity *= -1
    for _ in range(sim.steps_done):
        sim.step()
    end = snapshot.gather_all(sim.ranks, sim.particles)
    assert sim.totals["collisions"] >= 40
    assert np.abs(end.position - start.position).max() < 1e-9 and np.abs(end.velocity + start.velocity).max() < 1e-9


def test_work_is_counted_once_however_often_effects_change():
    """Twin simulations, one of which is given the options that it has."""
    sim, twin = (Simulation(Scene.from_dict(SCENES["attracted"])) for _ in range(2))
    for _ in range(4):
        sim.effects["mutual_gravity"].G = 1.0
        sim.effects["walls"].restitution = 0.6
        for one in (sim, twin):
            one.step()
    work, once = sim.work(), twin.work()
    pairs = sim.total**2  # of one sum of forces: one at the start, and one a step; a change asks for another
    assert once["interactions"] == 5 * pairs and work["interactions"] == 8 * pairs and work["events"] == once["events"]
    assert work["pair_tests"] <= 4 * 24 * 23 // 2


def test_arrays_of_an_earlier_step_cannot_be_written_to_unnoticed():
    sim = Simulation(Scene.from_dict(SCENES["elastic"]))
    whole, part = sim.particles.velocity, sim.particles.position[3]
    sim.step()
    with pytest.raises(ValueError, match="read-only"):
        whole *= 2.0
    place = part[0]
    part[0] = 1.0
    with pytest.raises(StateError, match=r"step 2: particles\.position: an array of an earlier step was written to"):
        sim.step()
    part[0] = place  # that step has not begun
    sim.step()
    other = Simulation(Scene.from_dict(SCENES["elastic"]))
    other.steps(2)
    assert sim == other


@pytest.mark.parametrize(
    ("wrong", "error", "says"),
    [
        ("sim.particles.mass[4] = -1.0; sim.step()", StateError, r"particles\.mass: particle 4 on rank 0 was given -1"),
        (
            "sim.particles.radius[2] = float('nan'); sim.step()",
            StateError,
            r"particles\.radius: particle 2 on rank 0 was given nan",
        ),
        (
            "sim.particles.velocity[5, 1] = float('inf'); sim.step()",
            StateError,
            r"step 1: particles\.velocity: particle 5 on rank 0 was given -?[0-9.]+, inf, which",
        ),
        (
            "sim.particles.fixed.view('uint8')[3] = 2; sim.step()",
            StateError,
            r"particles\.fixed: particle 3 on rank 0 was given 2",
        ),
        ("sim.particles.id[0] = 7", ValueError, "read-only"),
        ("sim.particles.charm = 1", AttributeError, "no field 'charm'"),
        ("sim.particles = None", AttributeError, "no setter|can't set"),
        ("sim.effects['walls'].restitution = 2.0", SceneError, r"effects\.walls\.restitution: must be less than or equal to 1"),
        ("sim.effects['walls'].bounce = 2.0", AttributeError, "no option 'bounce'"),
        ("sim.effects['wall'].active = False", KeyError, "the scene has no wall .did you mean 'walls'"),
        ("sim.scene.time.step = 0.5", AttributeError, r"set sim\.h"),
        ("sim.h = 0.0", ValueError, "above 0"),
        ("sim.h = 'a'", ValueError, "h: 'a' is not a step length"),
        ("sim.time = None", ValueError, "time: None is not a finite number"),
        ("sim.dt = 0.1", AttributeError, r"sim\.dt: no such attribute; a script may set sim\.h"),
        ("copy = sim.copy(); copy.mode = 'event'", AttributeError, r"sim\.mode: no such attribute"),
        ("sim.particles.position[1] = 1e3; sim.step()", StateError, r"step 1: particles\.position: particle 1 on rank 0 was put"),
        ("sim.run(steps=3)", TypeError, "run: steps: only with a folder"),
        ("Simulation('x.toml')", TypeError, "'x.toml' is not a Scene; use Scene.load"),
        ("sim.remove(sim.particles.mass > 2.5)", ValueError, r"integers; for a mask use sim\.particles\.id\[mask\]"),
        ("sim.remove([1.7])", ValueError, "takes ids, which are integers"),
        ("sim.remove([-1, 10**9])", ValueError, r"remove: not found: particles -1 and 1000000000"),
        *(
            (
                f"sim.attach({name!r}, sim.particles.mass)",
                ValueError,
                "must be a new name, of letters, digits and _, that begins with a letter",
            )
            for name in ("a/b", "_mine", "")
        ),
    ],
)
def test_what_cannot_be_changed_says_so(wrong, error, says):
    there = {"sim": Simulation(Scene.from_dict(SCENES["elastic"])), "Simulation": Simulation}
    with pytest.raises(error, match=says):
        exec(wrong, there)


def test_a_class_of_the_users_has_what_it_likes():
    class Counted(Simulation):
        def __init__(self, scene):
            super().__init__(scene)
            self.counted = 0

        def step(self, **how):
            super().step(**how)
            self.counted += 1

    sim = Counted(Scene.from_dict(SCENES["elastic"]))
    sim.steps(3)
    assert sim.counted == sim.steps_done == 3


def test_fixed_is_a_mask_of_rows():
    """As whole numbers it would choose the particles 0 and 1, again and again."""
    bodies = {
        "position": [[0.0], [1.0], [2.0], [3.0]],
        "velocity": [[1.0], [1.0], [0.0], [1.0]],
        "fixed": [False, False, True, False],
    }
    sim = Simulation(Scene(dimension=1, time={"step": 0.1, "steps": 3}, particles=[bodies]))
    sim.particles.mass[sim.particles.fixed] *= 7.0
    assert sim.particles.mass.tolist() == [1.0, 1.0, 7.0, 1.0]
    sim.particles.fixed = ~sim.particles.fixed
    before = sim.particles.fixed
    sim.step()
    assert before.tolist() == sim.particles.arrays["fixed"].tolist() == [True, True, False, True]
    held = sim.particles.arrays
    assert held["fixed"].dtype == np.uint8  # as kernels take it, of a new simulation too
    masked = Particles(1, {**held, "fixed": sim.particles.fixed})
    assert Simulation(sim.scene, start=masked).particles.arrays["fixed"].dtype == np.uint8
    assert sim.particles.position.ravel().tolist() == [0.0, 1.0, 2.0, 3.0]  # nobody moves: the third one was at rest


def test_a_look_at_a_field_does_not_undo_a_change_of_an_option():
    bodies = {"position": [[0.0], [1.0]], "velocity": [1.0], "mass": 1.0}
    sim = Simulation(Scene(dimension=1, time={"step": 0.1, "steps": 3}, particles=[bodies], effects={"drag": {"rate": 0.1}}))
    held = sim.particles.drag
    sim.effects["drag"].rate = 5.0
    assert (held == 5.0).all()
    sim.run()
    np.testing.assert_allclose(sim.particles.velocity, np.exp(-1.5), rtol=1e-12)


def test_contacts_that_a_change_made_forgotten_are_not_saved(tmp_path):
    """The run forgets what contacts carried when velocities are changed; so does what is saved before the next step."""
    sim = Simulation(Scene.from_dict(SCENES["heap"]))
    sim.steps(300)
    sim.particles.velocity *= 0.5
    sim.to_json(tmp_path / "state.json")
    other = Simulation.from_json(tmp_path / "state.json")
    for one in (sim, other):
        one.steps(3)
    assert sim == other


@pytest.mark.parametrize("name", ["walls alone", "heap"])
def test_ctrl_c_comes_between_two_steps(name):
    """Of a script or a notebook: what was computed counts, and the clock is that of the state."""
    sim = Simulation(Scene.from_dict(SCENES[name]))
    sim.step()

    def press():
        while sim.steps_done < 3:
            sleep(0.001)
        sleep(0.1)
        os.kill(os.getpid(), signal.SIGINT)

    presser = Thread(target=press, daemon=True)
    with interrupts_of_a_terminal(), pytest.raises(KeyboardInterrupt):
        presser.start()
        sim.steps(10**7)
    presser.join()
    assert sim.steps_done > 1
    if name == "heap":
        other = Simulation(Scene.from_dict(SCENES[name]))
        other.steps(sim.steps_done)
        assert sim == other
    sim.step()


def test_a_step_that_ended_halfway_is_not_gone_on_from(monkeypatch):
    sim = Simulation(Scene.from_dict(SCENES["heap"]))
    monkeypatch.setattr(sim.integrator, "advance", lambda *_: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        sim.step()
    monkeypatch.undo()
    for use in (sim.step, sim.copy, sim.measure):
        with pytest.raises(StateError, match="step 1 ended halfway"):
            use()


def test_a_step_that_was_stopped_is_not_gone_on_from():
    """Two bodies meet head on in the middle of a step of `adaptive`: the third has moved by then, but the clock has not."""
    bodies = {"position": [[0.0, 0.0], [1.0, 0.0], [50.0, 0.0]], "velocity": [[0.0, 0.0], [0.0, 0.0], [0.1, 0.0]], "mass": 1.0}
    time = {"step": 3.0, "steps": 5, "integrator": "adaptive"}
    sim = Simulation(Scene(dimension=2, G=1.0, time=time, particles=[bodies], effects={"mutual_gravity": {}}))
    with pytest.raises(StateError, match=r"step 1: .* softening helps"):
        sim.step()
    for use in (sim.step, sim.copy, sim.measure):
        with pytest.raises(StateError, match="step 1 ended halfway"):
            use()
