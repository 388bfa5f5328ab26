"""The tuned scene: the author's text with other settings, and the same particles."""

import tomllib
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT

from particles_mpi import Scene, SceneError
from particles_mpi.initial.populate import populate
from particles_mpi.study.experiment import Benchmark
from particles_mpi.study.recommend.methods import methods
from particles_mpi.study.recommend.recommend import recommend_scene
from particles_mpi.study.recommend.runs import Start
from particles_mpi.study.recommend.tuned import tuned, written

SCENES = sorted((ROOT / "particles_mpi" / "scenes").glob("*.toml"))
LIGHT = [path for path in SCENES if path.stem not in ("headline", "marbles", "plummer")]


@pytest.mark.parametrize("path", LIGHT, ids=lambda path: path.stem)
def test_every_setting_of_a_shipped_scene_can_be_written(path, tmp_path):
    scene = Scene.load(path)
    start, text = Start(Benchmark(), scene), path.read_text()
    for method in methods(start):
        resolution = 1e6 if method.adaptive else 2.0 * scene.steps
        tables = tuned(scene, method.scene(resolution, 1.0), method.steps(resolution, 1.0))
        target = tmp_path / "tuned.toml"
        target.write_text(written(tables, path, target, "tuned"))
        loaded = Scene.load(target)
        assert loaded.time.integrator == method.integrator and loaded.steps == method.steps(resolution, 1.0)
        assert loaded.steps * loaded.time.step == pytest.approx(scene.steps * scene.time.step, rel=1e-12)
        assert loaded.steps / loaded.output.every == pytest.approx(scene.steps / scene.output.every, rel=0.3)
        assert [line for line in text.splitlines() if line.startswith("#")] == [
            line for line in target.read_text().splitlines()[1:] if line.startswith("#")
        ]  # the author's remarks
        for name in ("position", "velocity", "mass"):
            assert np.array_equal(populate(loaded)[0][name], start.particles[name])


PULL = """
from particles_mpi.effects import EffectOptions, Force
class Options(EffectOptions): pass
class Effect(Force):
    formula = "dv/dt = e_x"
    def __init__(self, options, scene): pass
    def add(self, p, total): total[:, 0] += 1.0
"""
SCENE = """
dimension = 2
particles = [{position = {file = "start.csv"}, velocity = [1.0, 0.0], mass = 1e-3}]
effects.uniform_gravity.acceleration = [0, -9.81]
effects.drag = {rate = 0.5}
time = {step = 0.1, end = 2.0}
"""


def test_a_scene_of_another_make_finds_its_files(tmp_path):
    (tmp_path / "start.csv").write_text("x,y\n0.5,0.25\n")
    (tmp_path / "pull.py").write_text(PULL)
    path, target = tmp_path / "scene.toml", tmp_path / "deep" / "scene.tuned.toml"
    target.parent.mkdir()
    path.write_text(SCENE + '[effects.pull]\nfile = "pull.py"\n')
    scene = Scene.load(path)
    (method,) = methods(Start(Benchmark(), scene))
    target.write_text(written(tuned(scene, method.scene(40, 1.0), 40), path, target, "tuned"))
    loaded = Scene.load(target)
    assert loaded.time.end == 2.0 and loaded.steps == 40 and loaded.time.step == 0.05
    assert populate(loaded)[0].position.tolist() == [[0.5, 0.25]]
    assert 'file = "../pull.py"' in target.read_text() and loaded.effects == scene.effects


def test_remarks_and_forms_of_the_author_stay(tmp_path):
    """Only what is other changes: the remark of a changed line, a table in one line, and what the program does not tune."""
    path, target = tmp_path / "scene.toml", tmp_path / "scene.tuned.toml"
    path.write_text(
        "# A fall.\n" + SCENE.replace('{file = "start.csv"}', "[[0.5, 0.25]]").replace("end = 2.0}", "end = 2.0} # short")
    )
    scene = Scene.load(path)
    (method,) = methods(Start(Benchmark(), scene))
    text = written(tuned(scene, method.scene(40, 1.0), 40), path, target, "tuned")
    assert text.startswith("# tuned\n# A fall.\n") and "time = {step = 0.05, end = 2.0} # short" in text
    assert tomllib.loads(text)["particles"] == tomllib.loads(path.read_text())["particles"]
    assert [line for line in path.read_text().splitlines() if line not in text] == ["time = {step = 0.1, end = 2.0} # short"]


def test_where_nothing_may_be_written_nothing_is_measured(tmp_path):
    """In no folder, in place of a folder, or of the scene itself."""
    path = tmp_path / "scene.toml"
    path.write_text(SCENE.replace('{file = "start.csv"}', "[[0.5, 0.25]]"))
    module = import_module("particles_mpi.study.recommend.recommend")
    for nowhere in (tmp_path, Path("/proc/none/tuned.toml")):
        with pytest.MonkeyPatch.context() as patch, pytest.raises(SceneError, match=r"^--output .*: cannot be written"):
            patch.setattr(module, "recommend", lambda *_: pytest.fail("it was measured before"))
            recommend_scene(path, 1e-3, output=nowhere)
    with pytest.raises(SceneError, match="is the scene file itself"):
        recommend_scene(path, 1e-3, output=tmp_path / ".." / tmp_path.name / "scene.toml")
