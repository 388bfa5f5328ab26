"""The program as users start it: files, exit codes, resume, plan."""

import csv
import json
import os
import re
import subprocess
import sys
from importlib.metadata import version

import h5py
import numpy as np
import pytest
from conftest import ROOT, environment, run_ranks
from with_all import with_all

from particles_mpi import Run, Scene, Simulation
from particles_mpi.cli import check
from particles_mpi.scene.memory import LIBRARIES

pytestmark = pytest.mark.parallel
STUDY = "study accuracy --only A --quick --output study"

SCENE = """
title = "test"
dimension = 2
seed = 5
[box]
lower = [0, 0]
upper = [4, 4]
[time]
step = 0.01
steps = 40
[[particles]]
count = 40
position = "random"
velocity = {speed = 2.0}
radius = 0.1
mass = {min = 0.1, max = 0.5}
[effects.collisions]
[effects.walls]
restitution = 0.9
[effects.uniform_gravity]
acceleration = [0, -9.81]
[output]
every = 10
checkpoint_every = 20
diagnostics_every = 5
"""


def particles_mpi(ranks, *arguments, **how):
    return run_ranks(ranks, "-m", "particles_mpi", *arguments, **how)


def frames(folder):
    with h5py.File(folder / "trajectory.vtkhdf") as file:
        group = file["VTKHDF"]
        return {n: group[n][:] for n in ("Points", "PointData/id", "PointData/velocity", "Steps/Values")}


def rows(folder):
    """diagnostics.csv without the columns that tell about ranks."""
    table = list(csv.reader((folder / "diagnostics.csv").read_text().splitlines()))
    kept = [k for k, name in enumerate(table[0]) if name not in ("exchanges", "imbalance")]
    return [[row[k] for k in kept] for row in table]


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    return path


def test_run_and_resume_give_the_same_bits_on_any_ranks(scene, tmp_path):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    done = particles_mpi(1, "run", scene, "--output", whole, fresh=True)  # as users start it
    assert done.returncode == 0, done.stderr
    assert (
        "does not run: drag, friction, mutual_gravity, rolling, user_acceleration" in done.stdout
        and "contact times" in done.stdout
    )
    assert "\x1b" not in done.stdout and "\r" not in done.stdout  # plain where nobody watches
    assert particles_mpi(2, "run", scene, "--output", parts, "--steps", "23", "--quiet").stdout == ""
    done = particles_mpi(3, "run", scene, "--output", parts, "--resume", parts / "checkpoint.h5", "--quiet")
    assert done.returncode == 0, done.stderr
    a, b = frames(whole), frames(parts)
    assert len(a["Steps/Values"]) == 5
    assert all(a[n].tobytes() == b[n].tobytes() for n in a)
    assert rows(whole) == rows(parts) and len(rows(whole)) == 10
    told = json.loads((whole / "run.json").read_text())
    assert told["ranks"] == 1 and told["counts"]["messages"] == 0
    assert {"min", "mean", "max"} == set(told["timers"]["loop"]) == set(told["timers"]["setup"])
    assert [row["calls"] for row in told["plan"]["not_run"]] == [0] * 5
    assert all(row["calls"] > 0 for row in told["plan"]["effects"])
    done = particles_mpi(2, "run", scene, "--output", tmp_path / "more", "--resume", parts / "checkpoint.h5")
    steps = told["scene"]["time"]["steps"]
    assert done.returncode == 0 and f"continues from step {steps} of {steps}: nothing is left to do" in done.stdout


UNEVEN = """
dimension = 1
[box]
lower = [0.0]
upper = [10.0]
[time]
step = 0.001
steps = 2
[[particles]]
position = [[1.0], [3.0], [5.0], [7.0], [9.0]]
velocity = [[0.1], [0.0], [0.2], [0.0], [30.0]]
radius = [0.2, 0.2, 0.2, 0.05, 0.1]
fixed = [false, false, false, true, false]
[effects.collisions]
[effects.walls]
"""


def test_the_version_is_that_of_the_package():
    told = particles_mpi(2, "--version")
    assert (told.returncode, told.stdout) == (0, f"particles-mpi {version('particles-mpi')}\n")


def test_the_plan_is_that_of_all_ranks(tmp_path):
    """The fastest, the smallest that moves, and the one that is fixed may be on any rank."""
    (tmp_path / "scene.toml").write_text(UNEVEN)
    plans = {}
    for ranks in (1, 3):
        done = particles_mpi(ranks, "check", tmp_path / "scene.toml")
        assert "the fastest particle crosses 0.15 of the smallest diameter in a step" in " ".join(done.stdout.split())
        particles_mpi(ranks, "run", tmp_path / "scene.toml", "--output", tmp_path / str(ranks), "--quiet")
        plans[ranks] = json.loads((tmp_path / str(ranks) / "run.json").read_text())["plan"]
        plans[ranks]["memory_bytes"] -= ranks * LIBRARIES
        plans[ranks] |= dict.fromkeys(("ranks", "ghosts"))
    assert plans[1] == plans[3] and plans[1]["fixed"] == 1


def test_the_doctor_is_plain_where_nobody_watches():
    done = particles_mpi(2, "doctor", fresh=True)  # to each of its ranks mpirun is a terminal
    assert "numba" in done.stdout and "\x1b" not in done.stdout


def test_counts_add_up(scene, tmp_path):
    particles_mpi(2, "run", scene, "--output", tmp_path / "o", "--quiet")
    table = list(csv.DictReader((tmp_path / "o" / "diagnostics.csv").read_text().splitlines()))
    told = json.loads((tmp_path / "o" / "run.json").read_text())["counts"]
    for name in ("collisions", "wall_hits", "missed", "exchanges"):
        assert sum(int(row[name]) for row in table) == told[name]
    assert told["collisions"] > 0 and told["ghost_rows"] > 0


@pytest.mark.parametrize("words", ["run", "check", "--help", "run --help", *with_all(STUDY)])
def test_who_stops_reading_what_is_printed_stops_nothing_else(scene, tmp_path, words):
    """As `| head -1` does: a run goes on to its end, and no command complains."""
    command, *more = words.split()
    given = [command, *([scene] if command in ("run", "check") and not more else []), *more]
    program = subprocess.Popen(
        [sys.executable, "-m", "particles_mpi", *given], cwd=tmp_path, env=environment(),
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    program.stdout.readline()
    program.stdout.close()
    with program.stderr:
        said = program.stderr.read()
    assert (program.wait(100), said) == (0, b"")
    if words == "run":
        (folder,) = (path.parent for path in tmp_path.rglob("run.json"))
        assert Run(folder).ended


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no device that is always full")
def test_a_log_on_a_full_disk_stops_nothing_else(scene, tmp_path):
    why = "standard output cannot be written (No space left on device): nothing more is printed\n"
    for errors, told in ((subprocess.PIPE, why), (subprocess.STDOUT, None)):
        command = [sys.executable, "-m", "particles_mpi", "run", scene, "--output", tmp_path / "o", "--overwrite"]
        with open("/dev/full", "w") as full:
            done = subprocess.run(command, env=environment(), stdout=full, stderr=errors, text=True, timeout=100)
        assert (done.returncode, done.stderr) == (0, told) and Run(tmp_path / "o").ended
    with open("/dev/full", "w") as full:  # of these nothing else is left
        for words, code in ((["check", scene], 3), (["doctor"], 1)):
            command = [sys.executable, "-m", "particles_mpi", *words]
            done = subprocess.run(command, env=environment(), stdout=full, stderr=subprocess.PIPE, text=True, timeout=100)
            assert (done.returncode, done.stderr) == (code, why)


@pytest.mark.parametrize(
    ("command", "option"),
    [
        (["run", "SCENE", "--output", ""], "'--output' / '-o'"),
        (["run", "SCENE", "--resume", ""], "'--resume'"),
        (["study", "accuracy", "--output", ""], "'--output'"),
        (["study", "recommend", "SCENE", "--tolerance", "1e-3", "--output", ""], "'--output'"),
        (["study", "hard-cases", "--output", ""], "'--output'"),
    ],
)
def test_a_path_that_is_empty_is_refused(scene, command, option):
    """As of a variable of the shell that is not set: that would be the folder one is in."""
    done = particles_mpi(1, *(scene if word == "SCENE" else word for word in command))
    assert (done.returncode, done.stderr) == (2, f"particles-mpi: Invalid value for {option}: is empty\n")


@pytest.mark.parametrize("ranks", ["0", "-1", "1.5", "two"])
def test_a_number_of_ranks_that_is_none_is_one_line(ranks):
    launch = re.search(r"^launch\(\) \{.*?^\}", (ROOT / "run.sh").read_text(), re.DOTALL | re.MULTILINE)[0]
    fail = re.search(r"^fail\(\).*$", (ROOT / "run.sh").read_text(), re.MULTILINE)[0]
    command = ["bash", "-euc", f"{fail}\n{launch}\nlaunch true"]
    done = subprocess.run(command, env=os.environ | {"RANKS": ranks}, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (1, f"run.sh: RANKS: '{ranks}' is not a number of ranks\n")


def test_a_folder_that_holds_a_run_is_refused(scene, tmp_path):
    out = tmp_path / "o"
    assert particles_mpi(1, "run", scene, "--output", out, "--quiet").returncode == 0
    before = (out / "run.json").read_bytes()
    done = particles_mpi(2, "run", scene, "--output", out)
    assert done.returncode == 2 and "--overwrite" in done.stderr and (out / "run.json").read_bytes() == before
    assert particles_mpi(1, "run", scene, "--output", out, "--overwrite", "--quiet").returncode == 0


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("radius = 0.1", "raduis = 0.1", "particles[0].raduis: unknown key (did you mean 'radius'?)"),
        ("radius = 0.1", "radius = -0.1", "particles[0].radius"),
        ("min = 0.1, max = 0.5", "min = 0.0, max = 0.0", "particles[0].mass"),
        ("step = 0.01", "step = 0.2", "time.step"),
        ("count = 40", "count = 4000", "particles[0].position"),
        ("steps = 40", 'steps = 40\nintegrator = "order4"', "goes back in time between kicks"),
        ("restitution = 0.9", "restitution = 0.9\ndamping = 0.1", "effects.walls.restitution"),
        ("dimension = 2", "dimension = 3", "box.lower"),
        ("steps = 40", "", "time.steps"),
    ],
)
def test_faults_name_the_key_and_write_nothing(scene, tmp_path, old, new, says):
    assert old in SCENE
    scene.write_text(SCENE.replace(old, new))
    done = particles_mpi(2, "run", scene, "--output", tmp_path / "o")
    assert done.returncode == 2 and says in done.stderr and "Traceback" not in done.stderr, done.stderr
    assert all(line.startswith(f"particles-mpi: {scene}: ") for line in done.stderr.splitlines()), done.stderr
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize("words", [[], ["--help"], ["run", "--help"], ["study"], ["study", "recommend", "--help"]])
def test_help_is_said_once(words):
    done = particles_mpi(2, *words)
    assert done.stdout.count("Usage:") == 1 and not done.stderr, done.stderr


def test_check_finds_the_same_faults(scene):
    scene.write_text(SCENE.replace("radius = 0.1", "radius = -0.1"))
    done = particles_mpi(2, "check", scene)
    assert done.returncode == 2 and "particles[0].radius" in done.stderr and "Traceback" not in done.stderr, done.stderr


SHIPPED = sorted(path.stem for path in (ROOT / "particles_mpi" / "scenes").glob("*.toml"))
CHECKED = ("headline", "solar_system")  # without --all: it measures each for a second or two


@pytest.mark.parametrize("name", [pytest.param(n, marks=[] if n in CHECKED else [pytest.mark.slow]) for n in SHIPPED])
def test_a_shipped_scene_is_checked(name, capsys):
    """`check` prints a plan and a prediction, and does not run it to its end."""
    check(ROOT / "particles_mpi" / "scenes" / f"{name}.toml")
    told = capsys.readouterr().out
    assert "valid" in told and "predicted error: " in told and "ms a step, measured over " in told


def test_every_shipped_scene_starts():
    assert len(SHIPPED) >= 6
    for name in SHIPPED:
        sim = Simulation(Scene.load(ROOT / "particles_mpi" / "scenes" / f"{name}.toml"))
        assert sim.total > 0 and sim.steps_done == 0, name


def test_interrupt_writes_a_checkpoint(scene, tmp_path):
    scene.write_text(SCENE.replace("steps = 40", "steps = 100000000"))
    done = particles_mpi(2, "run", scene, "--output", tmp_path / "o", "--wall-time", "00:00:02")
    assert done.returncode == 130 and "--resume" in done.stderr
    with h5py.File(tmp_path / "o" / "checkpoint.h5") as file:
        assert np.isfinite(file["particles/position"][:]).all()


NARROW = """
import numpy as np
from particles_mpi import Scene, Simulation, StoppedError
random = np.random.default_rng(0)
points = np.column_stack([random.uniform(0.0, 10.0, 200), random.uniform(0.0, 0.56, 200)])
row = {"position": [[15.0 + 0.2001 * k, 0.28] for k in range(4)], "velocity": [[1.0, 0.0]] + [[0.0, 0.0]] * 3}
scene = Scene(
    dimension=2,
    box={"lower": [0, 0], "upper": [40, 0.56], "periodic": True},
    time={"step": 0.01, "steps": 5},
    effects={"collisions": {}},
    particles=[{"position": points.tolist()}, row | {"radius": 0.1, "mass": [27000.0, 900.0, 30.0, 1.0]}],
)
try:
    Simulation(scene).steps(5)
except StoppedError as error:
    print(error)
"""


@pytest.mark.parametrize("ranks", [1, 2])
def test_a_collision_that_throws_too_far_in_a_narrow_box_ends_all_ranks(ranks, tmp_path):
    """On one of two ranks, where candidates do not hold as long as on the other one: both must come to the same end."""
    (tmp_path / "narrow.py").write_text(NARROW)
    done = run_ranks(ranks, tmp_path / "narrow.py", timeout=60)
    said = "too far to tell particles from their images in a periodic box of 0.56"
    assert done.returncode == 0 and done.stdout.count(said) == ranks, done.stderr
