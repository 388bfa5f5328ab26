"""The same frames as files `vtk/particles_%06d.vtu` and a list `particles.pvd`: for VisIt, and ParaView before 5.12."""

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import meshio
import numpy as np

from particles_mpi.output.files import Continuing, check_last, failing_together, frame_arrays, replacing
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import IdRange, in_id_order
from particles_mpi.particles import Array, field


class VtkSeries(Continuing):
    """Writer of a .vtu file for each frame, and of the .pvd file that lists them with their times; every method is collective."""

    def __init__(
        self, folder: Path, ranks: Communicator, dimension: int, resume_step: int | None = None, last: int | None = None
    ):
        self.folder, self.dimension = Path(folder), dimension
        self.frames: dict[int, str] = {}  # step → time as written
        super().__init__(self.folder / "particles.pvd", ranks, resume_step, last)

    def prepare(self) -> None:
        """Make the folder, or delete the frames that are not kept."""
        (self.folder / "vtk").mkdir(parents=True, exist_ok=True)
        if self.frames:
            self._write_listing()
        kept = {Path(self._name(step)).name for step in self.frames}
        for path in (self.folder / "vtk").glob("particles_*.vtu"):  # a killed run may not have listed its last
            if path.name not in kept:
                path.unlink()

    def write(self, step: int, time: float, arrays: dict[str, Array], ids: IdRange) -> None:
        """Add a frame. `arrays`: this rank's owned rows in any order, (n,) or (n, d); fields not meant for frames are skipped."""
        shown = {name: array for name, array in arrays.items() if field(name).output}
        rows = in_id_order(self.ranks, shown, ids, 1)
        path = self.folder / self._name(step)
        with failing_together(self.ranks, f"cannot write {path} at step {step}"):
            if self.ranks.is_root:
                with replacing(path) as part:
                    _write_vtu(part, frame_arrays(rows, self.dimension))
                self.frames[step] = repr(float(time))
                self._write_listing()

    @staticmethod
    def _name(step: int) -> str:
        return f"vtk/particles_{step:06d}.vtu"

    def _write_listing(self) -> None:
        lines = [f'    <DataSet timestep="{time}" part="0" file="{self._name(step)}"/>\n' for step, time in self.frames.items()]
        with replacing(self.path) as part:
            part.write_text(
                '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">\n  <Collection>\n'
                + "".join(lines)
                + "  </Collection>\n</VTKFile>\n"
            )

    def look(self, resume_step: int, last: int | None) -> None:
        """Read the list of frames up to a step."""
        for entry in ElementTree.parse(self.path).iter("DataSet"):
            numbers = re.findall(r"^vtk/particles_(\d+)\.vtu$", entry.get("file", ""))
            if not numbers:
                raise ValueError(f"it lists {entry.get('file')!r}, which this program did not write")
            if int(numbers[0]) <= resume_step:
                self.frames[int(numbers[0])] = repr(float(entry.get("timestep", "")))
        check_last(list(self.frames), resume_step, last)


def _write_vtu(path: Path, columns: dict[str, Array]) -> None:
    """Write one frame, binary and uncompressed. Each particle is a vertex cell: without cells ParaView shows nothing."""
    points = columns.pop("Points")
    cells = [("vertex", np.arange(len(points))[:, None])] if len(points) else []  # meshio raises for a kind without cells
    meshio.write(path, meshio.Mesh(points, cells, point_data=columns), file_format="vtu", binary=True, compression=None)
