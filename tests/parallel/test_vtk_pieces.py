"""VTK frames of several pieces: read by VTK and meshio as they are in the trajectory, the same files on any number of ranks."""

import xml.etree.ElementTree as ElementTree

import h5py
import meshio
import numpy as np
import pytest
from conftest import run_ranks
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOXML import vtkXMLPUnstructuredGridReader, vtkXMLUnstructuredGridReader

pytestmark = pytest.mark.parallel
SCRIPT = "tests/parallel/vtk_pieces.py"
COUNTS = [12, 12, 52, 36, 6, 0]  # of particles in the frames of `change`
PIECES = {2: [0, 1, 2, 3], 3: [0, 2, 3]}  # frame: its pieces; the others are one file


def files(folder):
    """{name: bytes} of all files of the series."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in (folder / "vtk").rglob("*") if p.is_file()} | {
        "particles.pvd": (folder / "particles.pvd").read_bytes()
    }


def frames_of_trajectory(folder):
    """{name: column} of each frame."""
    with h5py.File(folder / "trajectory.vtkhdf") as file:
        group = file["VTKHDF"]
        begins, parts = group["Steps/PointOffsets"][:], group["Steps/PartOffsets"][:]
        for begin, count in zip(begins, group["NumberOfPoints"][:][parts], strict=True):
            columns = {name: column[begin : begin + count] for name, column in group["PointData"].items()}
            yield columns | {"Points": group["Points"][begin : begin + count]}


def read(path):
    """{name: column} as VTK reads it."""
    reader = (vtkXMLPUnstructuredGridReader if path.suffix == ".pvtu" else vtkXMLUnstructuredGridReader)()
    reader.SetFileName(str(path))
    reader.Update()
    grid, data = reader.GetOutput(), reader.GetOutput().GetPointData()
    assert reader.GetErrorCode() == 0
    columns = {data.GetArrayName(k): vtk_to_numpy(data.GetArray(k)) for k in range(data.GetNumberOfArrays())}
    cells = [grid.GetCell(k).GetPointId(0) for k in range(grid.GetNumberOfCells())]
    assert cells == list(range(grid.GetNumberOfPoints()))  # each particle is a vertex
    return columns | {"Points": vtk_to_numpy(grid.GetPoints().GetData()) if cells else np.zeros((0, 3))}


@pytest.fixture(scope="module")
def changing(tmp_path_factory):
    """Folders of the same run on 1, 2, 3 ranks."""
    folders = [tmp_path_factory.mktemp("ranks") / "o" for _ in range(3)]
    for ranks, folder in enumerate(folders, start=1):
        done = run_ranks(ranks, SCRIPT, folder, 16, "change")
        assert done.returncode == 0 and not done.stdout, done.stdout + done.stderr[-2000:]
    return folders


def test_files_are_the_same_on_any_number_of_ranks(changing):
    first, *others = (files(folder) for folder in changing)
    expected = {"particles.pvd"} | {f"vtk/particles_{5 * k:06d}.{'pvtu' if k in PIECES else 'vtu'}" for k in range(len(COUNTS))}
    expected |= {f"vtk/particles_{5 * k:06d}/piece_{n:06d}.vtu" for k, numbers in PIECES.items() for n in numbers}
    assert first.keys() == expected
    assert all(other == first for other in others)


def test_vtk_reads_what_is_in_the_trajectory(changing):
    entries = ElementTree.parse(changing[2] / "particles.pvd").iter("DataSet")
    for entry, frame, count in zip(entries, frames_of_trajectory(changing[2]), COUNTS, strict=True):
        columns = read(changing[2] / entry.get("file"))
        assert columns.keys() == frame.keys() and len(frame["id"]) == count
        for name, column in frame.items():
            assert columns[name].tobytes() == column.tobytes(), (entry.get("file"), name)


def test_meshio_reads_each_piece(changing):
    for frame, numbers in PIECES.items():
        pieces = [meshio.read(changing[1] / f"vtk/particles_{5 * frame:06d}/piece_{n:06d}.vtu") for n in numbers]
        wanted = list(frames_of_trajectory(changing[1]))[frame]
        assert (np.concatenate([piece.points for piece in pieces]) == wanted["Points"]).all()
        for number, piece in zip(numbers, pieces, strict=True):
            assert (piece.point_data["id"] // 16 == number).all()


@pytest.mark.parametrize(("what", "piece"), [("kill", 16), ("kill", 64), ("full", 16)])
def test_half_a_frame_is_never_listed_and_does_not_stay(tmp_path, what, piece):
    failed, whole = tmp_path / "failed", tmp_path / "whole"
    done = run_ranks(2, SCRIPT, failed, 16, what, fresh=what == "kill")
    left = [p.name for p in (failed / "vtk/particles_000005").glob("*")]
    if what == "kill":
        assert done.returncode != 0 and len(left) == 3
    else:
        said = f"rank 1: cannot write {failed}/vtk/particles_000005/piece_000001.vtu at step 5: "
        assert done.stdout.count(said) == 2 and done.stdout.count("No space left on device") == 2
        assert not (failed / "vtk/particles_000005").exists() and not list(failed.rglob("*.tmp"))
    assert (failed / "particles.pvd").read_text().count("DataSet") == 1
    assert run_ranks(3, SCRIPT, failed, piece, "run").returncode == 0
    assert run_ranks(1, SCRIPT, whole, piece, "run").returncode == 0
    listed = [entry.get("file") for entry in ElementTree.parse(failed / "particles.pvd").iter("DataSet")]
    kind = "pvtu" if piece == 16 else "vtu"
    assert listed == ["vtk/particles_000000.pvtu", f"vtk/particles_000005.{kind}", f"vtk/particles_000010.{kind}"]
    found, wanted = (
        {name: data for name, data in files(folder).items() if "_000005" in name or "_000010" in name}
        for folder in (failed, whole)
    )
    assert found == wanted
