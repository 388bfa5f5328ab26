"""What is on disk after a run on several ranks, read back by the readers that ParaView uses: every frame, every bit."""

import csv
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import h5py
import numpy as np
import pytest
from conftest import run_ranks
from write_frames import EVERY, frame_of

from particles_mpi.errors import SceneError
from particles_mpi.output import checkpoint
from particles_mpi.output.files import frame_arrays
from particles_mpi.particles import FIELDS

WRITER = str(Path(__file__).parent / "write_frames.py")
pytestmark = pytest.mark.parallel

CASES = [  # ranks, particles, dimension, options; rank 1 always owns none
    (1, 50, 3, []),
    (1, 200, 3, []),  # the second frame begins a chunk and does not fill it
    (2, 700, 3, []),
    (3, 700, 2, []),
    (3, 2, 3, []),
    (3, 1, 1, []),
    (3, 50, 4, []),
    (1, 0, 3, []),
    (2, 0, 2, []),
    (2, 700, 3, ["--serial"]),
    (3, 2, 2, ["--serial"]),
    (2, 70000, 2, ["--no-vtk"]),  # several chunks
    *(
        pytest.param(4, total, dimension, options, marks=pytest.mark.slow)
        for total, dimension, options in ((700, 2, []), (3, 3, []), (1, 1, []), (50, 4, []), (3, 2, ["--serial"]))
    ),
]


def expected(step: int, total: int, dimension: int) -> dict[str, np.ndarray]:
    shown = {name: array for name, array in frame_of(step, total, dimension).items() if FIELDS[name].output}
    return frame_arrays(shown, dimension)


def assert_same_bits(got: np.ndarray, wanted: np.ndarray) -> None:
    assert got.dtype == wanted.dtype
    assert got.shape == wanted.shape
    assert got.tobytes() == wanted.tobytes()


def columns_of(data) -> dict[str, np.ndarray]:
    """Points and point data of a VTK data set."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    point_data = data.GetPointData()
    arrays = {point_data.GetArrayName(i): vtk_to_numpy(point_data.GetArray(i)) for i in range(point_data.GetNumberOfArrays())}
    points = data.GetPoints()
    arrays["Points"] = vtk_to_numpy(points.GetData()) if points and points.GetNumberOfPoints() else np.zeros((0, 3))
    return arrays


def check_frame(columns: dict[str, np.ndarray], step: int, total: int, dimension: int) -> None:
    wanted = expected(step, total, dimension)
    assert set(columns) == set(wanted)
    if dimension in (2, 3):
        assert columns["spin"].shape == (total, 3) and (dimension == 3 or not columns["spin"][:, :2].any())
        assert np.array_equal(columns["spin"][:, 2], frame_of(step, total, dimension)["spin"][:, -1], equal_nan=True)
    for name, values in wanted.items():
        got = columns[name]
        if total:  # vtk gives ids as (n,), in its own name of the same integer type
            got = got.astype(values.dtype, casting="equiv")
            assert_same_bits(got, values)
        else:
            assert len(got) == 0


def check_vtkhdf(path: Path, steps: list[int], total: int, dimension: int) -> None:
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    assert reader.GetNumberOfSteps() == len(steps)
    for k, step in enumerate(steps):
        reader.SetStep(k)
        reader.Update()
        frame = reader.GetOutputDataObject(0)
        assert reader.GetTimeValue() == step / 3
        assert frame.GetNumberOfVerts() == frame.GetNumberOfCells() == total
        assert [frame.GetCell(i).GetPointId(0) for i in range(min(total, 100))] == list(range(min(total, 100)))
        check_frame(columns_of(frame), step, total, dimension)


def check_series(folder: Path, steps: list[int], total: int, dimension: int) -> None:
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

    entries = list(ElementTree.parse(folder / "particles.pvd").iter("DataSet"))
    assert [float(entry.get("timestep")) for entry in entries] == [step / 3 for step in steps]
    assert sorted(p.name for p in (folder / "vtk").iterdir()) == [f"particles_{step:06d}.vtu" for step in steps]
    for entry, step in zip(entries, steps, strict=True):
        reader = vtkXMLUnstructuredGridReader()
        reader.SetFileName(str(folder / entry.get("file")))
        reader.Update()
        assert reader.GetErrorCode() == 0
        assert reader.GetOutput().GetNumberOfCells() == total
        check_frame(columns_of(reader.GetOutput()), step, total, dimension)


def check_rest(folder: Path, steps: list[int], total: int, dimension: int) -> None:
    file = checkpoint.Checkpoint(folder / "checkpoint.h5")
    arrays, attributes = file.rows(0, file.total), file.attributes
    for name, values in frame_of(steps[-1], total, dimension).items():
        assert_same_bits(arrays[name], values)
    assert (attributes["step"], attributes["time"]) == (steps[-1], steps[-1] / 3)
    assert attributes["scene"] == "scene π " * 20000  # longer than HDF5's 64 KB of an attribute header
    with (folder / "diagnostics.csv").open(newline="") as lines:
        rows = list(csv.reader(lines))
    assert rows[0] == ["step", "time", "particles"]
    assert [(int(a), float(b), int(c)) for a, b, c in rows[1:]] == [(step, step / 3, total) for step in steps]


@pytest.mark.parametrize(("ranks", "total", "dimension", "options"), CASES)
def test_all_frames_come_back_bit_for_bit(tmp_path, ranks, total, dimension, options):
    done = run_ranks(ranks, WRITER, tmp_path, total, dimension, 3, *options)
    assert done.returncode == 0, done.stdout + done.stderr
    steps = [0, EVERY, 2 * EVERY]
    check_vtkhdf(tmp_path / "trajectory.vtkhdf", steps, total, dimension)
    with h5py.File(tmp_path / "trajectory.vtkhdf") as file:
        assert list(file["VTKHDF/Steps/Step"]) == steps
    if "--no-vtk" not in options:
        check_series(tmp_path, steps, total, dimension)
    check_rest(tmp_path, steps, total, dimension)
    assert not list(tmp_path.rglob("*.tmp"))


@pytest.mark.parametrize("options", [[], ["--serial"]])
def test_resume_cuts_later_frames_and_appends_on_other_ranks(tmp_path, options):
    assert run_ranks(2, WRITER, tmp_path, 300, 3, 4).returncode == 0  # steps 0 to 30
    done = run_ranks(3, WRITER, tmp_path, 300, 3, 1, "--resume", EVERY + 5, *options)  # keeps 0 and 10, goes on at 25
    assert done.returncode == 0, done.stdout + done.stderr
    steps = [0, EVERY, 2 * EVERY + 5]
    check_vtkhdf(tmp_path / "trajectory.vtkhdf", steps, 300, 3)
    check_series(tmp_path, steps, 300, 3)
    check_rest(tmp_path, steps, 300, 3)


@pytest.mark.parametrize("ranks", [1, 2])
def test_killed_run_is_readable_and_continues(tmp_path, ranks):
    assert run_ranks(ranks, WRITER, tmp_path, 300, 2, 5, "--kill", 2 * EVERY, fresh=True).returncode != 0
    steps = [0, EVERY, 2 * EVERY]
    check_vtkhdf(tmp_path / "trajectory.vtkhdf", steps, 300, 2)
    check_series(tmp_path, steps, 300, 2)
    done = run_ranks(ranks, WRITER, tmp_path, 300, 2, 1, "--resume", 2 * EVERY)
    assert done.returncode == 0, done.stdout + done.stderr
    check_vtkhdf(tmp_path / "trajectory.vtkhdf", [*steps, 3 * EVERY], 300, 2)
    check_series(tmp_path, [*steps, 3 * EVERY], 300, 2)


@pytest.mark.parametrize(("ranks", "options"), [(1, []), (2, []), (2, ["--serial"])])
def test_full_disk_stops_every_rank_and_names_file_and_step(tmp_path, ranks, options):
    done = run_ranks(ranks, WRITER, tmp_path, 20000, 3, 5, "--no-vtk", "--limit", 6_000_000, *options, fresh=True)
    assert done.returncode == 3
    messages = done.stdout.split("STOPPED")[1:]  # two ranks may share a line
    assert len(messages) == ranks, done.stdout + done.stderr
    assert all("cannot write" in text and " at step " in text and str(tmp_path) in text for text in messages)


def test_other_particles_are_not_appended(tmp_path):
    assert run_ranks(1, WRITER, tmp_path, 30, 3, 1).returncode == 0
    done = run_ranks(2, WRITER, tmp_path, 31, 3, 1, "--resume", 0)
    assert done.stdout.count("differs from the run to be continued in the number of particles") == 2


def test_checkpoint_that_is_none_is_one_clear_line(tmp_path):
    assert run_ranks(1, WRITER, tmp_path, 300, 3, 1).returncode == 0
    whole = (tmp_path / "checkpoint.h5").read_bytes()
    (tmp_path / "short.h5").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text.h5").write_text("no HDF5")
    for name in ("short.h5", "text.h5", "missing.h5", "trajectory.vtkhdf"):
        with pytest.raises(SceneError, match=name) as raised:
            checkpoint.Checkpoint(tmp_path / name)
        assert "\n" not in str(raised.value)
    part = checkpoint.Checkpoint(tmp_path / "checkpoint.h5").rows(100, 200)
    assert list(part["id"]) == list(range(100, 200))
