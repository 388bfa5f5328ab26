"""Every script of python_viz draws a run, and a film has all of its frames."""

import json
import shutil
import sys

import h5py
import numpy as np
import pytest
from conftest import ROOT, run_ranks
from PIL import Image

from particles_mpi import Run, Scene, Simulation

pytestmark = pytest.mark.parallel


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "run"
    walls = {"planes": [{"point": [0, 0, 0.5], "normal": [0, 0.3, 1]}, {"point": [0, 0, 4], "normal": [0, 0, -1]}]}
    particles = [{"count": 60, "position": "random", "radius": 0.2, "velocity": {"speed": 1.0}}]
    box = {"lower": [0, 0, 0], "upper": [4, 4, 4], "periodic": [True, True, False]}
    Simulation(Scene(title=r"$\frac$ and $E_k_1$", dimension=3, box=box,
                     time={"step": 0.05, "steps": 8}, particles=particles, effects={"collisions": {}, "walls": walls},
                     output={"every": 2, "diagnostics_every": 1})).run(folder)  # fmt: skip
    return folder


@pytest.mark.parametrize("script", ["plot_frame", "plot_diagnostics", "plot_phases", "plot_paths"])
def test_a_picture(run, script, tmp_path):
    done = run_ranks(1, ROOT / f"python_viz/{script}.py", run, "--save", tmp_path / "picture.png")
    assert done.returncode == 0, done.stderr
    with Image.open(tmp_path / "picture.png") as picture:
        assert len(picture.convert("RGB").getcolors(1 << 24)) > 100


def test_a_film_has_every_second_frame_and_moves(run, tmp_path):
    done = run_ranks(1, ROOT / "python_viz/animate.py", run, "--every", 2, "--save", tmp_path / "film.gif")
    assert done.returncode == 0, done.stderr
    pictures = set()
    with Image.open(tmp_path / "film.gif") as film:
        for k in range(film.n_frames):
            film.seek(k)
            pictures.add(film.convert("RGB").tobytes())
        assert film.n_frames == len(pictures) == 3


def test_what_is_wrong_is_one_line(run, tmp_path):
    for words, told in (([run, "--frame", 9], "no frame 9: the run has frames 0 to 4"), ([tmp_path], "holds no run")):
        done = run_ranks(1, ROOT / "python_viz/plot_frame.py", *words)
        assert done.returncode == 2 and told in done.stderr and done.stderr.count("\n") == 1
    for words, told in ((["--dpi", "19"], "19 is not from 20 to 2000"), (["--view", "nan", "3"], "nan is not finite")):
        done = run_ranks(1, ROOT / "python_viz/plot_frame.py", run, *words)
        assert done.returncode == 2 and told in done.stderr and "Traceback" not in done.stderr


def test_numbers_that_cannot_be_drawn_are_refused(run):
    words = [("plot_paths", "--span", text, 1) for text in ("-1", "2", "nan")]
    for script, option, text, most in (*words, ("animate", "--fps", "nan", 100), ("animate", "--fps", "1e-9", 100)):
        done = run_ranks(1, ROOT / f"python_viz/{script}.py", run, option, text)
        assert done.returncode == 2 and f"{option}: {text} is not from 0.01 to {most}\n" in done.stderr


def test_the_smallest_picture_has_a_heading_however_long(run, tmp_path):
    table = json.loads((run / "run.json").read_text())
    table["scene"]["title"] = "t" * 3000
    shutil.copytree(run, tmp_path / "long")
    (tmp_path / "long" / "run.json").write_text(json.dumps(table))
    done = run_ranks(1, ROOT / "python_viz/plot_frame.py", tmp_path / "long", "--dpi", 20)
    assert done.returncode == 0, done.stderr


def test_there_is_no_film_of_a_run_without_frames(run, tmp_path):
    shutil.copytree(run, tmp_path / "begun")
    with h5py.File(tmp_path / "begun" / "trajectory.vtkhdf", "r+") as file:
        file["VTKHDF/Steps"].attrs["NSteps"] = 0
    done = run_ranks(1, ROOT / "python_viz/animate.py", tmp_path / "begun")
    assert done.returncode == 2 and done.stderr == f"animate.py: {tmp_path / 'begun'}: the run has no frame yet\n"


def test_only_runs_of_one_scene_show_strong_scaling(run, tmp_path):
    table = json.loads((run / "run.json").read_text())
    for name, seed, code, told in (("same", 0, 0, ""), ("other", 1, 2, "other is of another scene")):
        table["scene"]["seed"] = table["scene"].get("seed", 0) + seed
        (tmp_path / name).mkdir()
        (tmp_path / name / "run.json").write_text(json.dumps(table))
        done = run_ranks(1, ROOT / "python_viz/plot_phases.py", run, tmp_path / name, "--save", tmp_path / "picture.png")
        assert done.returncode == code and told in done.stderr, done.stderr


def test_the_path_of_a_fast_particle_through_periodic_faces_is_straight(tmp_path):
    """Between two frames it went 0.9 of the box."""
    sys.path.insert(0, str(ROOT / "python_viz"))
    from plot_paths import paths_of

    box = {"lower": [0, 0], "upper": [10, 10], "periodic": [True, False]}
    particles = [{"position": [[1, 5]], "velocity": [9, 0.5], "radius": 0.2}]
    time, output = {"step": 0.01, "steps": 300}, {"every": 100}
    Simulation(Scene(dimension=2, box=box, time=time, output=output, particles=particles)).run(tmp_path)
    moments, places = paths_of(Run(tmp_path)[:], True, np.array([10.0, 0.0]))
    assert np.abs(places[:, 0] - ([1, 5] + moments[:, None] * [9, 0.5])).max() < 1e-9


def test_the_ends_of_a_box_far_away_are_told_apart():
    sys.path.insert(0, str(ROOT / "python_viz"))
    from picture import coordinates

    assert coordinates(1000.0, 1001.5) == ("1000", "1001.5") and coordinates(0.0, 0.5) == ("0", "0.5")
    assert coordinates(-1e6, -1e6 + 1e-3) == ("-1000000", "-999999.999") and coordinates(2.0, 2.0) == ("2", "2")
