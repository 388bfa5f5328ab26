"""Runs read back: what was computed is what is read, whatever the dimension, and clear errors for what is not there."""

import shutil
import subprocess
import sys

import h5py
import numpy as np
import pytest

from particles_mpi import Run, Scene, SceneError, Simulation
from particles_mpi.results import page

GATE = """
from particles_mpi.particles import Column
from particles_mpi.scene.effect import EffectOptions, Force, Needs
class Options(EffectOptions): pass
class Effect(Force):
    formula = "dv/dt = q e_x"
    needs = Needs(columns={"tint": Column()})
    def __init__(self, options, scene): pass
    def add(self, p, total): total[:, 0] += p["tint"]
"""


def drifting(d, tmp_path, steps=3, **more):
    scene = {
        "dimension": d,
        "title": "Drift",
        "time": {"step": 0.25, "steps": steps},
        "particles": [{"position": [[float(i)] * d for i in range(4)], "velocity": [1.0] * d, "mass": [1.0, 2.0, 3.0, 4.0]}],
        "output": {"every": 1, "diagnostics_every": 1},
    }
    sim = Simulation(Scene(**(scene | more)))
    return sim, tmp_path / "run"


@pytest.mark.parametrize("d", [1, 2, 3, 4])
def test_every_field_of_every_frame_has_the_bits_of_the_simulation(tmp_path, d):
    sim, folder = drifting(d, tmp_path)
    sim.run(folder)
    twin, _ = drifting(d, tmp_path)
    run = Run(folder)
    assert run.times.tolist() == [0.0, 0.25, 0.5, 0.75] and len(run) == 4 and run.ended and run.dimension == d
    for frame in run:
        assert (frame.step, frame.time, len(frame)) == (twin.steps_done, twin.time, 4)
        for name in ("position", "velocity", "mass", "radius", "id"):
            kept, computed = frame[name], twin.particles[name]
            assert kept.dtype == computed.dtype and kept.shape == computed.shape and kept.tobytes() == computed.tobytes()
        assert not frame.fixed.any() and frame.speed == pytest.approx(np.sqrt(d))
        twin.step()
    assert [frame.index for frame in run[1:]] == [1, 2, 3] and run[-1].time == 0.75
    assert run.scene.to_dict() == sim.scene.to_dict() and run.title == "Drift"
    assert run.diagnostics.columns[:4].tolist() == ["step", "time", "particles", "kinetic"]
    assert run.diagnostics.particles.tolist() == [4] * 4 and run.columns["step"].dtype == np.int64


@pytest.mark.parametrize("d", [2, 3])
def test_fields_of_rough_spheres(tmp_path, d):
    """Spins have a component for each plane, orientations are an angle or a quaternion."""
    planes, spin = d * (d - 1) // 2, {2: [2.0, -3.0], 3: [[2.0, 1.0, 4.0], [0.0, 0.0, -3.0]]}
    ball = {"position": [[0.0] * d, [3.0] * d], "radius": 0.5, "spin": spin[d]}
    effects, output = {"collisions": {"friction": 0.3}}, {"every": 1, "orientation": True}
    sim, folder = drifting(d, tmp_path, particles=[ball], effects=effects, output=output)
    sim.run(folder)
    frame, data = Run(folder)[-1], Run(folder).to_xarray()
    assert set(frame.fields) > {"spin", "orientation", "moment_of_inertia", "velocity"}
    for name in frame.fields:
        assert frame[name].reshape(2, -1).tolist() == sim.particles[name].reshape(2, -1).tolist(), name
    assert frame.spin.shape == (2, planes) and frame.orientation.shape == ((2,) if d == 2 else (2, 4))
    assert data.spin.dims == ("time", "id", "axis" if d == 3 else "spin_component") and data.velocity.dims[-1] == "axis"
    assert data.orientation.dims[2:] == (("orientation_component",) if d == 3 else ())
    np.testing.assert_array_equal(data.spin[-1], frame.spin)
    turning = page.quantities(frame)["spin" if d == 2 else "|spin|"]  # as it is shown: with its sign in the plane
    assert turning == pytest.approx([2.0, -3.0] if d == 2 else [21**0.5, 3.0]) and {"spin", "position", "fixed"} <= set(
        dir(Run(folder)[0])
    )


def test_a_file_that_is_open_is_read(tmp_path):
    sim, folder = drifting(2, tmp_path)
    sim.run(folder)
    with h5py.File(folder / "trajectory.vtkhdf", "r"):
        assert Run(folder)[-1].position.tolist() == sim.particles.position.tolist()


def test_fields_that_only_some_runs_have(tmp_path):
    particles = [{"position": [[0.0, 0.0]], "drag": 2.0}, {"position": [[1.0, 0.0]], "fixed": True}]
    sim, folder = drifting(2, tmp_path, effects={"drag": {"rate": 0.5}}, particles=particles)
    sim.run(folder)
    frame = Run(folder)[0]
    assert frame.drag.tolist() == [2.0, 0.5] and frame.fixed.tolist() == [0, 1] and "drag" in frame.fields
    assert frame.id[frame.fixed].tolist() == [1]  # a mask of rows
    with pytest.raises(AttributeError, match=r"frame 0 has no field 'tint'; stored are position, .*velocity"):
        frame.tint  # noqa: B018


def test_a_field_of_the_users(tmp_path):
    (tmp_path / "gate.py").write_text(GATE)
    particles = [{"position": [[0.0], [1.0]], "tint": [0.5, -0.5]}]
    sim, folder = drifting(1, tmp_path, folder=tmp_path, effects={"gate": {"file": "gate.py"}}, particles=particles)
    sim.run(folder)
    assert Run(folder)[-1].tint.tolist() == [0.5, -0.5]


def test_particles_that_come_and_go(tmp_path):
    sim, folder = drifting(2, tmp_path, steps=3)
    sim.run(folder, steps=1)
    sim.remove([1])
    sim.add({"position": [[9.0, 9.0]], "mass": 7.0})
    sim.scene.output.checkpoint_every = 1
    sim.run(folder, resumed=True)
    run = Run(folder)
    assert [frame.id.tolist() for frame in run] == [[0, 1, 2, 3], [0, 1, 2, 3], [0, 2, 3, 4], [0, 2, 3, 4]]
    data = run.to_xarray("mass", "position")
    assert data.sizes == {"time": 4, "id": 5, "axis": 2} and data.time.values.tolist() == run.times.tolist()
    assert data.mass.sel(id=4).fillna(-1).values.tolist() == [-1, -1, 7, 7]
    assert data.mass.sel(id=1).fillna(-1).values.tolist() == [2, 2, -1, -1]
    assert data.position.sel(id=0, axis="x").values.tolist() == [0.0, 0.25, 0.5, 0.75]


@pytest.mark.parametrize("every", [1, 3])
def test_a_run_goes_on_in_its_folder_whatever_was_changed(tmp_path, every):
    """Options, particles and the step, between two runs into one folder; not once it has gone on by itself.

    The row with which the first one ends stays only if it is one of every so many.
    """
    ball = [{"position": [[1.0, 1.0]], "velocity": [2.0, 3.0], "radius": 0.1}]
    box, output = {"lower": [0.0, 0.0], "upper": [2.0, 2.0]}, {"every": 2, "diagnostics_every": every}
    scene = Scene(dimension=2, box=box, time={"step": 0.1, "steps": 20}, particles=ball, effects={"walls": {}}, output=output)
    sim, other = Simulation(scene), Simulation(scene)
    sim.run(tmp_path / "run", steps=5)
    other.steps(5)
    for one in (sim, other):
        one.effects["walls"].restitution = 0.5
        one.add({"position": [[0.5, 0.5]], "radius": 0.1})
        one.h = 0.05
    sim.run(tmp_path / "run", steps=12)
    other.steps(7)
    assert sim == other
    found = Run(tmp_path / "run")
    assert found.diagnostics["step"].tolist() == list(range(0, 13, every)) and [f.step for f in found] == list(range(0, 13, 2))
    assert found.about["scene"]["effects"]["walls"]["restitution"] == 0.5
    assert sum(found.diagnostics["wall_hits"]) == sim.totals["wall_hits"] > 0  # each is told once
    sim.run(tmp_path / "run", steps=12)  # nothing is left to do
    assert Run(tmp_path / "run").diagnostics["step"].tolist() == list(range(0, 13, every))
    shutil.rmtree(tmp_path / "run")
    sim.run(tmp_path / "run", steps=13)  # what was there is gone: it begins anew, with what is now
    assert [f.step for f in Run(tmp_path / "run")] == [12]
    sim.effects["walls"].restitution = 0.6
    sim.step()
    with pytest.raises(SceneError, match="already holds a run other than the one to be resumed"):
        sim.run(tmp_path / "run", resumed=True)
    with pytest.raises(SceneError, match="would end with step 12, but it is already at step 14"):
        sim.run(tmp_path / "new", steps=12)
    assert not (tmp_path / "new").exists()


def test_what_is_not_there_is_one_clear_line(tmp_path):
    with pytest.raises(SceneError, match="no such folder"):
        Run(tmp_path / "nothing")
    with pytest.raises(SceneError, match="holds no run"):
        Run(tmp_path)
    sim, folder = drifting(2, tmp_path, output={"every": 1, "formats": ["vtk"]})
    sim.run(folder)
    run = Run(folder)
    assert len(run.columns["time"]) == 2
    with pytest.raises(SceneError, match=r"trajectory\.vtkhdf: cannot be read"):
        len(run)
    (folder / "trajectory.vtkhdf").write_bytes(b"no HDF5 at all")
    with pytest.raises(SceneError, match=r"trajectory\.vtkhdf: cannot be read"):
        run[0]
    (folder / "diagnostics.csv").write_text("not a\ntable of\ndiagnostics\n")
    with pytest.raises(SceneError, match=r"diagnostics\.csv: cannot be read: its columns do not begin with step,time"):
        _ = run.columns
    for text in ("", "step,time,par"):
        (folder / "diagnostics.csv").write_text(text)
        with pytest.raises(SceneError, match=r"diagnostics\.csv: cannot be read: it has no whole line"):
            _ = run.columns
    with pytest.raises(IndexError, match="no frame -5: the run has frames 0 to 3"):
        sim, folder = drifting(2, tmp_path)
        sim.run(folder, overwrite=True)
        Run(folder)[-5]


def test_a_row_of_diagnostics_that_is_being_written_is_left_out(tmp_path):
    sim, folder = drifting(2, tmp_path)
    sim.run(folder)
    whole = Run(folder).columns["time"].tolist()
    with (folder / "diagnostics.csv").open("a") as file:
        file.write("4,1.0,")
    assert Run(folder).columns["time"].tolist() == whole


def test_without_pandas_a_clear_message(tmp_path):
    sim, folder = drifting(2, tmp_path)
    sim.run(folder)
    script = f"""
import sys
sys.modules["pandas"] = None
from particles_mpi import Run
run = Run({str(folder)!r})
try:
    run.diagnostics
except ImportError as error:
    print(error)
print(run.columns["kinetic"].tolist())
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=100)
    assert done.stdout.splitlines() == ["pandas is not installed: pip install pandas", str([10.0] * 4)]
