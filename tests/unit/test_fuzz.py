"""Anything in a scene, or in a file that a scene or a resume reads: one line a fault, or a run that stays finite."""

import math
import shutil
import tomllib

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from particles_mpi import Scene, SceneError, Simulation, StoppedError
from particles_mpi.output import checkpoint

VALID = """
dimension = 2
seed = 1
G = 1.0
title = "valid"
[box]
lower = [0, 0]
upper = [2, 3]
periodic = [true, false]
[time]
step = 0.01
steps = 3
integrator = "leapfrog"
[[particles]]
count = 4
position = "random"
velocity = {temperature = 1.0}
radius = 0.1
mass = 1.0
drag = 0.1
acceleration = [0, 1]
fixed = false
[[particles]]
position = [[0.5, 0.5], [1.5, 2.5]]
velocity = [[0, 1], [1, 0]]
radius = [0.05, 0.06]
mass = {min = 1.0, max = 2.0}
[effects.collisions]
mode = "event"
restitution = 0.9
contact_duration = 1e-4
[effects.walls]
restitution = 0.9
[effects.drag]
rate = 0.1
[effects.friction]
strength = 0.01
[effects.user_acceleration]
[effects.uniform_gravity]
acceleration = [0, -1]
[output]
every = 2
formats = ["hdf5"]
checkpoint_every = 2
diagnostics_every = 1
observables = true
"""
odd = [0.0, -0.0, 0.5, -0.5, 1e-9, 1e-300, 5e-324, 1e9, 1e100, 1e300, math.nan, math.inf, -math.inf]
numbers = st.sampled_from([*odd, 0, 1, -1, 2, 3, 2**31, 2**64, 10**30, 10**400])
words = st.sampled_from(
    ["", "random", "lattice", "event", "rewind", "taylor", "order4", "adaptive", "x", "a\nb", "\x00", "none.csv"]
)
plain = st.none() | st.booleans() | numbers | words
keys = st.sampled_from(
    ["min", "max", "speed", "temperature", "file", "plummer", "point", "normal", "planes", "lower", "mode", "?", "\n"]
)
values = st.recursive(plain, lambda v: st.lists(v, max_size=3) | st.dictionaries(keys, v, max_size=2), max_leaves=5)
vectors = st.lists(numbers, min_size=2, max_size=2)
anything = values | vectors | st.lists(vectors, min_size=1, max_size=3)


def places(table, path=()):
    """The way to every key of a scene."""
    for key in table if isinstance(table, dict) else range(len(table)):
        yield (*path, key)
        if isinstance(table[key], dict | list):
            yield from places(table[key], (*path, key))


PLACES = list(places(tomllib.loads(VALID)))


def mutate(draw):
    """A scene with one to three keys taken away, added or given another value."""
    tables = tomllib.loads(VALID)
    for _ in range(draw(st.integers(1, 3))):
        *path, last = draw(st.sampled_from(PLACES))
        place = tables
        try:
            for key in path:
                place = place[key]
            how = draw(st.sampled_from(["set", "set", "set", "scale", "remove", "add"]))
            if how == "remove":
                del place[last]
            elif how == "scale":
                place[last] *= draw(st.sampled_from([-1, 0, 2, 10, 0.1, 1e6]))
            elif how == "add":
                place[draw(st.text(max_size=3))] = draw(plain)
            else:
                place[last] = draw(anything)
        except (KeyError, IndexError, TypeError, OverflowError):
            continue  # that place is gone already
    return tables


def check_faults(error):
    for fault in error.faults:
        assert fault.strip() and len(fault.splitlines()) == 1 and fault.isprintable(), repr(fault)
        assert ": " in fault, fault  # key: what is wrong


def accepted_or_refused(make):
    """A few steps of what is accepted; everything that was wrong must be told properly."""
    try:
        sim = Simulation(make())
        assert all(np.isfinite(a).all() for n, a in sim.particles.arrays.items() if n != "contacted")
        for _ in range(min(sim.scene.steps, 3)):
            sim.step()
        sim.measure()
        assert all(np.isfinite(a).all() for n, a in sim.particles.arrays.items() if n not in ("contacted", "virial"))
    except SceneError as error:
        check_faults(error)
    except StoppedError as error:
        assert len(str(error).splitlines()) == 1


@settings(max_examples=400, suppress_health_check=list(HealthCheck))
@given(st.data())
def test_a_mutated_scene_runs_or_is_refused_in_one_line_a_fault(data):
    tables = mutate(data.draw)
    accepted_or_refused(lambda: Scene.from_dict(tables))


@settings(max_examples=200, suppress_health_check=list(HealthCheck))
@given(
    st.integers(0, len(VALID)), st.integers(0, 3), st.text(max_size=3) | st.sampled_from(["[[", "]", '"', "=", "nan", "1e999"])
)
@example(0, 0, "x = " + "[" * 5000)
@example(0, 0, "x = " + "9" * 5000)
@example(VALID.index("4\nposition"), 1, "0x" + "f" * 5000)
@example(VALID.index("0.9\ncontact"), 3, "0x" + "f" * 5000)
@example(VALID.index("0.01\n"), 4, "0x" + "f" * 5000)
@example(VALID.index("1\nG"), 1, "0x" + "f" * 5000)
def test_mutated_text_is_a_scene_or_one_line_a_fault(tmp_path_factory, at, cut, text):
    path = tmp_path_factory.mktemp("text") / "scene.toml"
    path.write_bytes((VALID[:at] + text + VALID[at + cut :]).encode("utf-8", "replace"))
    accepted_or_refused(lambda: Scene.load(path))


@settings(max_examples=150, suppress_health_check=list(HealthCheck))
@given(st.integers(0, 60), st.integers(0, 5), st.binary(max_size=4))
@example(0, 60, b"\xff\xfe0.5\n")
@example(0, 0, b"\x00")
def test_a_mutated_start_table_is_a_start_or_one_line_a_fault(tmp_path_factory, at, cut, data):
    folder = tmp_path_factory.mktemp("csv")
    whole = b"x,y\n0.25,0.5\n1.25,2.5\n0.75,1.5\n1.75,0.5\n0.6,2.25\n1.2,1.0\n"
    (folder / "a.csv").write_bytes(whole[:at] + data + whole[at + cut :])
    tables = tomllib.loads(VALID)
    tables["particles"] = [{"position": {"file": "a.csv"}, "radius": 0.1}]
    accepted_or_refused(lambda: Scene.from_dict(tables, folder))


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    """The folder of a run that stopped half way."""
    folder = tmp_path_factory.mktemp("stopped") / "o"
    tables = tomllib.loads(VALID)
    tables["time"]["steps"] = 12
    Simulation(Scene.from_dict(tables)).run(folder, steps=6)
    return folder


@pytest.mark.parametrize("name", ["checkpoint.h5", "trajectory.vtkhdf", "diagnostics.csv"])
def test_cut_short_anywhere_is_refused_and_nothing_is_touched(stopped, tmp_path, name):
    folder = tmp_path / "o"
    shutil.copytree(stopped, folder)
    whole = (folder / name).read_bytes()
    others = {path: path.read_bytes() for path in folder.iterdir() if path.name != name}
    for length in {*np.linspace(0, len(whole) - 1, 23).astype(int).tolist(), len(whole) - 2}:
        (folder / name).write_bytes(whole[:length])
        with pytest.raises(SceneError, match=name) as caught:
            Simulation.resume(folder / "checkpoint.h5").run(folder, resumed=True)
        check_faults(caught.value)
        assert (folder / name).read_bytes() == whole[:length]
        assert not [path.name for path, old in others.items() if path.read_bytes() != old]
    (folder / name).write_bytes(whole)
    Simulation.resume(folder / "checkpoint.h5").run(folder, resumed=True)


@settings(max_examples=200, suppress_health_check=list(HealthCheck))
@given(st.data())
def test_a_changed_bit_is_never_read_as_a_state(stopped, data):
    whole = bytearray((stopped / "checkpoint.h5").read_bytes())
    whole[data.draw(st.integers(0, len(whole) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    changed = stopped / "changed.h5"
    changed.write_bytes(whole)
    with pytest.raises(SceneError, match=r"changed\.h5: ") as caught:
        file = checkpoint.Checkpoint(changed)
        file.rows(0, file.total)
    check_faults(caught.value)


@pytest.mark.parametrize("name", ["trajectory.vtkhdf", "diagnostics.csv"])
@pytest.mark.parametrize("content", [b"", b"\x00", b"hello", b"step,time\n0,0\n", bytes(range(256)) * 9])
def test_foreign_files_are_refused(stopped, tmp_path, name, content):
    folder = tmp_path / "o"
    shutil.copytree(stopped, folder)
    (folder / name).write_bytes(content)
    with pytest.raises(SceneError, match=f"{name}: cannot be continued"):
        Simulation.resume(folder / "checkpoint.h5").run(folder, resumed=True)
    assert (folder / name).read_bytes() == content
