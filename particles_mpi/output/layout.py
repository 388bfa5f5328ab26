"""How the frames of a run lie in `trajectory.vtkhdf`: VTKHDF PolyData. STEPS, PARTS and CELLS are the whole layout.

A frame has the N particles of its time in id order. Frames with the same N share one part (the numbers of points and cells), and
all frames share one topology: particle i is cell i.
"""

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from particles_mpi.output.file_length import Uncut
from particles_mpi.output.replacing import replacing

CELL_KINDS = ("Vertices", "Lines", "Polygons", "Strips")  # of cells: particles are vertices, there are no others
PARTS = ("NumberOfPoints", *(f"{kind}/{what}" for kind in CELL_KINDS for what in ("NumberOfCells", "NumberOfConnectivityIds")))
CELLS = ("Connectivity", "Offsets")  # the point of each cell, and where each cell begins
# HDF5 finds a chunk in tables of 64; a table that is full is divided into two, and for the tenths of a millisecond in which it
# writes them frames cannot be found: for ever, if the run is killed then. So a run as planned has fewer chunks, within limits.
CHUNKS = 60
LEAST_ROWS = 256, 65536  # a chunk of a column has at least the rows of a frame, within these limits
MOST_BYTES = 2**26  # and at most so many bytes (in the widest column; what is not written yet is a hole in the file),
MOST_FRAMES = 4  # or so many frames, if they have more,
HDF5_BYTES = 2**31  # and never more than that: HDF5 takes chunks below 2^32
LEAST_STEPS, MOST_STEPS = 1024, 16384  # rows of a chunk of Steps, which is filled when it is made
PARTS_ROWS = 64  # rows of a chunk of PARTS
TOPOLOGY_BLOCK = 2**20  # rows of the topology that are written at once
# Datasets with a row for each frame: (shape of a row, dtype, fill value). `Step` is an addition, which VTK ignores.
STEPS: dict[str, tuple[tuple[int, ...], str, int]] = {
    "Steps/Values": ((), "float64", 0),
    "Steps/Step": ((), "int64", 0),
    "Steps/PartOffsets": ((), "int64", 0),
    "Steps/NumberOfParts": ((), "int64", 1),
    "Steps/PointOffsets": ((), "int64", 0),
    "Steps/CellOffsets": ((4,), "int64", 0),
    "Steps/ConnectivityIdOffsets": ((4,), "int64", 0),
}
ColumnShapes = dict[str, tuple[tuple[int, ...], Any]]  # of a frame, by place in the file: (shape of a row, dtype)


def create(path: Path, columns: ColumnShapes, total: int, frames: int) -> None:
    """Make a file without frames, for frames of `total` particles first, so many of them if all goes as planned."""
    with replacing(path) as part, h5py.File(part, "w", locking=False) as file:
        group = file.create_group("VTKHDF")
        group.attrs["Version"] = np.array([2, 0], np.int64)
        group.attrs["Type"] = np.bytes_("PolyData")  # fixed length: the reader refuses variable ones
        widest = max(int(np.prod(width)) * np.dtype(dtype).itemsize for width, dtype in columns.values())
        most = min(max(MOST_BYTES, MOST_FRAMES * total * widest), HDF5_BYTES) // widest
        chunk = int(np.clip(total * frames // CHUNKS + 1, np.clip(total, *LEAST_ROWS), most))
        steps_chunk = int(np.clip(frames // CHUNKS + 1, LEAST_STEPS, MOST_STEPS))
        for place, (width, dtype) in columns.items():
            _dataset(group, place, (0, *width), dtype, chunk)
        for place in PARTS:
            _dataset(group, place, (1,), "int64", PARTS_ROWS, fill=row_of_part(place, total))
        for kind in CELL_KINDS:
            for extra, what in enumerate(CELLS):
                rows = (total if kind == "Vertices" else 0) + extra
                count_up(_dataset(group, f"{kind}/{what}", (rows,), "int64", max(rows, LEAST_ROWS[0])), 0, rows)
        for place, (width, kind, fill) in STEPS.items():
            _dataset(group, place, (0, *width), kind, steps_chunk, fill=fill)
        group["Steps"].attrs["NSteps"] = np.int64(0)
        for place in columns.keys() - {"Points"}:  # all columns begin where the points do: hard links to one dataset
            group[place.replace("PointData/", "Steps/PointDataOffsets/")] = group["Steps/PointOffsets"]


def frames_up_to(path: Path, resume_step: int, columns: ColumnShapes, last_count: int) -> tuple[list[int], int, list[int]]:
    """Of the frames of a file up to a step: (their steps, rows of all of them, the number of particles in each part).

    Raises a ValueError if they are not whole, if the file has other columns, or if the last has not `last_count` particles.
    """
    with h5py.File(path, "r", locking=False) as file:
        group, steps = file["VTKHDF"], file["VTKHDF/Steps"]
        found = {"Points"} | {f"PointData/{name}" for name in group["PointData"]}
        numbers = [int(n) for n in steps["Step"][: int(steps.attrs["NSteps"])]]
        kept = [n for n in numbers if n <= resume_step]
        parts, sizes = steps["PartOffsets"][: len(kept)], group["NumberOfPoints"][:]
        whole = numbers[: len(kept)] == kept and bool(((parts >= 0) & (parts < len(sizes))).all())
        points = int(sizes[parts].sum()) if whole else 0
        if whole and (found != columns.keys() or (kept and sizes[parts[-1]] != last_count)):
            other = ", ".join(sorted(name.removeprefix("PointData/") for name in found ^ columns.keys()))
            raise ValueError(f"it differs from the run to be continued in {other or 'the number of particles'}")
        if not whole or any(len(group[place]) < points for place in found):
            raise ValueError("some of its frames are missing")
        return kept, points, sizes[: int(parts.max(initial=0)) + 1].tolist()


def shorten(path: Path, columns: ColumnShapes, frames: int, points: int, parts: int) -> None:
    """Remove all but the first frames: so many, of so many points and parts."""
    with Uncut(path) as uncut:
        with h5py.File(uncut, "r+") as file:
            group = file["VTKHDF"]
            group["Steps"].attrs.modify("NSteps", np.int64(frames))
            file.flush()  # the count first, so that a reader never sees a frame that is gone
            for places, rows in ((STEPS, frames), (columns, points), (PARTS, parts)):
                for place in places:
                    group[place].resize(rows, axis=0)
        uncut.cut()


def place_of(name: str) -> str:
    """Where in the group VTKHDF a column of a frame is: Points, or the values of a field."""
    return name if name == "Points" else f"PointData/{name}"


def row_of_part(place: str, count: int) -> int:
    """The number in a dataset of PARTS for frames of `count` particles: so many points, so many vertices, and nothing else."""
    return count if place.startswith(("Number", "Vertices")) else 0


def count_up(dataset: Any, first: int, last: int) -> None:
    """Row i is i, for the rows first ... last - 1; a block at a time, so that memory does not grow with them."""
    for begin in range(first, last, TOPOLOGY_BLOCK):
        end = min(begin + TOPOLOGY_BLOCK, last)
        dataset[begin:end] = np.arange(begin, end)


def _dataset(group: Any, name: str, shape: tuple[int, ...], dtype: Any, chunk: int, fill: int | None = None) -> Any:
    """Make a chunked, resizable dataset. Without a fill value new chunks are not written before the data is."""
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)  # parallel writing needs it, and a file made serially lacks it
    sizes = {"chunks": (chunk, *shape[1:]), "maxshape": (None, *shape[1:])}
    filled = {"fillvalue": fill, "fill_time": "never" if fill is None else "alloc"}
    return group.create_dataset(name, shape, dtype, dcpl=properties, **sizes, **filled)
