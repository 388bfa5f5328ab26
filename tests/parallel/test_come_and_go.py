"""Particles that are added and removed while a run goes on: ids, files and their readers, resume, on one and two ranks."""

import json
import subprocess
import sys

import numpy as np
import pytest
from conftest import ROOT, run_ranks
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOHDF import vtkHDFReader
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

from particles_mpi import Run, Scene, Simulation

pytestmark = pytest.mark.parallel
COUNTS = [50, 50, 50, 58, 58, 55, 55]  # in frames 0, 5, ... 30


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """{ranks: (folder, what was said)}."""
    told = {}
    for ranks in (1, 2):
        folder = tmp_path_factory.mktemp("ranks") / "o"
        done = run_ranks(ranks, "tests/parallel/come_and_go.py", folder)
        assert done.returncode == 0, done.stderr[-2000:]
        told[ranks] = folder, json.loads(done.stdout.splitlines()[-1])
    return told


def hdf_frames(folder):
    """The frames of a trajectory, one after the other, as the reader of ParaView gives them."""
    reader = vtkHDFReader()
    reader.SetFileName(str(folder / "trajectory.vtkhdf"))
    reader.UpdateInformation()
    for step in range(reader.GetNumberOfSteps()):
        reader.SetStep(step)
        reader.Update()
        yield reader.GetOutputDataObject(0)


@pytest.mark.parametrize("ranks", [1, 2])
def test_ids_counts_and_states(runs, ranks):
    said = runs[ranks][1]
    assert said["ids"] == [list(range(50, 58)), [58]]  # never those of the removed
    assert said["total"] == [55, 55, 55] and said["next id"] == [59, 59]
    assert said["resumed"] and said["json"] and said["copied"]


@pytest.mark.parametrize("ranks", [1, 2])
def test_what_cannot_be_is_refused_by_name(runs, ranks):
    said = runs[ranks][1]
    assert said["overlap"].startswith("effects.collisions: pair 7-58 overlaps (deepest by ")  # not "at the start"
    assert said["outside"].startswith("box: particle 58 outside")
    assert said["key"].startswith("particles[2].radios: unknown key")
    assert said["unknown"] == "remove: not found: particle 99"
    assert "step 25: lost: 1 particle" in said["lost"]


@pytest.mark.parametrize("ranks", [1, 2])
def test_frames_are_read_by_the_readers_of_paraview(runs, ranks):
    folder = runs[ranks][0]
    for frame, (data, count) in enumerate(zip(hdf_frames(folder), COUNTS, strict=True)):
        assert data.GetNumberOfPoints() == data.GetNumberOfVerts() == data.GetNumberOfCells() == count
        assert [data.GetCell(i).GetPointId(0) for i in range(count)] == list(range(count))
        ids = vtk_to_numpy(data.GetPointData().GetArray("id"))
        assert (np.diff(ids) > 0).all()
        series = vtkXMLUnstructuredGridReader()
        series.SetFileName(str(folder / f"vtk/particles_{5 * frame:06d}.vtu"))
        series.Update()
        assert (vtk_to_numpy(series.GetOutput().GetPointData().GetArray("id")) == ids).all()
        assert (vtk_to_numpy(series.GetOutput().GetPoints().GetData()) == vtk_to_numpy(data.GetPoints().GetData())).all()
    assert 3 not in ids and 58 in ids and 57 not in ids
    rows = (folder / "diagnostics.csv").read_text().splitlines()[1:]
    assert [int(row.split(",")[2]) for row in rows] == COUNTS


def test_runs_are_the_same_on_two_ranks_and_are_drawn(runs):
    compare = [sys.executable, str(ROOT / "python_viz/compare_runs.py"), str(runs[1][0]), str(runs[2][0])]
    done = subprocess.run(compare, capture_output=True, text=True)
    assert done.returncode == 0 and "same bits" in done.stdout, done.stdout + done.stderr
    done = subprocess.run(
        [sys.executable, str(ROOT / "python_viz/plot_paths.py"), str(runs[1][0])], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_numbers_that_change_again_and_again_within_one_run(tmp_path, seed):
    """By a user's own `step`, between frames that wait to be written together and those that do not; nobody may be left, too."""
    random, ids = np.random.default_rng(seed), []
    gas = {"position": random.random((3, 2)).tolist(), "velocity": [1.0, 0.0]}
    output = {"every": 1, "checkpoint_every": 3}
    sim = Simulation(Scene(dimension=2, time={"step": 0.1, "steps": 20}, output=output, particles=[gas]))
    ids.append(np.sort(sim.particles.id))
    step = sim.step

    def changing(*given):
        step(*given)
        if random.random() < 0.5:
            sim.remove(sim.particles.id[random.random(sim.total) < random.choice([0.3, 1.0])])
        if random.random() < 0.5:
            sim.add({"position": random.random((random.integers(1, 4), 2)).tolist()})
        ids.append(np.sort(sim.particles.id))

    sim.step = changing
    sim.run(tmp_path)
    assert len({len(one) for one in ids}) > 3
    for frame, there in zip(Run(tmp_path), ids, strict=True):
        np.testing.assert_array_equal(frame.id, there)
    for data, there in zip(hdf_frames(tmp_path), ids, strict=True):
        assert data.GetNumberOfPoints() == len(there)
        if len(there):
            np.testing.assert_array_equal(vtk_to_numpy(data.GetPointData().GetArray("id")), there)
