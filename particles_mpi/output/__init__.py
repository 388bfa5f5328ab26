"""What a run leaves on disk: frames (HDF5 and VTK), checkpoints, diagnostics; and what all writers share.

A writer of a run to be continued first looks (its constructor, which changes nothing) and then cuts (`open`): what is wrong
with one file of a folder is found before another is touched.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from particles_mpi.errors import SceneError, StoppedError
from particles_mpi.parallel.agreement import describe_unexpected, raise_first
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import FIELDS, Array


@contextmanager
def failing_together(ranks: Communicator, task: str) -> Iterator[None]:
    """Run a block that touches files; what the file system refuses on any rank is a StoppedError on all. Collective.

    `task` begins the message: "cannot write out/particles.pvd at step 100". A SceneError stays one, on all ranks. A block may
    hold at most one collective call, its last: a rank that failed before one would leave the others waiting in it.
    """
    failure: Exception | None = None
    try:
        yield
    except SceneError as error:
        failure = error
    except (OSError, RuntimeError, ValueError, KeyError) as error:  # h5py raises all four for what is wrong with a file
        failure = StoppedError(f"{task}: {_reason(error)}")
    except Exception as error:  # also memory that is refused
        failure = StoppedError(f"{task}: {describe_unexpected(error)}")
    raise_first(ranks, failure, root_reads=True)


@contextmanager
def continuing(path: Path) -> Iterator[None]:
    """Read what a run left behind, in order to go on with it; whatever is wrong with the file is a SceneError that names it."""
    try:
        yield
    except Exception as error:  # damaged files raise anything
        raise SceneError(f"{path}: cannot be continued: {_reason(error)}") from None


def check_last(steps: list[int], resume_step: int, last: int | None) -> None:
    """Is `last` the last of the steps up to `resume_step` that a file holds? It was so when the checkpoint was written."""
    if sorted(set(steps)) != steps:
        raise ValueError("its steps are not in order")
    found = steps[-1] if steps else -1
    if last is not None and found != last:
        raise ValueError(
            f"it should hold step {last}, and up to step {resume_step} " + (f"ends at {found}" if steps else "is empty")
        )


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A name to write a file under, which becomes `path` when it is whole: at every moment `path` is the old file or the new."""
    part = path.with_name(path.name + ".tmp")
    try:
        yield part
        os.replace(part, path)
    except BaseException:
        part.unlink(missing_ok=True)  # half a file helps nobody, least of all on a full disk
        raise


def _reason(error: Exception) -> str:
    """One line; HDF5 hides the one that says why ("No space left on device") in a paragraph of addresses."""
    said = re.search(r"error message = '([^']+)'", str(error))
    return said[1] if said else (str(error) or type(error).__name__).splitlines()[0]


def frame_columns(name: str, dimension: int) -> dict[str, tuple[int, ...]]:
    """Names of the columns that a field becomes in a frame, and the shape of one row of each.

    Viewers know three axes: vectors have three columns, z = 0 in two dimensions. Beyond three dimensions the first three
    axes are drawn, and all of them stand beside: as `position`, and as `velocity_full`, `acceleration_full`.
    """
    if not FIELDS[name].vector:
        return {name: ()}
    columns: dict[str, tuple[int, ...]] = {"Points" if name == "position" else name: (3,)}
    if dimension > 3:
        columns[name if name == "position" else f"{name}_full"] = (dimension,)
    return columns


def frame_arrays(arrays: dict[str, Array], dimension: int) -> dict[str, Array]:
    """The columns of `frame_columns` for rows of particles; contiguous, bit for bit the values given."""
    columns = {}
    for name, values in arrays.items():
        for column, width in frame_columns(name, dimension).items():
            if width == (3,) and dimension != 3:
                padded = np.zeros((len(values), 3))
                padded[:, : min(dimension, 3)] = values[:, :3]
                columns[column] = padded
            else:
                columns[column] = np.ascontiguousarray(values, FIELDS[name].dtype)
    return columns


def sync_folder(folder: Path) -> None:
    """Make a rename inside the folder last through a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
