"""A run that does not begin leaves nothing behind in the process: signals mean what they meant, and no file is open."""

import shutil
import signal

import pytest

from particles_mpi import Scene, SceneError, Simulation, StoppedError
from particles_mpi.output.diagnostics_csv import Diagnostics
from particles_mpi.output.run_folder import changed_keys
from particles_mpi.parallel.signals import SIGNALS
from particles_mpi.run.console import Screen
from particles_mpi.run.files import RunFiles


def simulation():
    tables = {"time": {"step": 0.01, "steps": 3}, "particles": [{"position": [[0.0, 0.0]], "velocity": [1.0, 0.0]}]}
    return Simulation(Scene.from_dict({"dimension": 2, "effects": {}} | tables))


def another_run(folder, monkeypatch):
    simulation().run(folder)


def a_full_disk(folder, monkeypatch):
    monkeypatch.setattr(Diagnostics, "prepare", refuse)


def refuse(_):
    raise OSError("No space left on device")


def no_screen(folder, monkeypatch):
    monkeypatch.setattr(Screen, "plan", lambda *_: 1 // 0)


@pytest.mark.parametrize(
    "hindrance, error", [(another_run, SceneError), (a_full_disk, StoppedError), (no_screen, ZeroDivisionError)]
)
def test_a_refused_run_can_be_done_again(hindrance, error, tmp_path, monkeypatch):
    before = [signal.getsignal(number) for number in SIGNALS]
    hindrance(tmp_path / "out", monkeypatch)
    sim = simulation()
    with pytest.raises(error):
        sim.run(tmp_path / "out")
    assert [signal.getsignal(number) for number in SIGNALS] == before
    monkeypatch.undo()
    sim.run(tmp_path / "out", overwrite=True)
    assert sim.steps_done == 3 and (tmp_path / "out/run.json").exists()


@pytest.mark.parametrize("again", [False, True])
@pytest.mark.parametrize("formats", [["hdf5", "vtk"], []])
def test_a_folder_that_is_deleted_ends_the_run(tmp_path, monkeypatch, formats, again):
    """And nothing is written into the one that another run may have made in its place."""
    out, write_row = tmp_path / "out", RunFiles.write_row

    def delete_before(self, extra=False):
        if self.sim.steps_done == 2 and not extra:
            shutil.rmtree(out)
            if again:
                out.mkdir()
        return write_row(self, extra)

    monkeypatch.setattr(RunFiles, "write_row", delete_before)
    sim = simulation()
    sim.scene.output.formats, sim.scene.output.diagnostics_every = formats, 1
    with pytest.raises(StoppedError, match=f"cannot write into {out} at step 3: the folder was deleted, moved or replaced"):
        sim.run(out)
    assert out.exists() == again and (not again or not list(out.iterdir()))


def test_overwriting_deletes_only_what_runs_leave(tmp_path):
    """A file of the user's in a folder of the run stays, and so does what a link points to."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/a.txt").write_text("mine")
    simulation().run(tmp_path / "out")
    (tmp_path / "out/plots").mkdir()
    (tmp_path / "out/vtk/notes.txt").write_text("mine")
    (tmp_path / "out/plots/frame.png").write_text("old")
    (tmp_path / "out/checkpoint.h5").unlink()
    (tmp_path / "out/checkpoint.h5").symlink_to(tmp_path / "mine")
    old = (tmp_path / "out/vtk/particles_000003.vtu").stat().st_mtime_ns
    simulation().run(tmp_path / "out", overwrite=True)
    assert (tmp_path / "out/vtk/notes.txt").read_text() == (tmp_path / "mine/a.txt").read_text() == "mine"
    assert not (tmp_path / "out/plots").exists()
    assert (tmp_path / "out/vtk/particles_000003.vtu").stat().st_mtime_ns > old


def test_brackets_in_a_title_are_no_markup(tmp_path, capsys):
    sim = simulation()
    sim.scene = sim.scene.model_copy(update={"title": "[bold]hey[/nope] [red]x"})
    sim.run(tmp_path / "a[b]", quiet=False)
    assert capsys.readouterr().out.startswith("[bold]hey[/nope] [red]x: 1 particles")


@pytest.mark.parametrize("place", ["file", "file/under", "n" * 300])
def test_what_is_no_folder_is_refused(place, tmp_path):
    (tmp_path / "file").write_text("something")
    with pytest.raises(SceneError, match=r"^--output: "):
        simulation().run(tmp_path / place)
    assert [path.name for path in tmp_path.iterdir()] == ["file"] and (tmp_path / "file").read_text() == "something"


def test_keys_that_differ_are_named():
    """Within a population, too; not where the file of an effect is."""
    one = {"particles": [{"radius": 0.5}, {"radius": 0.5, "mass": 1.0}], "effects": {"mine": {"file": "here", "size": 1.0}}}
    two = {"particles": [{"radius": 0.5}, {"radius": 0.4, "mass": 1.0}], "effects": {"mine": {"file": "there", "size": 1.0}}}
    assert list(changed_keys(one, two)) == ["particles[1].radius"]
    assert list(changed_keys(one, two | {"particles": []})) == ["particles"]
