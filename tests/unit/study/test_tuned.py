"""The tuned scene: the author's text with other settings, and the same particles."""

import tomllib

import numpy as np
import pytest
from conftest import ROOT

from particles_mpi import Scene
from particles_mpi.initial.populate import populate
from particles_mpi.study.measuring.experiment import Lab
from particles_mpi.study.recommending.settings import curves
from particles_mpi.study.recommending.starts import Start
from particles_mpi.study.recommending.tuned import serialised, tuned, written

SCENES = sorted((ROOT / "particles_mpi" / "scenes").glob("*.toml"))
LIGHT = [path for path in SCENES if path.stem not in ("headline", "marbles", "plummer")]


@pytest.mark.parametrize("path", LIGHT, ids=lambda path: path.stem)
def test_every_setting_of_a_shipped_scene_can_be_written(path, tmp_path):
    scene = Scene.load(path)
    start, text = Start(Lab(), scene), path.read_text()
    for curve in curves(start):
        fineness = 1e6 if curve.adaptive else 2.0 * scene.steps
        tables = tuned(scene, curve.scene(fineness, 1.0), curve.steps(fineness, 1.0))
        target = tmp_path / "tuned.toml"
        target.write_text(written(tables, path, target, "tuned"))
        loaded = Scene.load(target)
        assert loaded.time.integrator == curve.integrator and loaded.steps == curve.steps(fineness, 1.0)
        assert loaded.steps * loaded.time.step == pytest.approx(scene.steps * scene.time.step, rel=1e-12)
        assert loaded.steps / loaded.output.every == pytest.approx(scene.steps / scene.output.every, rel=0.3)
        assert [line for line in text.splitlines() if line.startswith("#")] == [
            line for line in target.read_text().splitlines()[1:] if line.startswith("#")
        ]  # the author's remarks
        for name in ("position", "velocity", "mass"):
            assert np.array_equal(populate(loaded)[0][name], start.particles[name])


SCENE = """
dimension = 2
particles = [{position = {file = "start.csv"}, velocity = [1.0, 0.0], mass = 1e-3}]
effects.uniform_gravity.acceleration = [0, -9.81]
effects.drag = {rate = 0.5}
time = {step = 0.1, end = 2.0}
"""


def test_a_scene_of_another_make_is_written_anew_and_finds_its_files(tmp_path):
    (tmp_path / "start.csv").write_text("x,y\n0.5,0.25\n")
    path, target = tmp_path / "scene.toml", tmp_path / "deep" / "scene.tuned.toml"
    target.parent.mkdir()
    path.write_text(SCENE)
    scene = Scene.load(path)
    (curve,) = curves(Start(Lab(), scene))
    target.write_text(written(tuned(scene, curve.scene(40, 1.0), 40), path, target, "tuned"))
    loaded = Scene.load(target)
    assert loaded.time.end == 2.0 and loaded.steps == 40 and loaded.time.step == 0.05
    assert populate(loaded)[0].position.tolist() == [[0.5, 0.25]]


def test_serialised_tables_come_back():
    tables = {"a": 1e-5, "b": [[1.0, 2], []], "c": 'q"\n', "d": {"e": True, "f": {"g": [{"h": {"min": 0.1, "max": 1e300}}]}}}
    assert tomllib.loads("".join(serialised(tables))) == tables
