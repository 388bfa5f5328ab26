"""Reads frames back from `trajectory.vtkhdf`, also while a run writes it; `trajectory` writes the file.

The file is opened for each access and closed again: a reader never sees what an earlier access left in a cache, and never stands
in the way of a writer. No lock is taken: the count of frames is raised last, so frames below it are whole.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from threading import RLock
from time import sleep, time_ns
from typing import Any, NamedTuple

import h5py
import numpy as np

from particles_mpi.errors import SceneError
from particles_mpi.output.layout import place_of
from particles_mpi.particles import Array

PAUSES = (0.0, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5)  # seconds between looks at a file that is being changed
TICK = 50_000_000  # nanoseconds: two changes of a file that follow one another faster may have the same time (Linux before 6.13)
OPENING = RLock()  # HDF5 does not open a file for writing that another thread of this process has open for reading
SHOW: dict[Path, Callable[[], None]] = {}  # of each file that this process alone writes: writes the frames that wait


class Index(NamedTuple):
    """Of the S frames that are whole, (S,) each: times, steps, counts of particles, first rows; and the names of the fields."""

    times: Array
    steps: Array
    counts: Array
    starts: Array
    fields: tuple[str, ...]


class FrameReader:
    """The frames of one file. Raises SceneError, one line, if it cannot be read."""

    def __init__(self, path: Path):
        self.path = path
        self.cached: dict[tuple[int, int], Index] = {}  # of the file as it was then

    def index(self) -> Index:
        """Return the index of the frames that are whole now; it is read again only if the file has changed."""
        if show := SHOW.get(self.path.resolve()):
            show()
        stamp, now = self._stamp(), time_ns()
        index: Index = self.cached.get(stamp) or self._read(_index)
        if abs(now - stamp[0]) >= TICK:
            self.cached = {stamp: index}
        return index

    def column(self, name: str, k: int) -> Array:
        """Rows of frame k >= 0, in id order: of `Points`, or of a field."""
        index = self.index()
        rows = slice(int(index.starts[k]), int(index.starts[k] + index.counts[k]))
        values: Array = self._read(lambda group: group[place_of(name)][rows])
        if len(values) != index.counts[k]:
            raise SceneError(f"{self.path}: frame {k} is not complete")
        return values

    def _stamp(self) -> tuple[int, int]:
        try:
            status = self.path.stat()
        except OSError as error:
            hint = '; a run writes it if output.formats has "hdf5"' if isinstance(error, FileNotFoundError) else ""
            raise SceneError(f"{self.path}: cannot be read ({error.strerror}{hint})") from None
        return status.st_mtime_ns, status.st_size

    def _read(self, read: Callable[[Any], Any]) -> Any:
        """What `read` finds in the group VTKHDF; where the file changes during a look, it looks again."""
        found, failure = None, ""
        for pause in PAUSES:
            if pause:  # also a sleep of no time gives the core away
                sleep(pause)
            before = self._stamp()
            try:
                with OPENING, opened(self.path) as file:
                    found = read(file["VTKHDF"])
            except (OSError, RuntimeError, ValueError, KeyError) as error:  # h5py raises all four for what is wrong with a file
                failure = (str(error) or type(error).__name__).splitlines()[0]
            else:
                if self._stamp() == before:
                    break
        if found is None:
            raise SceneError(f"{self.path}: cannot be read: {failure}")
        return found


def opened(path: Path) -> h5py.File:
    """The file to read, without a lock, for it may be written to; with one if a user has it open so in this process."""
    try:
        return h5py.File(path, "r", locking=False)
    except OSError as error:
        if "lock" not in str(error):
            raise
        return h5py.File(path, "r")


def _index(group: Any) -> Index:
    steps = group["Steps"]
    count = int(steps.attrs["NSteps"])  # the datasets may already be longer
    sizes = group["NumberOfPoints"][:][steps["PartOffsets"][:count]] if count else np.zeros(0, np.int64)
    fields = tuple(group["PointData"])
    return Index(steps["Values"][:count], steps["Step"][:count], sizes, steps["PointOffsets"][:count], fields)
