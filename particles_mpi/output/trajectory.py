"""All frames of a run in one HDF5 file that ParaView opens directly: VTKHDF PolyData; the README has its layout.

A frame has the N particles of its time in id order. Frames with the same N share one part (the numbers of points and cells), and
all frames share one topology: particle i is cell i. With parallel HDF5 each rank writes its range of ids, otherwise rank 0
writes all; the file is the same.
"""

from __future__ import annotations

import atexit
import ctypes
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from particles_mpi.errors import StoppedError
from particles_mpi.output.files import (
    check_last,
    continuing,
    failing_together,
    frame_arrays,
    frame_columns,
    mpi_io_errors,
    replacing,
)
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import IdRange, in_id_order
from particles_mpi.particles import FIELDS, Array, field

STEPS_CHUNK = 1024  # frames


class Trajectory:
    """Writer of `trajectory.vtkhdf`; every method is collective.

    path: the file. It is made anew, unless it exists and `resume_step` is given: then frames up to that step are kept and later
    ones removed; the last frame kept must be of step `last` and have `held` particles (`total` if that is None).
    particles_fields: names of fields; those not meant for frames are skipped. total: N at the start, of all ranks. Raises a
    SceneError on all ranks for a file that cannot be continued, before it is changed, and a StoppedError if the file system
    refuses.
    """

    def __init__(
        self,
        path: Path,
        ranks: Communicator,
        particles_fields: list[str],
        dimension: int,
        total: int,
        resume_step: int | None = None,
        last: int | None = None,
        held: int | None = None,
    ):
        self.path, self.ranks, self.dimension = Path(path), ranks, dimension
        self.parts, self.points = [total], 0  # N of each part; rows of all frames so far
        self.fields = [name for name in particles_fields if field(name).output]
        self.parallel = ranks.size > 1 and bool(h5py.get_config().mpi)
        self.writers = ranks.size if self.parallel else 1
        self.file: Any = None
        self.steps: dict[str, Any] = {}
        self.columns: dict[str, Any] = {}
        self.failed = False
        self.frames = 0
        self.continued = False
        with failing_together(ranks, f"cannot read {path}"):
            if ranks.is_root and resume_step is not None and self.path.exists():
                with continuing(self.path):
                    self.frames, self.continued = self._look(resume_step, last, total if held is None else held), True
        self.frames, self.points, self.parts = ranks.bcast((self.frames, self.points, self.parts))
        self.collective = h5py.h5p.create(h5py.h5p.DATASET_XFER)
        if self.parallel:
            self.collective.set_dxpl_mpio(h5py.h5fd.MPIO_COLLECTIVE)

    def open(self) -> None:
        """Make the file, or cut it, and open it on all ranks that write."""
        with failing_together(self.ranks, f"cannot prepare {self.path}"):
            if self.ranks.is_root:  # layout is made, and cut, by one process: cheaper, and nothing collective can go wrong
                self._prepare()
        with failing_together(self.ranks, f"cannot open {self.path}"):
            if self.parallel:
                self.file = h5py.File(self.path, "r+", driver="mpio", comm=self.ranks.comm)
            elif self.ranks.is_root:
                self.file = h5py.File(self.path, "r+", locking=False)  # no lock: viewers may look at a running job
        if self.file is not None:
            group = self.file["VTKHDF"]
            self.steps = {name: group["Steps"][name] for name in _steps_layout()}
            self.columns = {name: group[place] for name, place in self._places().items()}
            self.topology = {name: group[name] for name in _topology()}

    def write(self, step: int, time: float, arrays: dict[str, Array], ids: IdRange) -> None:
        """Append a frame. `arrays`: this rank's owned rows in any order, at least the fields given at the start."""
        rows = in_id_order(self.ranks, {n: arrays[n] for n in self.fields}, ids, self.writers)
        frame = frame_arrays(rows, self.dimension)
        first = self.points + int(self.ranks.allgather_array(np.array(len(rows["id"])))[: self.ranks.rank].sum())
        if ids.total != self.parts[-1]:
            self._attempt(step, self._append_part, ids.total)
            self.parts.append(ids.total)
        for name in frame:
            self._attempt(step, self._append, name, first, frame[name])
        self._attempt(step, self._append_step, step, time)
        # the count is raised after all that it counts has left this process: the file of a killed run is readable
        self._attempt(step, self._flush)
        self._attempt(step, self._raise_count)
        self._attempt(step, self._flush)
        self.frames += 1
        self.points += ids.total

    def close(self) -> None:
        """Close the file. The frames are safe without it; after a failure the file stays open until the process ends."""
        if self.file is not None and not self.failed:
            self.file.close()
            self.file = None

    def _attempt(self, step: int, action: Callable[..., None], *arguments: Any) -> None:
        try:
            with failing_together(self.ranks, f"cannot write {self.path} at step {step}"):
                if self.parallel:
                    with mpi_io_errors():
                        action(*arguments)
                elif self.file is not None:
                    action(*arguments)
        except StoppedError:
            self._abandon()
            raise

    def _abandon(self) -> None:
        """HDF5 crashes when it closes a file that it cannot flush, also at the end of the process: leave without closing it."""
        self.failed = True
        for kept in (self.file, self.steps, self.columns):
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(kept))
        if self.file is not None:
            atexit.register(_leave)

    def _raise_count(self) -> None:
        self.file["VTKHDF/Steps"].attrs.modify("NSteps", np.int64(self.frames + 1))

    def _flush(self) -> None:
        self.file.flush()

    def _append(self, name: str, first: int, values: Array) -> None:
        """Write this rank's rows of a column, from row `first` on. Ranks without rows take part too: the call is collective."""
        dataset = self.columns[name]
        dataset.resize(self.points + self.parts[-1], axis=0)
        if self.parts[-1] == 0:
            return
        space = dataset.id.get_space()
        memory = h5py.h5s.create_simple(values.shape)
        if len(values):
            space.select_hyperslab((first,) + (0,) * (values.ndim - 1), values.shape)
        else:
            space.select_none()
            memory.select_none()
        dataset.id.write(memory, space, values, dxpl=self.collective)

    def _append_part(self, count: int) -> None:
        """From here on frames have `count` particles; the topology is extended if there were never so many."""
        for name, dataset in self.topology.items():
            kind, what = name.split("/") if "/" in name else ("", name)
            if what in ("Connectivity", "Offsets"):
                extra = what == "Offsets"
                old, new = len(dataset), count + extra
                if kind == "Vertices" and new > old:
                    dataset.resize(new, axis=0)
                    if self.ranks.is_root:
                        dataset[old:] = np.arange(old, new)
            else:
                dataset.resize(len(self.parts) + 1, axis=0)
                if self.ranks.is_root:
                    dataset[len(self.parts)] = count if kind in ("", "Vertices") else 0

    def _append_step(self, step: int, time: float) -> None:
        """The row of this frame in every dataset of Steps whose value is not its fill value."""
        for dataset in self.steps.values():
            dataset.resize(self.frames + 1, axis=0)
        if self.ranks.is_root:  # resizing is collective, writing a number is not
            self.steps["Values"][self.frames] = time
            self.steps["Step"][self.frames] = step
            self.steps["PointOffsets"][self.frames] = self.points
            self.steps["PartOffsets"][self.frames] = len(self.parts) - 1

    def _places(self) -> dict[str, str]:
        """Where each column of a frame is, below /VTKHDF."""
        names = [column for field in self.fields for column in frame_columns(field, self.dimension)]
        return {name: name if name == "Points" else f"PointData/{name}" for name in names}

    def _prepare(self) -> None:
        """Make the file, or remove the frames that are not kept. Not collective."""
        if not self.continued:
            with replacing(self.path) as part, h5py.File(part, "w", locking=False) as file:
                self._create(file)
            return
        with h5py.File(self.path, "r+", locking=False) as file:
            group = file["VTKHDF"]
            group["Steps"].attrs.modify("NSteps", np.int64(self.frames))
            file.flush()
            for name in _steps_layout():
                group["Steps"][name].resize(self.frames, axis=0)
            for place in self._places().values():
                group[place].resize(self.points, axis=0)
            for name in _topology():
                if not name.endswith(("Connectivity", "Offsets")):
                    group[name].resize(len(self.parts), axis=0)

    def _look(self, resume_step: int, last: int | None, held: int) -> int:
        """How many frames of the old file are kept; the last of them must have `held` particles. Not collective."""
        with h5py.File(self.path, "r", locking=False) as file:
            group = file["VTKHDF"]
            steps = group["Steps"]
            columns = {"Points"} | {f"PointData/{name}" for name in group["PointData"]}
            numbers = [int(n) for n in steps["Step"][: int(steps.attrs["NSteps"])]]
            kept = [n for n in numbers if n <= resume_step]
            parts = steps["PartOffsets"][: len(kept)]
            sizes = group["NumberOfPoints"][:]
            points = int(sizes[parts].sum()) if len(parts) and parts.max() < len(sizes) else 0
            whole = numbers[: len(kept)] == kept and not (len(kept) and (parts.max() >= len(sizes) or parts.min() < 0))
            if whole and (columns != set(self._places().values()) or (len(parts) and sizes[parts[-1]] != held)):
                raise ValueError("it holds other particles or fields than the run to be continued")
            if not whole or any(len(group[place]) < points for place in columns):
                raise ValueError("it does not hold all of its frames")
            check_last(kept, resume_step, last)
            self.points, self.parts = points, sizes[: int(parts.max(initial=0)) + 1].tolist()
            return len(kept)

    def _create(self, file: Any) -> None:
        group = file.create_group("VTKHDF")
        group.attrs["Version"] = np.array([2, 0], np.int64)
        group.attrs["Type"] = np.bytes_("PolyData")  # fixed length: the reader refuses variable ones
        total = self.parts[0]
        chunk = int(np.clip(total, 256, 65536))
        for field_name in self.fields:
            for name, width in frame_columns(field_name, self.dimension).items():
                _dataset(group, self._places()[name], (0, *width), FIELDS[field_name].dtype, chunk)
        _dataset(group, "NumberOfPoints", (1,), "int64", 1, fill=total)
        for kind, cells in (("Vertices", total), ("Lines", 0), ("Polygons", 0), ("Strips", 0)):
            _dataset(group, f"{kind}/NumberOfCells", (1,), "int64", 1, fill=cells)
            _dataset(group, f"{kind}/NumberOfConnectivityIds", (1,), "int64", 1, fill=cells)
            _dataset(group, f"{kind}/Connectivity", (cells,), "int64", chunk)[:] = np.arange(cells)
            _dataset(group, f"{kind}/Offsets", (cells + 1,), "int64", chunk)[:] = np.arange(cells + 1)
        steps = group.create_group("Steps")
        steps.attrs["NSteps"] = np.int64(0)
        for name, (width, dtype, fill) in _steps_layout().items():
            _dataset(steps, name, (0, *width), dtype, STEPS_CHUNK, fill=fill)
        for place in self._places().values():
            if place != "Points":  # all columns begin where the points do: hard links to one dataset
                steps[place.replace("PointData/", "PointDataOffsets/")] = steps["PointOffsets"]


def _leave() -> None:
    """End the process with the exit code of a StoppedError, without HDF5's own clean-up."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(StoppedError.exit_code)


def _topology() -> list[str]:
    """Datasets with the number of points and cells of each part, and with the point of each cell."""
    kinds = ("Vertices", "Lines", "Polygons", "Strips")
    whats = ("NumberOfCells", "NumberOfConnectivityIds", "Connectivity", "Offsets")
    return ["NumberOfPoints", *(f"{kind}/{what}" for kind in kinds for what in whats)]


def _steps_layout() -> dict[str, tuple[tuple[int, ...], str, int]]:
    """Datasets of Steps: {name: (shape of a row, dtype, fill value)}. `Step` is an addition, which VTK ignores."""
    return {
        "Values": ((), "float64", 0),
        "Step": ((), "int64", 0),
        "PartOffsets": ((), "int64", 0),
        "NumberOfParts": ((), "int64", 1),
        "PointOffsets": ((), "int64", 0),
        "CellOffsets": ((4,), "int64", 0),
        "ConnectivityIdOffsets": ((4,), "int64", 0),
    }


def _dataset(group: Any, name: str, shape: tuple[int, ...], dtype: str, chunk: int, fill: int | None = None) -> Any:
    """Make a chunked, resizable dataset. Without a fill value new chunks are not written before the data is."""
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)  # parallel writing needs it, and a file made serially lacks it
    return group.create_dataset(
        name,
        shape,
        dtype,
        chunks=(chunk, *shape[1:]),
        maxshape=(None, *shape[1:]),
        fillvalue=fill,
        fill_time="never" if fill is None else "alloc",
        dcpl=properties,
    )
