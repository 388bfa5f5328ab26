"""What a run writes while others read it, when a disk is full, and before a checkpoint counts on it."""

import os
import threading
from pathlib import Path
from time import perf_counter

import numpy as np
import pytest

from particles_mpi import Run, Scene, Simulation
from particles_mpi.errors import StoppedError
from particles_mpi.output import read_frames, trajectory
from particles_mpi.output.diagnostics_csv import Diagnostics
from particles_mpi.output.read_frames import FrameReader
from particles_mpi.output.trajectory import Trajectory
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import IdRange

HEAD = {"dimension": 1, "particles": [{"position": [[0.0]], "velocity": [1.0]}]}
OUTPUT = {"time": {"step": 0.1, "steps": 40}, "output": {"every": 10, "checkpoint_every": 10}}


def simulation():
    return Simulation(Scene(**HEAD, **OUTPUT))


def test_a_reader_and_the_run_write_one_after_the_other(tmp_path, monkeypatch):
    """A reader in another thread of the process has the frames written that wait; the run goes on writing meanwhile."""
    step, reader_is_at_it, goes_on = Trajectory._append_steps, threading.Event(), threading.Event()

    def slowly(self, frames):
        if not reader_is_at_it.is_set():
            reader_is_at_it.set()
            goes_on.wait(10.0)
        step(self, frames)

    monkeypatch.setattr(Trajectory, "_append_steps", slowly)
    file, rows = tmp_path / "trajectory.vtkhdf", {"id": np.array([0]), "position": np.array([[1.0]])}
    writer = Trajectory(file, Communicator.alone(), list(rows), 1, 1)
    writer.open()
    writer.shown_at = perf_counter()  # what comes next waits for half a second
    writer.write(0, 0.0, rows, IdRange(0, 1, 1))
    monkeypatch.setattr(trajectory, "WAITING_BYTES", 0)  # and what comes after that is written at once
    reader = threading.Thread(target=lambda: FrameReader(file).index())
    run = threading.Thread(target=lambda: writer.write(1, 0.1, rows, IdRange(0, 1, 1)))
    reader.start()
    assert reader_is_at_it.wait(10.0)
    run.start()
    run.join(0.2)
    goes_on.set()
    reader.join()
    run.join()
    writer.close()
    assert FrameReader(file).index().steps.tolist() == [0, 1]


def test_a_run_begins_while_another_thread_of_the_process_looks_for_it(tmp_path, monkeypatch):
    """HDF5 opens no file for writing that is open for reading in the same process: the run waits for the end of the look."""
    simulation().run(tmp_path / "o", steps=20)
    resumed = Simulation.resume(tmp_path / "o" / "checkpoint.h5")
    reader, looks, goes_on = FrameReader(tmp_path / "o" / "trajectory.vtkhdf"), threading.Event(), threading.Event()

    def slowly(group):
        looks.set()
        goes_on.wait(10.0)
        return index(group)

    index = read_frames._index
    monkeypatch.setattr(read_frames, "_index", slowly)
    look = threading.Thread(target=reader.index)
    run = threading.Thread(target=resumed.run, args=[tmp_path / "o"])
    look.start()
    assert looks.wait(10.0)
    run.start()
    run.join(0.3)
    goes_on.set()
    look.join()
    run.join()
    assert Run(tmp_path / "o").ended and len(Run(tmp_path / "o")) == 5


def test_a_disk_that_is_full_at_a_row_of_diagnostics_is_one_line(tmp_path, monkeypatch):
    """What the file still holds is refused again when it is closed: that must not take the place of the first error."""
    sim, measure = simulation(), Simulation.measure

    def full(*arguments, **options):
        if sim.steps_done == 20:
            os.dup2(device, files[0])
        return measure(*arguments, **options)

    prepare, files = Diagnostics.prepare, []
    monkeypatch.setattr(Diagnostics, "prepare", lambda self: (prepare(self), files.append(self.file.fileno())))
    monkeypatch.setattr(Simulation, "measure", full)
    device = os.open("/dev/full", os.O_WRONLY)
    try:
        with pytest.raises(StoppedError, match=r"cannot write .*diagnostics\.csv at step 20: .*No space left"):
            sim.run(tmp_path / "o")
    finally:
        os.close(device)


def test_what_a_checkpoint_counts_on_is_on_the_disk_before_it(tmp_path, monkeypatch):
    """After a power cut a run goes on only if what the checkpoint tells of is there; frames of HDF5 are not waited for."""
    synced, wait = [], os.fsync

    def record(descriptor):
        synced.append(Path(os.readlink(f"/proc/self/fd/{descriptor}")).name)
        wait(descriptor)

    monkeypatch.setattr(os, "fsync", record)
    simulation().run(tmp_path / "o", steps=10)
    assert synced == ["particles.pvd", "diagnostics.csv", "checkpoint.h5.tmp", "o"]
