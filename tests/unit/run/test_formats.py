"""VTK files of very many particles are written only for those who ask for them, and it is said."""

import pytest

from particles_mpi import Run, Scene, Simulation
from particles_mpi.run import files


@pytest.mark.parametrize(
    ("asked", "written"), [({}, False), ({"formats": ["vtk", "hdf5"]}, True), ({"formats": ["hdf5"]}, False)]
)
def test_vtk_files_of_many_particles(tmp_path, monkeypatch, asked, written):
    monkeypatch.setattr(files, "MOST_VTK", 5)
    tables = {"dimension": 2, "time": {"step": 0.1, "steps": 4}, "output": {"every": 2, "checkpoint_every": 2} | asked}
    for count, said, first in ((5, False, 2), (6, not asked, 0)):  # a run of no steps can be continued, too
        scene = Scene.from_dict({**tables, "particles": [{"position": [[k, 0.0] for k in range(count)]}], "effects": {}})
        sim, out, described = Simulation(scene), tmp_path / str(count), scene.to_dict()
        same = sim.copy()
        sim.to_json(tmp_path / "state.json")
        sim.run(out, steps=first)
        same.steps(first)
        assert sim == same  # what is written changes no simulation
        assert scene.to_dict() == described  # it may begin a second run
        again = Simulation.from_json(tmp_path / "state.json")
        again.run(tmp_path / f"again{count}")
        assert again.scene.output.formats == sim.scene.output.formats
        Simulation.resume(out / "checkpoint.h5").run(out, resumed=True)
        vtk = written or (count == 5 and "vtk" in scene.output.formats)
        assert (out / "trajectory.vtkhdf").exists()
        assert len(list((out / "vtk").glob("*.vtu"))) == 3 * vtk if vtk else not (out / "particles.pvd").exists()
        assert [w for w in sim.warnings if w.startswith("output.formats: no VTK files")] == sim.warnings[: int(said)]
        assert len(sim.warnings) == said


def test_a_file_of_frames_that_is_left_behind_is_told(tmp_path):
    """Whoever opens it would take it for the whole run."""
    tables = {"dimension": 2, "time": {"step": 0.1, "steps": 4}, "particles": [{"position": [[0.0, 0.0]]}], "effects": {}}
    for left, name in (("hdf5", "trajectory.vtkhdf"), ("vtk", "particles.pvd")):
        Simulation(Scene(**tables, output={"every": 1})).run(tmp_path / left, steps=2)
        sim = Simulation.resume(tmp_path / left / "checkpoint.h5")
        sim.scene.output.formats = [kind for kind in ("hdf5", "vtk") if kind != left]
        sim.run(tmp_path / left, resumed=True)
        (warning,) = sim.warnings
        assert f"{name} was written before step 2 and gets no more frames" in warning


def test_a_plan_without_formats_has_no_frames(tmp_path):
    tables = {"dimension": 2, "time": {"step": 0.1, "steps": 4}, "particles": [{"position": [[0.0, 0.0]]}], "effects": {}}
    Simulation(Scene(**tables, output={"formats": []})).run(tmp_path)
    assert Run(tmp_path).about["plan"]["frames"] == 0
