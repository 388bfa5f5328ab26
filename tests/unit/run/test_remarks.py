"""What a run says at its end, and counts, of what a user should know."""

import json
import subprocess
import sys

import numpy as np
import pytest
from conftest import environment

from particles_mpi import Scene, Simulation


def ended(folder, **tables):
    """run.json of a run in two dimensions, which has the remarks that a script is told."""
    sim = Simulation(Scene(dimension=2, output={"formats": []}, **tables))
    sim.run(folder, quiet=True)
    about = json.loads((folder / "run.json").read_text())
    assert about["remarks"] == sim.remarks()
    return about


DRAG = {"drag": {"rate": 0.1}}


@pytest.mark.parametrize(("step", "more", "told"), [(0.1, {}, True), (0.001, {}, False), (0.1, DRAG, True), (0.001, DRAG, False)])
def test_energy_that_changes_though_nothing_takes_any_is_told(tmp_path, step, more, told):
    """Two that fall onto one another, in steps in which they pass at any distance; drag may take energy, and never gives any."""
    about = ended(
        tmp_path / "o", G=1.0, time={"step": step, "steps": round(1.0 / step)},
        particles=[{"position": [[0.0, 0.0], [1.0, 0.0]], "velocity": [[0.0, 0.3], [0.0, -0.3]], "mass": 1.0}],
        effects={"mutual_gravity": {}, **more},
    )  # fmt: skip
    said = [remark for remark in about["remarks"] if remark.startswith("total energy: changed from ")]
    assert bool(said) == told and all("shorten time.step" in remark and ("adaptive" in remark) != bool(more) for remark in said)


@pytest.mark.parametrize("height", [0.0, 1e4])
def test_energy_is_judged_wherever_height_is_zero(tmp_path, height):
    """Elastic discs that gravity heats, in steps that are much too long; and a fall from rest, which is exact."""
    gravity = {"uniform_gravity": {"acceleration": [0.0, -2.0]}}
    about = ended(
        tmp_path / "o", seed=1, box={"lower": [0.0, height], "upper": [2.0, height + 2.0]}, time={"step": 0.5, "steps": 200},
        particles=[{"count": 30, "radius": 0.05, "position": "random", "velocity": {"speed": 0.9}}],
        effects={**gravity, "collisions": {"mode": "event"}, "walls": {}},
    )  # fmt: skip
    assert any("no effect adds or takes any" in remark for remark in about["remarks"])
    about = ended(
        tmp_path / "p", time={"step": 0.01, "steps": 100}, particles=[{"position": [[0.0, height]], "mass": 1.0}], effects=gravity
    )
    assert not about["remarks"]


def test_what_is_at_rest_is_not_judged_by_round_off(tmp_path):
    """A ball in valleys of two planes: all that changes of its energy is an ulp."""
    for number in range(8):
        angles = np.random.default_rng(number).uniform(0.1, 1.4, 2)
        normals = [[sign * np.sin(angle), np.cos(angle)] for sign, angle in zip((1.0, -1.0), angles, strict=True)]
        about = ended(
            tmp_path / str(number), time={"step": 0.001, "steps": 100},
            particles=[{"position": [np.linalg.solve(normals, [0.1, 0.1]).tolist()], "radius": 0.1, "mass": 1.0}],
            effects={
                "uniform_gravity": {"acceleration": [0.0, -9.8]},
                "walls": {"restitution": 0.5, "planes": [{"point": [0.0, 0.0], "normal": normal} for normal in normals]},
            },
        )  # fmt: skip
        assert not about["remarks"]


def test_a_run_that_is_continued_judges_the_energy_of_all_of_it(tmp_path):
    """All of what the energy loses is lost before the run is stopped; the last part is in another folder."""
    (tmp_path / "s.toml").write_text(
        "dimension = 2\nG = 1.0\n[time]\nstep = 0.1\nsteps = 10\n[output]\nformats = []\n[[particles]]\nmass = 1.0\n"
        "position = [[0.0, 0.0], [1.0, 0.0]]\nvelocity = [[0.0, 0.3], [0.0, -0.3]]\n[effects.mutual_gravity]\n"
    )
    told = []
    for steps, folder, resume in (("10", "o", "auto"), ("12", "o", "auto"), ("14", "p", "o/checkpoint.h5")):
        command = [
            sys.executable,
            "-m",
            "particles_mpi",
            "run",
            "s.toml",
            "--output",
            folder,
            "--steps",
            steps,
            "--resume",
            resume,
        ]
        subprocess.run(command, cwd=tmp_path, env=environment(), check=True, capture_output=True)
        about = json.loads((tmp_path / folder / "run.json").read_text())
        told.append([remark.split(" to ")[0] for remark in about["remarks"] if remark.startswith("total energy: changed from ")])
    assert told[0] and told[2] == told[1] == told[0]
    remarks = Simulation.resume(tmp_path / "p" / "checkpoint.h5").remarks()
    assert [remark.split(" to ")[0] for remark in remarks] == told[0]


WIND = """from particles_mpi.effects import EffectOptions, Force

class Options(EffectOptions):
    pass

class Effect(Force):
    formula = "dv/dt = 1 along x"

    def __init__(self, options, scene):
        pass

    def add(self, particles, acceleration):
        acceleration[:, 0] += 1.0
"""


def test_a_force_without_a_potential_may_change_the_energy(tmp_path):
    (tmp_path / "wind.py").write_text(WIND)
    about = ended(
        tmp_path / "o", time={"step": 0.1, "steps": 10}, particles=[{"position": [[0.0, 0.0]], "velocity": [1.0, 0.0]}],
        effects={"wind": {"file": str(tmp_path / "wind.py")}},
    )  # fmt: skip
    assert not about["remarks"]


def test_an_effect_that_acts_in_contacts_is_counted(tmp_path):
    law, ball = {"restitution": 0.5, "friction": 0.5}, {"position": [[1.0, 0.1]], "velocity": [1.0, 0.0], "radius": 0.1}
    about = ended(
        tmp_path / "o", box={"lower": [0.0, 0.0], "upper": [4.0, 4.0]}, time={"step": 0.01, "steps": 20}, particles=[ball],
        effects={"uniform_gravity": {"acceleration": [0.0, -1.0]}, "walls": law, "rolling": {"resistance": 0.01}},
    )  # fmt: skip
    calls = {row["effect"]: row["calls"] for row in about["plan"]["effects"]}
    assert calls["walls"] == calls["rolling"] == 20


def test_late_collisions_are_told_of_all(tmp_path):
    """Also of those in steps that were done in order of time."""
    discs = {"count": 150, "position": "random", "radius": 0.1, "velocity": {"speed": 1.0}}
    about = ended(
        tmp_path / "o", box={"lower": [0.0, 0.0], "upper": [3.2, 3.2]}, time={"step": 0.02, "steps": 100}, particles=[discs],
        effects={"collisions": {"restitution": 0.9, "passes": 3}, "walls": {}},
    )  # fmt: skip
    late = [remark for remark in about["remarks"] if remark.startswith("collisions found late")]
    assert any("in order of time" in remark for remark in about["remarks"])
    assert late and f" of {about['counts']['collisions']};" in late[0]
