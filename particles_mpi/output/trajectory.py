"""All frames of a run, appended to one HDF5 file that ParaView opens; `layout` says how they lie there.

With parallel HDF5 each rank writes its range of ids, otherwise rank 0 writes all; the file is the same.
"""

import atexit
import ctypes
import os
import sys
from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from threading import RLock
from time import perf_counter
from typing import Any, NamedTuple

import h5py
import numpy as np

from particles_mpi.errors import StoppedError
from particles_mpi.output import layout
from particles_mpi.output.file_length import chunk_bytes, lengthen, make_room
from particles_mpi.output.files import (
    FILE_PATIENCE,
    Continuing,
    check_last,
    failing_together,
    frame_arrays,
    mpi_io_errors,
    open_everywhere,
)
from particles_mpi.output.frame_rows import write_frames, write_rows
from particles_mpi.output.read_frames import OPENING, SHOW
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import IdRange, in_id_order
from particles_mpi.particles import Array, default_values, row_bytes

SHOWING_PAUSE = 0.5  # seconds: frames that follow one another faster are shown to readers together
WAITING_BYTES = 2**20  # bytes: smaller frames wait for those that follow in that time, and are written by one call with them


class WaitingFrame(NamedTuple):
    """What a frame shows of this rank's range of ids, by place in the file."""

    step: int
    time: float
    columns: dict[str, Array]


class Trajectory(Continuing):
    """Writer of `trajectory.vtkhdf`; every method is collective.

    path: the file; frames up to `resume_step` are kept, and the last one kept must have `last_count` particles (`total` if
    that is None). fields: names of those that each frame shows. total: N at the start, of all ranks. planned: how many frames
    there will be, if all goes as planned.
    """

    def __init__(
        self, path: Path, ranks: Communicator, fields: list[str], dimension: int, total: int, resume_step: int | None = None,
        last: int | None = None, last_count: int | None = None, planned: int = 1,
    ):  # fmt: skip
        self.dimension, self.last_count, self.planned = dimension, total if last_count is None else last_count, planned
        frame = frame_arrays({name: default_values(name, 0, dimension) for name in fields}, dimension)
        self.columns = {layout.place_of(name): (rows.shape[1:], rows.dtype) for name, rows in frame.items()}
        self.row_bytes = row_bytes(*frame.values())
        self.parallel = ranks.size > 1 and bool(h5py.get_config().mpi)
        self.datasets: dict[str, Any] = {}
        self.bytes_at_opening = 0  # of the chunks of all of them
        self.frames, self.parts, self.points = 0, [total], 0  # so far; N of each part; rows of all frames
        self.failed = self.continued = False
        super().__init__(path, ranks, resume_step, last)
        self.frames, self.points, self.parts = ranks.bcast((self.frames, self.points, self.parts))
        self.shown, self.shown_at = self.frames, -np.inf  # frames that readers see, and since when
        self.waiting: list[WaitingFrame] = []  # not yet written, of particles with the ids `ids`
        self.ids = IdRange(0, 0, 0)
        self.lock = RLock()  # a reader in another thread of this process has frames shown while the run writes more
        self.collective = h5py.h5p.create(h5py.h5p.DATASET_XFER)
        if self.parallel:
            self.collective.set_dxpl_mpio(h5py.h5fd.MPIO_COLLECTIVE)

    def open(self) -> None:
        """Make the file, or cut it, and open it on all ranks that write."""
        with OPENING:
            super().open()  # by one process: cheaper, and nothing collective can go wrong
            if self.parallel:
                open_everywhere(self.ranks, self.path, f"cannot open {self.path}")
            with failing_together(self.ranks, f"cannot open {self.path}"):
                self._open()

    def _open(self) -> None:
        """Open the file, which is there, on all ranks that write."""
        if self.parallel:
            self.file = h5py.File(self.path, "r+", driver="mpio", comm=self.ranks.comm)
        elif self.ranks.is_root:
            # No lock: viewers may look at a running job. No cache: HDF5 would write whole chunks for each small frame
            self.file = h5py.File(self.path, "r+", locking=False, rdcc_nbytes=0)
            self.count = h5py.h5a.open(self.file["VTKHDF/Steps"].id, b"NSteps")
        if self.file is not None:
            names = (*self.columns, *layout.STEPS, *layout.PARTS, *(f"Vertices/{what}" for what in layout.CELLS))
            self.datasets = {name: self.file[f"VTKHDF/{name}"] for name in names}
            self.bytes_at_opening = chunk_bytes(self.datasets.values())
        if self.ranks.size == 1:
            SHOW[self.path.resolve()] = self.show

    def write(self, step: int, time: float, arrays: dict[str, Array], ids: IdRange) -> None:
        """Append a frame, or let it wait. `arrays`: this rank's owned rows in any order, of the fields given at the start."""
        rows = in_id_order(self.ranks, arrays, ids, self.ranks.size if self.parallel else 1)
        columns = {layout.place_of(name): column for name, column in frame_arrays(rows, self.dimension).items()}
        with self.lock:
            if self.waiting and ids != self.ids:
                self._write_waiting()
            self.ids = ids
            late = self.ranks.bcast(perf_counter() - self.shown_at > SHOWING_PAUSE)
            waits = not late and (len(self.waiting) + 1) * ids.total * self.row_bytes <= WAITING_BYTES
            if waits:  # the run goes on and changes its arrays
                columns = {place: column.copy() for place, column in columns.items()}
            self.waiting.append(WaitingFrame(step, time, columns))
            if late:
                self.show()
            elif not waits:
                self._write_waiting()

    def _write_waiting(self) -> None:
        """Write all frames that wait."""
        frames, total = self.waiting, self.ids.total
        if not frames:
            return
        self.waiting = []
        counts = self.ranks.allgather_array(np.array(len(next(iter(frames[0].columns.values())))))
        first = self.points + int(counts[: self.ranks.rank].sum())
        actions: list[Callable[[], None]] = []
        if total != self.parts[-1]:
            self.parts.append(total)
            actions.append(partial(self._append_part, len(self.parts), total))
        actions += [partial(self._append, place, first, [f.columns[place] for f in frames]) for place in self.columns]
        actions.append(partial(self._append_steps, frames))
        self._do(frames[-1].step, actions)
        self.step, self.frames, self.points = frames[-1].step, self.frames + len(frames), self.points + len(frames) * total

    def show(self) -> None:
        """Write what waits, and let readers see all frames.

        The count is raised after all that it counts has left this process: the file of a killed run is readable. Parallel
        HDF5 waits for the disk in each flush, but not when it closes a file: so it is closed and opened again.
        """
        with self.lock:
            self._write_waiting()
            if self.shown < self.frames:
                before, after = (self._close, self._open) if self.parallel else (self._flush, self._flush)
                with OPENING:
                    self._do(self.step, [self._lengthen, before, self._raise_count, after])
                self.shown, self.shown_at = self.frames, perf_counter()

    def wait_for_disk(self) -> None:
        """Does nothing: with a wait here, a frame of a million particles takes two and a half times as long.

        Nor would the file be safe after a power cut: HDF5 changes tables in the middle of it while it appends.
        """

    def close(self) -> None:
        """Close the file; after a failure it stays open until the process ends."""
        SHOW.pop(self.path.resolve(), None)
        with self.lock:
            if not self.failed:
                self.show()
                super().close()

    def _do(self, step: int, actions: list[Callable[[], None]]) -> None:
        """Change the file, on rank 0 or, with parallel HDF5, on all ranks, which agree after each action whether it went well."""
        reasons, patience = (mpi_io_errors, FILE_PATIENCE) if self.parallel else (nullcontext, 0.0)
        try:
            for action in actions:
                with failing_together(self.ranks, f"cannot write {self.path} at step {step}", patience), reasons():
                    if self.parallel or self.ranks.is_root:
                        action()
        except StoppedError:  # HDF5 crashes when it closes a file that it cannot flush, also at the end of the process
            self.failed = True
            for kept in (self.file, self.datasets):
                ctypes.pythonapi.Py_IncRef(ctypes.py_object(kept))
            if self.file is not None:
                atexit.register(_leave)
            raise

    def _lengthen(self) -> None:
        """Let the file be as long as it is about to say; see `file_length`."""
        if not self.parallel:
            lengthen(self.path, self.file)
        elif self.ranks.is_root:
            make_room(self.path, chunk_bytes(self.datasets.values()) - self.bytes_at_opening)

    def _flush(self) -> None:
        """Have HDF5 write what it holds back."""
        self.file.flush()

    def _close(self) -> None:
        self.datasets = {}
        self.file.close()

    def _raise_count(self) -> None:
        """Tell readers how many frames are whole; in parallel, rank 0 does while the file is closed."""
        if not self.parallel:
            self.count.write(np.array(self.frames, np.int64))
        elif self.ranks.is_root:
            with h5py.File(self.path, "r+", locking=False) as file:
                file["VTKHDF/Steps"].attrs.modify("NSteps", np.int64(self.frames))

    def _append(self, place: str, first: int, frames: list[Array]) -> None:
        """Write this rank's rows of a column of several frames of equal size, from row `first` of the file on.

        A single frame is a range of the file for each rank, which it writes alone, in half the time. Several have many small
        ranges, which all ranks write together.
        """
        total, dataset = self.parts[-1], self.datasets[place].id
        dataset.set_extent((self.points + len(frames) * total, *frames[0].shape[1:]))
        if len(frames) == 1:
            write_rows(dataset, first, frames[0])
        elif total:
            write_frames(dataset, first, total, frames, self.collective)

    def _append_part(self, parts: int, count: int) -> None:
        """From here on frames have `count` particles: the last of `parts`; the topology grows if there were never so many.

        Resizing is collective, writing a number is not.
        """
        for place in layout.PARTS:
            self.datasets[place].resize(parts, axis=0)
            if self.ranks.is_root:
                self.datasets[place][parts - 1] = layout.row_of_part(place, count)
        for extra, what in enumerate(layout.CELLS):
            dataset, rows = self.datasets[f"Vertices/{what}"], count + extra
            before = len(dataset)
            if rows > before:
                dataset.resize(rows, axis=0)
                if self.ranks.is_root:
                    layout.count_up(dataset, before, rows)

    def _append_steps(self, frames: list[WaitingFrame]) -> None:
        """The rows of these frames in every dataset of Steps; those that are not named here have their fill value."""
        number = len(frames)
        rows = {
            "Steps/Values": [frame.time for frame in frames],
            "Steps/Step": [frame.step for frame in frames],
            "Steps/PointOffsets": [self.points + i * self.parts[-1] for i in range(number)],
            "Steps/PartOffsets": [len(self.parts) - 1] * number,
        }
        memory = h5py.h5s.create_simple((number,))
        for place, (width, kind, _) in layout.STEPS.items():
            dataset = self.datasets[place].id
            dataset.set_extent((self.frames + number, *width))
            if self.ranks.is_root and place in rows:
                space = dataset.get_space()
                space.select_hyperslab((self.frames,), (number,))
                dataset.write(memory, space, np.array(rows[place], kind))

    def prepare(self) -> None:
        """Make the file, or remove the frames that are not kept."""
        if self.continued:
            layout.shorten(self.path, self.columns, self.frames, self.points, len(self.parts))
        else:
            layout.create(self.path, self.columns, self.parts[0], self.planned)

    def read_kept(self, resume_step: int, last: int | None) -> None:
        """How many frames of the old file are kept; the last of them must have `last_count` particles."""
        steps, self.points, self.parts = layout.frames_up_to(self.path, resume_step, self.columns, self.last_count)
        check_last(steps, resume_step, last)
        self.frames, self.continued = len(steps), True


def _leave() -> None:
    """End the process with the exit code of a StoppedError, without HDF5's own clean-up."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(StoppedError.exit_code)
