"""Scenes that run, but not as one may think: what is said of them at the start, and that no figure means less than it says."""

import csv
import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest
from conftest import ROOT
from hypothesis import given, settings
from hypothesis import strategies as st

from particles_mpi import Scene, SceneError, Simulation
from particles_mpi.initial.start_warnings import coincident
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Particles

AXES = st.lists(st.booleans(), min_size=3, max_size=3)
PULL = st.lists(st.sampled_from([0.0, -2.0, 0.5]), min_size=3, max_size=3)


def falling(periodic, uniform=None, own=None, **population):
    """Three particles in a box of ten turns, ten steps: on a periodic axis with a force some turn round."""
    effects = {} if uniform is None else {"uniform_gravity": {"acceleration": uniform}}
    more = {} if own is None else {"acceleration": own}
    effects |= {} if own is None else {"user_acceleration": {}}
    places = [[0.1, 0.2, 0.3], [0.5, 0.5, 0.5], [0.9, 0.9, 0.1]]
    return Scene(
        dimension=3,
        box={"lower": [0.0] * 3, "upper": [1.0] * 3, "periodic": periodic},
        time={"step": 0.25, "steps": 10},
        particles=[{"position": places, "velocity": [1.0, -2.0, 3.0], "mass": 2.0, **more, **population}],
        effects=effects,
    )


def warned(sim):
    """What is said of the start, but of effects that change nothing."""
    idle = "changes nothing", "moves no particle", "slows no particle"
    return [line for line in sim.warnings if not any(words in line for words in idle)]


@settings(max_examples=60)
@given(periodic=AXES, uniform=st.none() | PULL, own=st.none() | st.lists(PULL, min_size=3, max_size=3))
def test_an_energy_is_kept_or_not_told(periodic, uniform, own):
    """A constant force keeps kinetic + potential exactly; along a periodic axis there is no potential, which is said by key."""
    sim = Simulation(falling(periodic, uniform, own))
    uniform_turns = any(g and p for g, p in zip(uniform or [0.0] * 3, periodic, strict=True))
    turning = [k for k, a in enumerate(own or []) if any(x and p for x, p in zip(a, periodic, strict=True))]
    keys = [warning.split(":")[0].split(".")[1] for warning in warned(sim)]
    assert keys == ["uniform_gravity"] * uniform_turns + ["user_acceleration"] * bool(turning)
    assert all(str(k) in warned(sim)[-1].split("along")[0] for k in turning)
    before = sim.measure()
    sim.run()
    after = sim.measure()
    assert np.isfinite([after["kinetic"], after["momentum_x"], after["max_speed"]]).all()
    for name in ("potential", "total_energy"):
        assert np.isnan([before[name], after[name]]).all() == bool(warned(sim))
    if not warned(sim):
        assert after["total_energy"] == pytest.approx(before["total_energy"], rel=1e-12, abs=1e-11)


def test_a_pull_that_comes_later_counts_and_one_on_fixed_particles_does_not():
    sim = Simulation(falling([True, False, False], own=[0.0, 1.0, 0.0]))
    sim.step()
    assert not sim.warnings and np.isfinite(sim.measure()["total_energy"])
    sim.particles["acceleration"][1, 0] = 0.5
    assert np.isnan(sim.measure()["total_energy"])
    still = Simulation(falling([True, False, False], own=[1.0, 0.0, 0.0], fixed=True, velocity=[0.0] * 3))
    assert not still.warnings and still.measure()["total_energy"] == 0.0


def test_a_run_without_a_potential_is_written_resumed_and_drawn(tmp_path):
    sim = Simulation(falling(True, [0.0, 0.0, -2.0]))
    sim.scene.output.diagnostics_every = sim.scene.output.checkpoint_every = 5
    sim.run(tmp_path / "o", steps=5)
    Simulation.resume(tmp_path / "o" / "checkpoint.h5").run(tmp_path / "o", resumed=True)
    rows = list(csv.DictReader((tmp_path / "o" / "diagnostics.csv").read_text().splitlines()))
    assert [(row["step"], row["potential"], row["total_energy"]) for row in rows] == [(k, "nan", "nan") for k in ("0", "5", "10")]
    script = ROOT / "python_viz" / "plot_diagnostics.py"
    subprocess.run([sys.executable, script, tmp_path / "o", "--save", tmp_path / "p.png"], check=True, timeout=100)
    assert (tmp_path / "p.png").stat().st_size > 20_000


BODY = st.tuples(st.sampled_from([(0.0, 0.0), (-0.0, 0.0), (0.0, 1.0), (1.0, 0.0)]), st.sampled_from([0.0, 1.0]), st.booleans())


@settings(max_examples=80)
@given(st.lists(BODY, max_size=7))
def test_bodies_at_one_place_without_softening_are_named(bodies):
    """Against all pairs: whoever shares a place with another that could pull or be pulled."""
    scene = Scene(
        dimension=2,
        G=1.0,
        time={"step": 0.1, "steps": 1},
        particles=[{"position": [list(x)], "mass": m, "fixed": f} for x, m, f in bodies] or [{"position": [[0.0, 0.0]]}],
        effects={"mutual_gravity": {}},
    )
    apart = {x: [k for k, body in enumerate(bodies) if body[0] == x] for x, _, _ in bodies}
    groups = [g for g in apart.values() if len(g) > 1 and any(bodies[k][1] for k in g) and not all(bodies[k][2] for k in g)]
    expected = sorted(f"{i}-{j}" for g in groups for i, j in pairwise(g))
    warnings = warned(Simulation(scene))
    named = sorted(word.strip(",") for word in " ".join(warnings).split() if word.replace("-", "").strip(",").isdigit())
    assert named == expected or (len(expected) > 5 and "1 more" in warnings[0])
    assert all(warning.startswith("effects.mutual_gravity: pair") for warning in warnings)
    softened = scene.to_dict()
    softened["effects"]["mutual_gravity"]["softening"] = 0.1
    assert not warned(Simulation(Scene.from_dict(softened)))


def test_a_lattice_is_searched_without_comparing_all_pairs():
    """Of 100 000 rows of which all share each coordinate with hundreds; 1e10 pairs would take minutes."""
    n = 100_000
    grid = np.stack(np.unravel_index(np.arange(n), (50, 50, 40)), axis=1).astype(float)
    grid[n // 2] = grid[3]
    scene = Scene(dimension=3, G=1.0, time={"step": 0.1, "steps": 1}, particles=[], effects={"mutual_gravity": {}})
    arrays = {"id": np.arange(n), "position": grid, "mass": np.ones(n), "fixed": np.zeros(n, np.uint8)}
    (warning,) = coincident(scene, Particles(3, arrays), Communicator.alone())
    assert f"pair 3-{n // 2} is at the same place" in warning


@pytest.mark.parametrize("mode", ["rewind", "event"])
def test_a_periodic_box_of_two_diameters_is_refused(mode):
    """A sphere could meet two images of another one; just above, `rewind` takes it, and `event` from a hundredth more on."""

    def scene(side):
        return Scene(
            dimension=2,
            box={"lower": [0.0, 0.0], "upper": [side, side], "periodic": True},
            time={"step": 0.01, "steps": 3},
            particles=[{"position": [[0.2, 0.2]], "radius": 0.2}],
            effects={"collisions": {"mode": mode}},
        )

    with pytest.raises(SceneError, match=r"box: periodic axis 0 is 0\.8 long, but collisions need more than"):
        Simulation(scene(0.8))
    Simulation(scene(0.81)).steps(3)


@pytest.mark.parametrize(("fixed", "radius"), [(0.25, 0.0), (0.3, 0.05)])
def test_what_does_not_move_needs_room_for_itself_once(fixed, radius):
    """Fixed discs so large that two of them would not do: rewind finds what event finds, through the sides of the box."""

    def final(mode):
        discs = [{"position": [[0.5, 0.5]], "radius": fixed, "fixed": True}]
        moving = {"position": [[0.02, 0.0], [0.0, 0.9]], "velocity": [[1.0, 0.3], [0.2, -1.0]], "radius": radius}
        box = {"lower": [0.0, 0.0], "upper": [1.0, 1.0], "periodic": True}
        effects = {"collisions": {"mode": mode}}
        sim = Simulation(
            Scene(dimension=2, box=box, time={"step": 0.01, "steps": 250}, particles=[*discs, moving], effects=effects)
        )
        sim.steps(250)
        return sim.totals["collisions"], sim.particles.position[np.argsort(sim.particles.id)]

    (found, places), (wanted, exact) = final("rewind"), final("event")
    assert found == wanted >= 3 and places == pytest.approx(exact, abs=1e-9)


def test_output_that_is_changed_is_checked_as_in_a_scene_file():
    output = Simulation(falling(True, [0.0, 0.0, -2.0])).scene.output
    for name, value, says in [
        ("every", 0, "must be greater than or equal to 1"),
        ("diagnostics_every", 2.5, "must be a valid integer"),
        ("formats", ["foo"], "must be 'hdf5' or 'vtk'"),
        ("evry", 5, "evry"),
    ]:
        with pytest.raises(SceneError, match=rf"output\.{name}.*{says}|{says}"):
            setattr(output, name, value)
    output.every, output.formats = 7, ["vtk"]
    assert output.every == 7


def test_an_effect_that_is_switched_off_is_warned_of_by_nothing():
    """The same one, switched on, is: it has no potential along a periodic axis, or acts on nobody."""
    effects = {
        "uniform_gravity": {"acceleration": [1.0, 0.0]},
        "user_acceleration": {},
        "drag": {},
        "walls": {"planes": [{"point": [0, 0], "normal": [1, 1]}]},
    }
    box = {"lower": [0, 0], "upper": [4, 4], "periodic": [True, False]}
    ball = {"position": [[2.0, 3.0]], "radius": 0.1}

    def warnings(active):
        tables = {name: keys | {"active": active} for name, keys in effects.items()}
        return Simulation(Scene(dimension=2, box=box, time={"step": 0.01, "steps": 1}, particles=[ball], effects=tables)).warnings

    assert sum(f"effects.{name}" in line for name in effects for line in warnings(True)) == 4
    assert warnings(False) == []
