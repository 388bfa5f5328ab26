"""The files of small frames, which reuse what meshio wrote around the numbers of one before."""

import meshio
import numpy as np

from particles_mpi.output.files import frame_arrays
from particles_mpi.output.vtk import Blocks


def test_files_are_those_that_meshio_writes(tmp_path):
    """Byte for byte, when the particles or columns get more or fewer, for equal columns, no particles, numbers of any kind."""
    random, blocks = np.random.default_rng(1), Blocks()
    for n, names in ((3, "position velocity id"), (3, "position velocity id"), (0, "position id"), (0, "position id"), (2, "id")):
        for d in (2, 3, 3, 4):
            v = random.choice([np.nan, -0.0, 1e-310, 1.5], (n, d))
            rows = {"position": v, "velocity": v.copy(), "id": random.integers(0, 2**40, n)}
            columns = frame_arrays({name: rows[name] for name in {*names.split(), "position"}}, d)
            columns["offsets"] = random.integers(0, 9, n)  # as an effect of a user's own may call its column, and VTK the cells'
            blocks.write(tmp_path / "found.vtu", columns)
            points = columns.pop("Points")
            cells = [("vertex", np.arange(n)[:, None])] if n else []
            mesh = meshio.Mesh(points, cells, point_data=columns)
            meshio.write(tmp_path / "expected.vtu", mesh, binary=True, compression=None)
            assert (tmp_path / "found.vtu").read_bytes() == (tmp_path / "expected.vtu").read_bytes()
