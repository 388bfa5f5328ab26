"""The same frames for VisIt, and for ParaView before 5.12: files in the folder `vtk`, and a list of them, `particles.pvd`.

A frame is cut into blocks of PIECE_IDS ids, on any number of ranks in the same way, and one rank writes a block: no rank holds
more of the frame. The only block of a small frame is the file `vtk/particles_000100.vtu`. The blocks of a large one are the
files `vtk/particles_000100/piece_000000.vtu` and so on, which `vtk/particles_000100.pvtu` names; readers open that one.
"""

import errno
import os
import re
import shutil
import xml.etree.ElementTree as ElementTree
from base64 import b64encode
from pathlib import Path

import meshio
import numpy as np

from particles_mpi.errors import StoppedError
from particles_mpi.output.files import Continuing, check_last, failing_together, frame_arrays
from particles_mpi.output.replacing import replace_text, replacing
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import IdRange, in_id_order
from particles_mpi.particles import Array, rows_of

PIECE_IDS = 2**20  # ids in a file
SMALL_BLOCK = 2**10  # particles in a block whose text is kept
DATA_ARRAY = re.compile(rb'<DataArray [^>]*Name="(?P<name>[^"]+)"[^>]*>\s*(?P<numbers>[^<\s]*)')
LIST_END = ["  </Collection>", "</VTKFile>"]  # the last lines of the list
NUMBER_KINDS = {"f": "Float", "i": "Int", "u": "UInt"}  # of numbers: as numpy and as VTK call them


def suffix(ids: IdRange) -> str:
    """The suffix of the file that readers open, of a frame with these ids: vtu, or pvtu if it has pieces."""
    return "pvtu" if ids.end - ids.first > PIECE_IDS else "vtu"


class VtkSeries(Continuing):
    """Writer of the files of each frame, and of the .pvd file that lists them with their times; every method is collective."""

    def __init__(
        self, folder: Path, ranks: Communicator, dimension: int, resume_step: int | None = None, last: int | None = None
    ):
        self.folder, self.dimension = Path(folder), dimension
        self.blocks = Blocks()
        self.frames: dict[int, tuple[str, str]] = {}  # step → (file, time as written), on rank 0
        super().__init__(self.folder / "particles.pvd", ranks, resume_step, last)

    def prepare(self) -> None:
        """Make the folder, or delete the frames that are not kept."""
        (self.folder / "vtk").mkdir(parents=True, exist_ok=True)
        if self.frames:
            self._write_listing()
        kept = {name for file, _ in self.frames.values() for name in (Path(file).name, Path(file).stem)}
        for path in (self.folder / "vtk").glob("particles_*"):  # a killed run may not have listed its last
            if path.name not in kept:
                shutil.rmtree(path) if path.is_dir() else path.unlink()

    def write(self, step: int, time: float, arrays: dict[str, Array], ids: IdRange) -> None:
        """Add a frame. `arrays`: this rank's owned rows in any order, (n,) or (n, d), of the fields that a frame shows."""
        path = self.folder / f"vtk/particles_{step:06d}.{suffix(ids)}"
        try:
            pieces = self._write_pieces(path, step, arrays, ids)
        except StoppedError:
            if self.ranks.is_root:
                shutil.rmtree(path.with_suffix(""), ignore_errors=True)  # pieces that no file names are of no use
            raise
        with failing_together(self.ranks, f"cannot write {path} at step {step}"):
            if self.ranks.is_root:
                if path.suffix == ".pvtu":
                    _write_pvtu(path, pieces, frame_arrays(rows_of(arrays, np.arange(0)), self.dimension))
                self.frames[step] = f"vtk/{path.name}", repr(float(time))
                self._list_last(step)

    def _write_pieces(self, path: Path, step: int, arrays: dict[str, Array], ids: IdRange) -> list[str]:
        """Write the blocks of a frame, as many at once as there are ranks. Returns the files of those that have particles."""
        together, pieces = self.ranks.size * PIECE_IDS, []
        for first in range(ids.first, max(ids.end, ids.first + 1), together):
            inside = np.flatnonzero((arrays["id"] >= first) & (arrays["id"] < first + together))
            blocks = IdRange(first, first + together, ids.total)
            rows = in_id_order(self.ranks, rows_of(arrays, inside), blocks, self.ranks.size)
            files = [path] * self.ranks.size
            if path.suffix == ".pvtu":
                begin = (first - ids.first) // PIECE_IDS
                files = [path.with_suffix("") / f"piece_{begin + rank:06d}.vtu" for rank in range(self.ranks.size)]
            counts = self.ranks.allgather_array(np.array(len(rows["id"])))
            pieces += [f"{path.stem}/{file.name}" for file, count in zip(files, counts, strict=True) if count]
            file = files[self.ranks.rank]
            with failing_together(self.ranks, f"cannot write {file} at step {step}"):
                if len(rows["id"]) or (self.ranks.is_root and not ids.total):
                    if path.suffix == ".pvtu":
                        file.parent.mkdir(exist_ok=True)
                    with replacing(file) as part:
                        self.blocks.write(part, frame_arrays(rows, self.dimension))
        return pieces

    def _write_listing(self) -> None:
        _write_xml(self.path, "Collection", ["  <Collection>", *map(self._entry, self.frames), LIST_END[0]])

    def _entry(self, step: int) -> str:
        """The line of a frame."""
        file, time = self.frames[step]
        return f'    <DataSet timestep="{time}" part="0" file="{file}"/>'

    def _list_last(self, step: int) -> None:
        """Add the line of a frame, by one write in the place of the last lines: a file system takes a hundred times as long to
        replace a file."""
        if len(self.frames) == 1:
            self._write_listing()
            return
        end = "".join(f"{line}\n" for line in LIST_END).encode()
        with self.path.open("r+b", buffering=0) as file:
            place = file.seek(-len(end), os.SEEK_END)
            try:
                written = file.write(added := f"{self._entry(step)}\n".encode() + end)
                if written < len(added):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            except OSError:
                file.truncate(place)
                file.seek(place)
                file.write(end)
                raise

    def read_kept(self, resume_step: int, last: int | None) -> None:
        """Read the list of frames up to a step."""
        for entry in ElementTree.parse(self.path).iter("DataSet"):
            file = entry.get("file", "")
            numbers = re.findall(r"^vtk/particles_(\d+)\.p?vtu$", file)
            if not numbers:
                raise ValueError(f"it lists {file!r}, which this program did not write")
            if int(numbers[0]) <= resume_step:
                self.frames[int(numbers[0])] = file, repr(float(entry.get("timestep", "")))
        check_last(list(self.frames), resume_step, last)
        gone = [step for step, (file, _) in self.frames.items() if not (self.folder / file).exists()]
        lost = [self.folder / self.frames.pop(step)[0] for step in gone]
        self.lost = [f"{file} is missing: {self.path.name} no longer lists it" for file in lost]


class Blocks:
    """Writes `.vtu` files by meshio. The XML around the numbers of a small one is kept for the next one of that shape."""

    def __init__(self) -> None:
        self.shape: list[tuple[str, tuple[int, ...]]] = []
        self.parts: list[tuple[bytes, str]] = []  # of that shape: text, and the column whose numbers follow, or ""

    def write(self, path: Path, columns: dict[str, Array]) -> None:
        """Write one block, binary and uncompressed: columns (n,) or (n, d), `Points` among them."""
        shape = [(name, column.shape) for name, column in columns.items()]
        if shape == self.shape:
            path.write_bytes(b"".join(text + (_encoded(columns[name]) if name else b"") for text, name in self.parts))
            return
        points, rest = columns["Points"], {name: column for name, column in columns.items() if name != "Points"}
        # Each particle is a vertex cell: without cells ParaView shows nothing. meshio raises for a kind without cells.
        cells = [("vertex", np.arange(len(points))[:, None])] if len(points) else []
        mesh = meshio.Mesh(points, cells, point_data=rest)
        meshio.write(path, mesh, file_format="vtu", binary=True, compression=None)
        if len(points) <= SMALL_BLOCK:
            self.shape, self.parts, begin = shape, [], 0
            text = path.read_bytes()
            topology = range(text.find(b"<Cells>"), text.find(b"</Cells>"))  # a column may have the name of an array in there
            for array in DATA_ARRAY.finditer(text):
                if (name := array["name"].decode()) in columns and array.start() not in topology:
                    self.parts.append((text[begin : array.start("numbers")], name))
                    begin = array.end("numbers")
            self.parts.append((text[begin:], ""))


def _encoded(column: Array) -> bytes:
    """The numbers of a column as they stand in a file: how many bytes, and these."""
    return b64encode(np.uint32(column.nbytes).tobytes() + column.tobytes())


def _write_pvtu(path: Path, pieces: list[str], columns: dict[str, Array]) -> None:
    """Write the file that names the pieces of a frame, which all have these columns."""
    lines = {}
    for name, column in columns.items():
        kind, width = f"{NUMBER_KINDS[column.dtype.kind]}{8 * column.dtype.itemsize}", column.shape[1:] or (1,)
        lines[name] = f'      <PDataArray type="{kind}" Name="{name}" NumberOfComponents="{width[0]}"/>'
    points = ["    <PPoints>", lines.pop("Points"), "    </PPoints>"]
    data = ["    <PPointData>", *lines.values(), "    </PPointData>"]
    sources = [f'    <Piece Source="{piece}"/>' for piece in pieces]
    grid = ['  <PUnstructuredGrid GhostLevel="0">', *points, *data, *sources, "  </PUnstructuredGrid>"]
    _write_xml(path, "PUnstructuredGrid", grid)


def _write_xml(path: Path, kind: str, lines: list[str]) -> None:
    """Write a file of VTK with these lines inside, replaced as a whole."""
    begin = ['<?xml version="1.0"?>', f'<VTKFile type="{kind}" version="0.1" byte_order="LittleEndian">']
    replace_text(path, "\n".join([*begin, *lines, f"{LIST_END[-1]}\n"]))
