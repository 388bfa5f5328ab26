"""A run that is killed between any two writes of HDF5 into its trajectory leaves all frames that were there before."""

import io
import os
from itertools import pairwise
from typing import NamedTuple

import h5py
import numpy as np
import pytest

from particles_mpi.output.trajectory import Trajectory
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import IdRange

COUNT = 256  # particles: as many as a chunk has rows at least


class Write(NamedTuple):
    """What was written where, and how long the file was after it."""

    data: bytes
    place: int
    length: int


class Recorder(io.FileIO):
    """A file that remembers what is written into it."""

    def __init__(self, path, writes):
        super().__init__(path, "r+b")
        self.writes = writes

    def write(self, data):
        place, done = self.tell(), super().write(data)
        self.writes.append(Write(bytes(data), place, os.fstat(self.fileno()).st_size))
        return done


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


@pytest.mark.parametrize("frames", [5, 66])
def test_killed_between_any_two_writes(frames, tmp_path, monkeypatch):
    """While frames are written, and while the run is continued from a step before.

    66: with a chunk for each frame, HDF5 would divide a table.
    """
    path, ids, writes, open_files = tmp_path / "trajectory.vtkhdf", IdRange(0, COUNT, COUNT), [], []
    real = h5py.File

    def recorded(name, mode, locking):
        if mode == "r+":
            open_files.append(name := Recorder(name, writes))
        return real(name, mode)

    def writer(resume_step=None):
        return Trajectory(path, alone, ["id", "position", "velocity", "radius"], 3, COUNT, resume_step, planned=frames)

    def write(run, first):
        for k in range(first, frames):
            x = np.full((COUNT, 3), float(k))
            run.write(k, float(k), {"id": np.arange(COUNT), "position": x, "velocity": x + 0.5, "radius": x[:, 0] + 0.25}, ids)
            run.show()
            shown.append((len(writes), k + 1))
        run.close()

    alone, kept = Communicator.alone(), frames // 2
    monkeypatch.setattr(h5py, "File", recorded)
    run = writer()
    run.open()
    image, shown = bytearray(path.read_bytes()), [(len(writes), 0)]  # writes so far, and the frames that readers see then
    write(run, 0)
    run = writer(resume_step=kept - 1)
    run.open()
    shown.append((len(writes), kept))
    write(run, kept)
    monkeypatch.undo()
    for file in open_files:
        file.close()
    for (begin, before), (end, after) in pairwise(shown):
        for data, place, length in writes[begin:end]:
            image.extend(bytes(max(length - len(image), 0)))
            image[place : place + len(data)] = data
            if before >= frames - 4 or after < before:
                (tmp_path / "killed").write_bytes(image)
                assert min(before, after) <= frames_in(tmp_path / "killed") <= max(before, after)
    assert image[: path.stat().st_size] == path.read_bytes() and shown[-1][0] > 10 * frames
