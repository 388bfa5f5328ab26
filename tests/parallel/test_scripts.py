"""The scripts of python_viz on small runs: what they print, and that they draw."""

import json
import re

import pytest
from conftest import ROOT, run_ranks

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
