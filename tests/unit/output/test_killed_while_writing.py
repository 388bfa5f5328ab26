"""A run that is killed between any two writes of HDF5 into its trajectory leaves all frames that were there before."""

import io
import os
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


@pytest.mark.parametrize("frames", [5, 70])
def test_killed_between_any_two_writes(frames, tmp_path, monkeypatch):
    """70 frames: with a chunk for each, HDF5 would divide a table."""
    path, ids, writes, shown = tmp_path / "trajectory.vtkhdf", IdRange(0, COUNT, COUNT), [], []
    real, open_files = h5py.File, []

    def recorded(name, mode, locking):
        if mode == "r+":
            open_files.append(name := Recorder(name, writes))
        return real(name, mode)

    monkeypatch.setattr(h5py, "File", recorded)
    writer = Trajectory(path, Communicator.alone(), ["id", "position", "velocity", "radius"], 3, COUNT, planned=frames)
    writer.open()
    image = bytearray(path.read_bytes())
    for k in range(frames):
        x = np.full((COUNT, 3), float(k))
        writer.write(k, float(k), {"id": np.arange(COUNT), "position": x, "velocity": x + 0.5, "radius": x[:, 0] + 0.25}, ids)
        writer.show()
        shown.append(len(writes))
    writer.close()
    monkeypatch.undo()
    for file in open_files:
        file.close()
    for number, (data, place, length) in enumerate(writes, 1):
        image.extend(bytes(max(length - len(image), 0)))
        image[place : place + len(data)] = data
        before = sum(at <= number for at in shown)  # frames of which the run knows that readers see them
        if before >= frames - 10:
            (tmp_path / "killed").write_bytes(image)
            assert before <= frames_in(tmp_path / "killed") <= before + 1
    assert image == path.read_bytes() and shown[-1] > 10 * frames
