"""Started by mpirun in test_output.py: writes frames, checkpoints and diagnostics of made-up particles, spread at random.

write_frames.py FOLDER N DIMENSION FRAMES [--resume STEP] [--serial] [--no-vtk] [--limit BYTES] [--kill STEP] [--time]
"""

import argparse
import os
import resource
import signal
import time
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from particles_mpi.errors import SceneError, StoppedError
from particles_mpi.output import checkpoint
from particles_mpi.output.diagnostics_csv import Diagnostics
from particles_mpi.output.trajectory import Trajectory
from particles_mpi.parallel.agreement import wait_until_read
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import IdRange
from particles_mpi.particles import FIELDS, shape

EVERY = 10  # steps between frames


KNOWN = dict(FIELDS)  # before any scene has an effect with columns of its own
SHOWN = [name for name, column in KNOWN.items() if column.output]


def frame_of(step: int, total: int, dimension: int) -> dict[str, np.ndarray]:
    """All particles at a step, in id order, any bit patterns among the floats; the same in the writer and in the test."""
    rng = np.random.default_rng(step)
    arrays = {}
    for name, field in KNOWN.items():
        wanted = shape(name, total, dimension)
        if name == "id":
            arrays[name] = np.arange(total)
        elif field.dtype == "uint8":
            arrays[name] = rng.integers(0, 2, wanted, np.uint8)
        else:
            arrays[name] = rng.normal(size=wanted)
            arrays[name].flat[:3] = [-0.0, 5e-324, np.nan][: arrays[name].size]
    return arrays


def owned(ranks: Communicator, arrays: dict[str, np.ndarray], step: int) -> dict[str, np.ndarray]:
    """This rank's rows in random order; rank 1 has none, as a rank of an empty region."""
    total = len(arrays["id"])
    rng = np.random.default_rng(1000 + step)
    owner = rng.integers(0, ranks.size, total)
    owner[owner == 1] = 0
    mine = rng.permutation(total)
    mine = mine[owner[mine] == ranks.rank]
    return {name: array[mine] for name, array in arrays.items()}


class Watched(Trajectory):
    """Before HDF5 writes how long the file is, it must be so long: the run may be killed at any moment."""

    def _close(self) -> None:
        self.look(super()._close)

    def _flush(self) -> None:
        self.look(super()._flush)

    def look(self, write: Callable[[], None]) -> None:
        before = self.path.stat().st_size
        write()
        if self.ranks.is_root:
            with open(self.path, "rb") as file:
                told = int.from_bytes(file.read(48)[40:], "little")  # of a superblock of version 0
            assert before >= told, f"the file is said to have {told} bytes, and had {before}"


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    for name in ("total", "dimension", "frames"):
        parser.add_argument(name, type=int)
    for name in ("--resume", "--limit", "--kill"):
        parser.add_argument(name, type=int)
    for name in ("--serial", "--no-vtk", "--time"):
        parser.add_argument(name, action="store_true")
    options = parser.parse_args()
    ranks, n, d = Communicator(), options.total, options.dimension
    ids = IdRange(0, n, n)
    config, get_config = h5py.get_config(), h5py.get_config
    if options.serial:  # as if h5py had come without MPI
        h5py.get_config = lambda: type("Config", (), {"mpi": False, "track_order": config.track_order})()
    if options.limit:  # stands for a full disk
        resource.setrlimit(resource.RLIMIT_FSIZE, (options.limit, options.limit))
    try:
        trajectory = Watched(options.folder / "trajectory.vtkhdf", ranks, SHOWN, d, n, options.resume)
        diagnostics = Diagnostics(options.folder / "diagnostics.csv", ranks, ["step", "time", "particles"], options.resume)
        writers = [trajectory, diagnostics]
        if not options.no_vtk:
            from particles_mpi.output.vtk import VtkSeries

            series = VtkSeries(options.folder, ranks, d, options.resume)
            writers.append(series)
        for writer in writers:
            writer.open()
        begin = 0 if options.resume is None else options.resume + EVERY
        for step in range(begin, begin + EVERY * options.frames, EVERY):
            rows = owned(ranks, frame_of(step, n, d), step)
            shown = {name: rows[name] for name in SHOWN}
            ranks.comm.Barrier()
            started = time.perf_counter()
            trajectory.write(step, step / 3, shown, ids)
            if options.time and ranks.is_root:
                print(f"hdf5 {1e3 * (time.perf_counter() - started):.0f} ms")
            if not options.no_vtk:
                started = time.perf_counter()
                series.write(step, step / 3, shown, ids)
                if options.time and ranks.is_root:
                    print(f"vtu {1e3 * (time.perf_counter() - started):.0f} ms")
            started = time.perf_counter()
            facts = {"step": step, "time": step / 3, "scene": "scene π " * 20000, "counts": "{}"}
            trajectory.show()  # as a job does
            checkpoint.save(options.folder / "checkpoint.h5", ranks, rows, ids, d, facts)
            if options.time and ranks.is_root:
                print(f"checkpoint {1e3 * (time.perf_counter() - started):.0f} ms")
            diagnostics.write({"step": step, "time": step / 3, "particles": n})
            if options.kill == step:
                os.kill(os.getpid(), signal.SIGKILL)
        diagnostics.close()
        trajectory.close()
    except (SceneError, StoppedError) as stopped:
        print(f"STOPPED {ranks.rank} {stopped}", flush=True)
        wait_until_read(1, 1.0)
        ranks.comm.Barrier()  # mpirun ends all as soon as one has left
        raise SystemExit(stopped.exit_code) from None
    finally:
        h5py.get_config = get_config


if __name__ == "__main__":
    main()
