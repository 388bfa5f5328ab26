"""A run that is killed between any two writes of HDF5 into its trajectory leaves all frames that were there before."""

import io
import os
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
import pytest

from particles_mpi.output import layout
from particles_mpi.output.file_length import Uncut
from particles_mpi.output.trajectory import Trajectory
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import IdRange

COUNT = 256  # particles: as many as a chunk has rows at least


class Change(NamedTuple):
    """What was written where, and how long the file was after it; nothing where the file was cut or lengthened."""

    data: bytes
    place: int
    length: int


class Recorder(io.FileIO):
    """A file that remembers in `changes` what is done to it."""

    changes: list[Change]

    def note(self, data=b"", place=0):
        self.changes.append(Change(bytes(data), place, os.fstat(self.fileno()).st_size))

    def write(self, data):
        place, done = self.tell(), super().write(data)
        self.note(data, place)
        return done

    def truncate(self, size=None):
        done = super().truncate(size)
        self.note()
        return done


class RecordedUncut(Recorder, Uncut):
    """The same of a file that is made shorter when a run is continued."""

    def cut(self):
        super().cut()
        self.note()


def length_told(image):
    """How long a file says that it is, in its superblock, of version 0."""
    return int.from_bytes(image[40:48], "little")


def frames_in(path):
    """How many frames a trajectory has; each is whole."""
    with h5py.File(path, "r") as file:
        group = file["VTKHDF"]
        count = int(group["Steps"].attrs["NSteps"])
        assert np.array_equal(group["Steps/Step"][:count], np.arange(count))
        for place, extra in (("Points", 0.0), ("PointData/velocity", 0.5), ("PointData/radius", 0.25)):
            rows = group[place][: count * COUNT]
            assert (np.repeat(np.arange(count), COUNT) + extra == rows.T).all()
    return count


@pytest.fixture
def changes(monkeypatch):
    """All that is done to files which HDF5 opens to change them, from here on."""
    found, open_files, real = [], [], h5py.File

    def recorded(name, mode, **options):
        if mode == "r+" and isinstance(name, Path):
            open_files.append(name := Recorder(name, "r+"))
            options.pop("locking")
        return real(name, mode, **options)

    monkeypatch.setattr(Recorder, "changes", found, raising=False)
    monkeypatch.setattr(layout, "Uncut", RecordedUncut)
    monkeypatch.setattr(h5py, "File", recorded)
    yield found
    for file in open_files:
        file.close()


def writer(path, count, planned, resume_step=None):
    run = Trajectory(path, Communicator.alone(), ["id", "position", "velocity", "radius"], 3, count, resume_step, planned=planned)
    run.open()
    return run


def write(run, count, k):
    """Frame k, in which all numbers tell of k."""
    x = np.full((count, 3), float(k))
    rows = {"id": np.arange(count), "position": x, "velocity": x + 0.5, "radius": x[:, 0] + 0.25}
    run.write(k, float(k), rows, IdRange(0, count, count))


@pytest.mark.parametrize("frames", [5, 66])
def test_killed_between_any_two_writes(frames, tmp_path, changes):
    """While frames are written, and while the run is continued from a step before.

    66: with a chunk for each frame, HDF5 would divide a table.
    """
    path, kept = tmp_path / "trajectory.vtkhdf", frames // 2
    run = writer(path, COUNT, frames)
    image, shown = bytearray(path.read_bytes()), [(len(changes), 0)]  # changes so far, and the frames that readers see then
    for first in (0, kept):
        if first:
            run = writer(path, COUNT, frames, resume_step=kept - 1)
            shown.append((len(changes), kept))
        for k in range(first, frames):
            write(run, COUNT, k)
            run.show()
            shown.append((len(changes), k + 1))
        run.close()
    for (begin, before), (end, after) in pairwise(shown):
        for data, place, length in changes[begin:end]:
            image.extend(bytes(max(length - len(image), 0)))
            image[place : place + len(data)] = data
            del image[length:]
            if before >= frames - 4 or after < before:
                (tmp_path / "killed").write_bytes(image)
                assert min(before, after) <= frames_in(tmp_path / "killed") <= max(before, after)
    assert image == path.read_bytes() and shown[-1][0] > 10 * frames


def test_a_file_is_cut_when_it_has_been_told_that_it_is_shorter(tmp_path, changes):
    """HDF5 by itself, of a file that it has opened by its name, cuts it before."""
    path, count = tmp_path / "trajectory.vtkhdf", 1000
    run = writer(path, count, 50)
    for k in range(50):
        write(run, count, k)
    run.close()
    told, before = length_told(path.read_bytes()), path.stat().st_size
    changes.clear()
    layout.shorten(path, dict.fromkeys(run.columns), 10, 10 * count, 1)
    for data, place, length in changes:
        told = length_told(data) if place == 0 and data else told
        assert told <= length
    assert told == path.stat().st_size < before / 2


def test_a_small_frame_that_is_shown_writes_little_more_than_itself(tmp_path, changes):
    """Tables of some kilobytes, but not the chunks of which it is a small part."""
    run = writer(tmp_path / "trajectory.vtkhdf", 10, planned=20_000)
    changes.clear()
    for k in range(12):
        write(run, 10, k)
        run.show()
    run.close()
    assert sum(len(data) for data, _, _ in changes) < 12 * 20_000
