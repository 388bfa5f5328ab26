"""Copies, comparison, printing, JSON: the whole state, exact to the bit."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from particles_mpi import Scene, SceneError, Simulation
from particles_mpi.measure import snapshot
from particles_mpi.measure.snapshot import load_json, same, save_json
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Particles


def simulation(**collisions):
    return Simulation(
        Scene.from_dict(
            {
                "dimension": 2,
                "seed": 5,
                "box": {"lower": [0, 0], "upper": [4, 4]},
                "time": {"step": 0.01, "steps": 40},
                "particles": [{"count": 40, "position": "random", "velocity": {"speed": 3.0}, "radius": 0.1, "mass": 0.3}],
                "effects": {"collisions": {"restitution": 0.9} | collisions, "walls": {}, "drag": {"rate": 0.1}},
            }
        )
    )


@pytest.mark.parametrize("mode", ["rewind", "event"])
def test_a_copy_and_json_go_on_with_the_same_bits(tmp_path, mode):
    sim = simulation(mode=mode)
    for _ in range(15):
        sim.step()
    twin = sim.copy()
    sim.to_json(tmp_path / "compact.json")
    sim.to_json(tmp_path / "readable.json", indent=2)
    others = [twin, *(Simulation.from_json(tmp_path / f"{name}.json") for name in ("compact", "readable"))]
    assert all(sim == other for other in others)
    sim.step()
    assert not any(sim == other for other in others)
    sim.run()
    for other in others:
        other.run()
        assert sim == other and other.totals == sim.totals
    assert len((tmp_path / "compact.json").read_text().splitlines()) == 1
    assert len((tmp_path / "readable.json").read_text().splitlines()) > 40


def test_one_bit_makes_two_states():
    sim = simulation()
    other = sim.copy()
    assert sim == other
    other.particles.velocity[3, 1] = np.nextafter(other.particles.velocity[3, 1], np.inf)
    assert sim != other
    assert sim != "a simulation"


@settings(max_examples=50)
@given(
    rows=st.lists(
        st.tuples(st.floats(allow_nan=False), st.floats(allow_nan=False), st.floats(width=32, allow_nan=False)), max_size=5
    )
)
def test_json_gives_every_float_back(tmp_path_factory, rows):
    x = np.array([row[:2] for row in rows], float).reshape(-1, 2)
    arrays = {"id": np.arange(len(rows)), "position": x, "load": np.array([row[2] for row in rows], np.float32)}
    path = tmp_path_factory.mktemp("json") / "state.json"
    save_json(path, Communicator(), Particles(2, arrays), {"scene": {"dimension": 2}}, None)
    assert same(Particles(2, load_json(path)[0]), Particles(2, arrays))


def test_a_text_with_many_particles_is_warned_of(tmp_path, monkeypatch):
    monkeypatch.setattr(snapshot, "LARGE_TEXT", 2)
    rows = Particles(1, {"id": np.arange(3), "position": np.zeros((3, 1))})
    with pytest.warns(UserWarning, match="3 particles as text"):
        save_json(tmp_path / "state.json", Communicator(), rows, {"scene": {"dimension": 1}}, None)


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"format": "something else"}'])
def test_other_files_are_one_clear_line(tmp_path, text):
    path = tmp_path / "other.json"
    path.write_text(text)
    with pytest.raises(SceneError, match="not a state"):
        Simulation.from_json(path)
    with pytest.raises(SceneError, match="no such file"):
        Simulation.from_json(tmp_path / "missing.json")
    with pytest.raises(SceneError, match="cannot be read"):
        Simulation.from_json(tmp_path)


def test_printed_as_a_table():
    lines = str(simulation()).splitlines()
    assert "40 particles" in lines[0]
    assert lines[1].split()[:3] == ["id", "position", "velocity"]
    assert lines[2].split()[0] == "0" and lines[-1] == "... and 20 more"
    assert len({len(line) for line in lines[1:-1]}) == 1


def test_data_of_the_users_own_goes_with_the_particles(tmp_path):
    sim = simulation()
    sim.attach("charge", np.arange(40) * 0.5)
    assert sim.particles.charge[3] == 1.5
    sim.attach("charge", np.arange(40) * 0.25)  # others than those that were looked at
    assert sim.particles.charge[4] == 1.0
    sim.attach("charge", np.arange(40) * 0.5)
    sim.attach("tag", np.arange(80, dtype=np.int16).reshape(40, 2))
    sim.run()
    sim.to_json(tmp_path / "state.json")
    for other in (sim, sim.copy(), Simulation.from_json(tmp_path / "state.json")):
        p = other.particles
        assert (p.charge == p.id * 0.5).all() and p.tag.dtype == np.int16
        assert (p.tag == p.id[:, None] * 2 + [0, 1]).all()
    with pytest.raises(ValueError, match="must be a new name, of letters, digits and _"):
        sim.attach("mass", np.ones(40))
    with pytest.raises(ValueError, match="40 particles"):
        sim.attach("short", np.ones(3))
    assert json.loads((tmp_path / "state.json").read_text())["particles"]["tag"]["dtype"] == "int16"
