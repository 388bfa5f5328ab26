"""The scripts of python_viz on small runs: what they print, and that they draw."""

import json
import re
import shutil
import sys
from importlib import import_module
from math import pi

import numpy as np
import pytest
from conftest import ROOT, run_ranks
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib import pyplot as plt
from matplotlib.text import Text

from particles_mpi import Run, Scene, Simulation

pytestmark = pytest.mark.parallel


def script(name, *arguments):
    return run_ranks(1, ROOT / "python_viz" / name, *arguments)


def gas(folder, name, step, frames=False, **collisions):
    n, side = 256, (256 / 0.6) ** (1 / 3)
    text = f"""
dimension = 3
seed = 1
[box]
lower = [0, 0, 0]
upper = [{side}, {side}, {side}]
periodic = true
[time]
step = {step}
steps = {round(12 / step)}
[[particles]]
count = {n}
position = "lattice"
velocity = {{temperature = 1.0}}
radius = 0.5
mass = 1.0
[effects.collisions]
{"".join(f"{key} = {json.dumps(value)}" + chr(10) for key, value in collisions.items())}
[output]
formats = {json.dumps(["hdf5"] if frames else [])}
observables = true
diagnostics_every = {max(1, round(0.4 / step))}
"""
    scene, output = folder / f"{name}.toml", folder / name
    scene.write_text(text)
    done = run_ranks(1, "-m", "particles_mpi", "run", scene, "--output", output, "--quiet")
    assert done.returncode == 0, done.stderr
    return output


def test_paths_of_a_few_and_places_of_many(tmp_path):
    few = run_ranks(1, "-m", "particles_mpi", "run", ROOT / "particles_mpi" / "scenes" / "figure_eight.toml", "--output",
                    tmp_path / "few", "--steps", 300, "--quiet")  # fmt: skip
    assert few.returncode == 0, few.stderr
    many = gas(tmp_path, "many", 1.0, frames=True, mode="event")
    done = script("plot_paths.py", tmp_path / "few", many, "--save", tmp_path / "paths.png")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "paths.png").stat().st_size > 20_000


def test_paths_between_frames_are_curves_and_those_of_a_line_are_drawn_over_time(tmp_path):
    """A circular orbit of which there are four frames a turn: within 2 % of the circle, whose chords come within 0.7 of it."""
    circle = Scene(
        dimension=2,
        G=1.0,
        time={"step": pi / 200, "steps": 400},
        particles=[{"position": [[0, 0]], "mass": 1.0, "fixed": True}, {"position": [[1, 0]], "velocity": [0, 1], "mass": 0.0}],
        effects={"mutual_gravity": {}},
        output={"every": 100, "formats": ["hdf5"]},
    )
    rods = Scene(
        dimension=1,
        box={"lower": [0.0], "upper": [9.0]},
        time={"step": 0.1, "steps": 20},
        particles=[{"count": 9, "position": "lattice", "velocity": {"temperature": 1.0}, "radius": 0.1}],
        effects={"collisions": {"mode": "event"}, "walls": {}},
        output={"every": 1, "formats": ["hdf5"]},
    )
    for name, scene in (("circle", circle), ("rods", rods)):
        Simulation(scene).run(tmp_path / name)
    paths_of = viz("plot_paths").paths_of
    frames = Run(tmp_path / "circle")[:]
    for smooth, least in ((True, 0.98), (False, 0.7)):
        _, places = paths_of(frames, smooth)
        along = np.concatenate([places[:-1, 1] * (1 - s) + places[1:, 1] * s for s in (0.0, 0.5)])
        away = np.linalg.norm(along, axis=1)
        assert away.max() < 1.02 and away.min() == pytest.approx(least, abs=0.02)
    done = script("plot_paths.py", tmp_path / "circle", tmp_path / "rods", "--save", tmp_path / "paths.png")
    assert done.returncode == 0, done.stderr


def viz(module):
    """A module of python_viz."""
    sys.path.insert(0, str(ROOT / "python_viz"))
    try:
        return import_module(module)
    finally:
        sys.path.pop(0)


@pytest.mark.parametrize(("d", "shown", "label"), [(2, [2.0, -3.0], "spin"), (3, [21**0.5, 3.0], "|spin|")])
def test_spins_in_the_plane_are_shown_with_their_sign(d, shown, label, tmp_path):
    spin = [2.0, -3.0] if d == 2 else [[2.0, 1.0, 4.0], [0.0, 0.0, -3.0]]
    balls = {"position": [[0.0] * d, [3.0] * d], "radius": 0.5, "spin": spin}
    scene = Scene(dimension=d, time={"step": 0.1, "steps": 1}, particles=[balls], effects={"collisions": {"friction": 0.3}})
    Simulation(scene).run(tmp_path)
    drawn = viz("picture").Picture(Run(tmp_path), Run(tmp_path)[:], "spin", (0.0, 0.0), 100)
    assert drawn.value(Run(tmp_path)[0]) == pytest.approx(shown) and drawn.label == label
    assert drawn.colors.get_clim() == pytest.approx((-3.0, 3.0) if d == 2 else (3.0, 21**0.5))
    plt.close(drawn.figure)


def test_the_picture_of_runs_that_differ_by_who_is_there_says_so(tmp_path):
    two = {"position": [[0.0, 0.0], [3.0, 0.0]], "velocity": [1.0, 0.0]}
    scene = Scene(dimension=2, time={"step": 0.01, "steps": 20}, output={"every": 10}, particles=[two])
    Simulation(scene).run(tmp_path / "a")
    sim = Simulation(scene)
    sim.run(tmp_path / "b", steps=10)
    sim.remove([1])
    sim.run(tmp_path / "b", resumed=True)
    compare_runs = viz("compare_runs")
    drawn = []
    with pytest.MonkeyPatch.context() as patch, pytest.raises(SystemExit, match="1"):
        patch.setattr(compare_runs, "finish", lambda figure, *_: drawn.append(figure))
        patch.setattr(sys, "argv", ["compare_runs.py", str(tmp_path / "a"), str(tmp_path / "b")])
        compare_runs.main()
    texts = [text.get_text() for text in drawn[0].findobj(Text)]
    assert "first difference: frame 2, t = 0.2: presence of 1 particles: ids 1" in texts
    assert texts.count("none in any frame, of particles that are in both runs") == 2
    plt.close(drawn[0])


@settings(max_examples=200)
@given(
    seed=st.integers(0, 10**6),
    points=st.integers(1, 12),
    periods=st.lists(st.sampled_from([0.0, 1.0, 0.3]), min_size=1, max_size=3),
)
def test_a_path_through_periodic_faces_is_drawn_inside(seed, points, periods):
    """None of it is lost, none lies outside, and it has gaps where it goes on from the other face, nowhere else."""
    random, length = np.random.default_rng(seed), np.array(periods)
    whole = np.cumsum(random.normal(0.0, 0.4, (points, len(length))), axis=0)
    drawn = viz("plot_paths").inside(whole, np.full(len(length), -0.2), length)
    steps = np.linalg.norm(np.diff(drawn, axis=0), axis=1)
    assert np.nansum(steps) == pytest.approx(np.linalg.norm(np.diff(whole, axis=0), axis=1).sum(), abs=1e-12)
    for k in np.flatnonzero(length):
        assert np.nanmin(drawn[:, k]) >= -0.2 - 1e-12 and np.nanmax(drawn[:, k]) <= length[k] - 0.2 + 1e-12
    for gap in np.flatnonzero(np.isnan(drawn[:, 0])):
        jump = drawn[gap + 1] - drawn[gap - 1]
        turns = jump / np.where(length, length, 1.0)
        assert np.abs(turns - np.rint(turns)).max() < 1e-9 and (np.rint(turns) != 0.0).any()
    assert (np.isfinite(drawn[:, 0]) | (not length.any())).any()


def test_paths_of_particles_that_come_and_go_in_a_periodic_box(tmp_path):
    """Where a particle is not there its path has a gap, and no face that it went through."""
    pair = {"position": [[1, 1], [2, 2]], "velocity": [[0.5, 0.3], [0.0, 8.4]], "radius": 0.2}
    box, time = {"lower": [0, 0], "upper": [4, 4], "periodic": True}, {"step": 0.01, "steps": 60}
    sim = Simulation(Scene(dimension=2, box=box, time=time, particles=[pair], output={"every": 5}))
    sim.run(tmp_path, steps=20)
    sim.remove([0])
    sim.run(tmp_path, steps=40)
    sim.add({"position": [[3, 1]], "velocity": [0.0, -8.0], "radius": 0.1})
    sim.run(tmp_path)
    done = script("plot_paths.py", tmp_path)
    assert done.returncode == 0 and not done.stderr, done.stderr
    assert (tmp_path / "plots" / "paths.png").stat().st_size > 10_000


def points_in_a_box(folder, *more):
    """A run of 60 points of one speed, and of what else there is."""
    points = {"count": 60, "position": "random", "velocity": {"speed": 0.7}}
    tables = {"dimension": 2, "box": {"lower": [0, 0], "upper": [1, 1]}, "time": {"step": 0.01, "steps": 30}}
    scene = Scene.from_dict(tables | {"particles": [*more, points], "effects": {"collisions": {}, "walls": {}}})
    Simulation(scene).run(folder)
    return Run(folder)


def test_points_beside_a_sphere_are_drawn(tmp_path):
    run, paths = points_in_a_box(tmp_path, {"position": [[0.5, 0.5]], "radius": 0.3, "fixed": True}), viz("plot_paths")
    axes = paths.plt.figure().add_subplot()
    paths.plot(axes, run, 1.0, "title")
    assert len(axes.lines[0].get_xdata()) == 60 and len(axes.collections[0].get_offsets()) == 1


@pytest.mark.parametrize("d", [1, 2])
def test_paths_can_be_told_apart_and_up_to_ten_have_their_ids_in_a_legend(tmp_path, d):
    paths, drawn = viz("plot_paths"), {}
    for count in (10, 30):
        particles = [{"position": [[float(k)] * d for k in range(count)], "velocity": [1.0] * d}]
        folder = tmp_path / str(count)
        Simulation(Scene(dimension=d, time={"step": 0.1, "steps": 2}, particles=particles)).run(folder)
        axes = plt.figure().add_subplot()
        paths.plot(axes, Run(folder), 1.0, "title")
        drawn[count] = axes
        plt.close(axes.figure)
        lines = [line for line in axes.lines if len(line.get_xdata()) > 1]
        assert len({(*paths.to_rgb(line.get_color()), line.get_linestyle()) for line in lines}) == len(lines) == count
        assert min(np.ptp([1.0, *paths.to_rgb(line.get_color())]) for line in lines) > 0.2  # none is nearly white
    assert [text.get_text() for text in drawn[10].get_legend().get_texts()] == [str(k) for k in range(10)]
    assert drawn[30].get_legend() is None


def test_speeds_that_differ_by_round_off_have_one_colour(tmp_path):
    run = points_in_a_box(tmp_path)
    colors = viz("picture").Picture(run, run[:], "speed", (-60, 20), 50).colors
    assert np.ptp(run[-1].speed) > 0.0 and np.ptp(colors.to_rgba(run[-1].speed), axis=0).max() < 0.01


def test_colours_tell_any_field(tmp_path):
    run, picture = points_in_a_box(tmp_path), viz("picture")
    speeds = picture.Picture(run, run[:], "velocity", (-60, 20), 50).value(run[-1])
    np.testing.assert_array_equal(speeds, run[-1].speed)
    with pytest.raises(IndexError, match="--color charge: frame 0 has speed, energy, mass, id, radius, position, velocity"):
        picture.Picture(run, run[:], "charge", (-60, 20), 50)


def test_the_last_particles_have_gone(tmp_path):
    """A frame without particles is drawn, whatever the colour is to tell."""
    sim = Simulation(Scene(dimension=2, time={"step": 0.1, "steps": 4}, particles=[{"position": [[0, 0]], "radius": 0.1}]))
    sim.run(tmp_path, steps=2)
    sim.remove([0])
    sim.run(tmp_path)
    run, picture = Run(tmp_path), viz("picture")
    for color in ("velocity", "speed"):
        drawn = picture.Picture(run, run[-1:], color, (-60, 20), 50)
        drawn.draw(run[-1])
        picture.plt.close(drawn.figure)


@pytest.mark.parametrize("radius", [0.1, 0.0])
@pytest.mark.parametrize("d", [1, 2, 3])
@pytest.mark.parametrize("place", [5.0, 1e15, -1e30])
def test_a_lonely_particle_far_away_is_in_the_picture(tmp_path, place, d, radius):
    particles = [{"position": [[place] * d], "radius": radius}]
    Simulation(Scene(dimension=d, time={"step": 0.1, "steps": 1}, particles=particles)).run(tmp_path)
    run, picture = Run(tmp_path), viz("picture")
    drawn = picture.Picture(run, run[-1:], "speed", (-60, 20), 50)
    drawn.draw(run[-1])
    picture.plt.close(drawn.figure)
    assert drawn.marbles.get_array()[..., 3].any() and "not in the picture" not in drawn.caption.get_text()


def test_rewind_against_event(tmp_path):
    event = gas(tmp_path, "event", 0.2, mode="event")
    coarse, fine = (gas(tmp_path, f"r{step}", step, mode="rewind", passes=1) for step in (0.1, 0.02))
    done = script("compare_runs.py", event, coarse, fine)
    assert done.returncode == 0, done.stderr
    rows = [line.split() for line in done.stdout.splitlines() if re.match(r" +0\.", line)]
    assert [float(row[0]) for row in rows] == [0.1, 0.02]
    lost, missed = ([float(row[k]) for row in rows] for k in (3, 2))
    assert lost[0] > 0.2 and abs(lost[1]) < 0.2 * lost[0]
    assert missed[0] > 5 * missed[1]
    assert (event / "plots" / "compare_runs.png").stat().st_size > 10_000


def copied(run, folder, ended=True, **collisions):
    """A copy of a run that tells of other collisions, or has not ended."""
    shutil.copytree(run, folder)
    about = json.loads((run / "run.json").read_text())
    about["scene"]["effects"]["collisions"].update(collisions)
    if not ended:
        del about["timers"]
    (folder / "run.json").write_text(json.dumps(about))
    return folder


def few_discs(folder, number=2, speed=1.0):
    """A run in mode event of discs that meet one another again and again, between walls."""
    discs = {"position": [[1.0 + k, 1.0] for k in range(number)], "velocity": [[speed * (k + 1), 0.0] for k in range(number)]}
    scene = Scene(
        dimension=2,
        box={"lower": [0, 0], "upper": [4, 2]},
        time={"step": 0.2, "steps": 100},
        particles=[discs | {"radius": 0.3}],
        effects={"collisions": {"mode": "event"}, "walls": {}},
        output={"formats": [], "diagnostics_every": 10},
    )
    Simulation(scene).run(folder)
    return folder


def test_runs_that_go_on_are_compared_with_event(tmp_path):
    """Their seconds are not known yet; a run that has no row of diagnostics yet is named."""
    event = few_discs(tmp_path / "event")
    begun, rewind = copied(event, tmp_path / "begun", ended=False), copied(event, tmp_path / "rewind", ended=False, mode="rewind")
    for reference in (event, begun):
        done = script("compare_runs.py", reference, rewind)
        assert done.returncode == 0 and not done.stderr, done.stderr
        assert re.search(r"^ +0\.2 .* nan  .*rewind$", done.stdout, re.M), done.stdout
    table = rewind / "diagnostics.csv"
    table.write_text(table.read_text().partition("\n")[0] + "\n")
    done = script("compare_runs.py", event, rewind)
    assert done.returncode == 2 and f"{rewind}: has too few rows of diagnostics" in done.stderr


def test_only_runs_of_one_scene_with_collisions_are_compared_with_event(tmp_path):
    event, other = few_discs(tmp_path / "event"), few_discs(tmp_path / "other", number=3)
    done = script("compare_runs.py", event, copied(other, tmp_path / "rewind", mode="rewind", passes=2))
    assert done.returncode == 2 and "rewind: is of another scene than" in done.stderr and done.stderr.count("\n") == 1
    still = few_discs(tmp_path / "still", speed=0.0)
    done = script("compare_runs.py", still, copied(still, tmp_path / "still_rewind", mode="rewind", passes=2))
    assert done.returncode == 2 and "still: has no collisions in the last 80% of its time" in done.stderr
    assert done.stderr.count("\n") == 1


def test_rewind_that_loses_nothing_against_event(tmp_path):
    """There is no logarithm of nothing: no warning, and a picture with a point."""
    event = gas(tmp_path, "event", 0.2, mode="event")
    same = copied(event, tmp_path / "same", mode="rewind")
    done = script("compare_runs.py", event, same)
    assert done.returncode == 0 and not done.stderr, done.stderr
    (row,) = (line.split() for line in done.stdout.splitlines() if re.match(r" +0\.2 ", line))
    assert float(row[3]) == 0.0
    assert (event / "plots" / "compare_runs.png").stat().st_size > 10_000


def test_runs_with_too_few_rows_are_named(tmp_path):
    few = tmp_path / "few"
    tables = {"dimension": 2, "time": {"step": 0.1, "steps": 2}, "particles": [{"position": [[0.0, 0.0]], "radius": 0.1}]}
    scene = Scene.from_dict(tables | {"effects": {"collisions": {"mode": "event"}}, "output": {"diagnostics_every": 2}})
    Simulation(scene).run(few)
    rewind = copied(few, tmp_path / "rewind", mode="rewind")
    done = script("compare_runs.py", few, rewind)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and f"{few}: has too few rows of diagnostics" in done.stderr


def test_runs_of_other_dimensions_cannot_be_compared(tmp_path):
    folders = []
    for d in (2, 3):
        folders.append(tmp_path / str(d))
        Simulation(Scene(dimension=d, time={"step": 0.1, "steps": 1}, particles=[{"position": [[0.0] * d]}])).run(folders[-1])
    done = script("compare_runs.py", *folders)
    assert done.returncode == 2 and done.stderr == "compare_runs.py: the runs are in 2 and in 3 dimensions\n"


def test_numbers_of_other_types_are_not_the_same_bits():
    same_bits, ones = viz("compare_runs").same_bits, np.ones(3, np.float32)
    assert same_bits(ones, ones.copy()).all() and not same_bits(ones, np.full(3, 7)).any()
    assert same_bits(ones[:, None][:, :0], ones[:, None][:, :0]).all()


@pytest.fixture(scope="module", params=[0.0, 1.2, 82.0, 1000.0])
def with_time_set(tmp_path_factory, request):
    """A run without collisions that goes over periodic faces; half way the user sets the time back, or forward.

    In a time of 80, from 2 to 82, all would have gone round the box a whole number of times.
    """
    folder = tmp_path_factory.mktemp("set")
    pair = {"position": [[1, 1], [2, 2]], "velocity": [[0.5, 0.3], [0.0, 0.4]], "radius": 0.2}
    box, time = {"lower": [0, 0], "upper": [4, 4], "periodic": True}, {"step": 0.1, "steps": 40}
    sim = Simulation(Scene(dimension=2, box=box, time=time, particles=[pair], output={"every": 5, "formats": ["hdf5"]}))
    sim.run(folder, steps=20)
    sim.time = request.param
    sim.run(folder)
    return folder


def test_a_run_in_which_the_time_was_set_is_like_itself(with_time_set):
    done = script("compare_runs.py", with_time_set, with_time_set)
    assert done.returncode == 0 and "\nsame bits\n" in done.stdout, done.stdout + done.stderr


@pytest.mark.parametrize("last", [40, 25])
def test_paths_of_a_run_with_longer_steps_go_as_far(tmp_path, last):
    """Over faces of a periodic box: only the velocities tell how often. The longer steps may be those of one frame only."""
    one, box = {"position": [[1.0, 1.0]], "velocity": [[0.5, 0.0]]}, {"lower": [0, 0], "upper": [4, 4], "periodic": True}
    sim = Simulation(Scene(dimension=2, box=box, time={"step": 0.1, "steps": 40}, particles=[one], output={"every": 5}))
    sim.run(tmp_path, steps=20)
    sim.h = 2.0
    sim.run(tmp_path, steps=last)
    _, places = viz("plot_paths").paths_of(Run(tmp_path)[:], True, np.full(2, 4.0))
    np.testing.assert_allclose(places[-1], [[1.0 + 0.5 * (2.0 + 2.0 * (last - 20)), 1.0]], atol=1e-9)


def test_paths_of_a_run_in_which_the_time_was_set_are_straight(with_time_set):
    frames, plot_paths = Run(with_time_set)[:], viz("plot_paths")
    _, places = plot_paths.paths_of(frames, True, np.full(2, 4.0))
    elapsed = np.array([0.1 * frame.step for frame in frames])[:, None]
    np.testing.assert_allclose(places[:: plot_paths.PIECES, 0], [1, 1] + elapsed * [0.5, 0.3], atol=1e-9)


def test_a_run_without_its_scene_has_no_known_dimension(tmp_path):
    flat, bare = tmp_path / "flat", tmp_path / "bare"
    Simulation(Scene(dimension=2, time={"step": 0.1, "steps": 1}, particles=[{"position": [[0.0, 0.0]]}])).run(flat)
    shutil.copytree(flat, bare)
    (bare / "run.json").unlink()
    for runs in ((flat, bare), (bare, flat)):
        done = script("compare_runs.py", *runs)
        told = f"compare_runs.py: {bare}: has no run.json, which tells in how many dimensions it is\n"
        assert done.returncode == 2 and done.stderr == told
    assert script("compare_runs.py", bare, bare).returncode == 0
