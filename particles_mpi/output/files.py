"""What all writers share: errors of the file system on all ranks, folders, the columns of a frame."""

import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from particles_mpi.errors import SceneError, StoppedError
from particles_mpi.output.replacing import replace_text
from particles_mpi.parallel.agreement import await_all, describe_unexpected, raise_first
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import FIELDS, FULL, Array

MPI_IO_ERROR = re.compile(r"error in \(?p?\)?\(?(?:write|read)\(?v?\)?: *(.+)")
FILE_PATIENCE = 10.0  # seconds that ranks wait for one another in parallel HDF5 and MPI-IO, after one of them has failed


@contextmanager
def failing_together(ranks: Communicator, task: str, patience: float = 0.0) -> Iterator[None]:
    """Run a block that uses files; what the file system refuses on any rank is a StoppedError on all ranks. Collective.

    `task` begins the message: "cannot write out/particles.pvd at step 100". A SceneError remains one, on all ranks. In a block
    with collective calls a rank that fails may leave others waiting in one of them: if they do not come within `patience`
    seconds, it ends all ranks.
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
    if patience and ranks.size > 1:
        await_all(ranks, failure, patience)
    raise_first(ranks, failure, root_reads=True)


def make_folder(ranks: Communicator, folder: Path) -> None:
    """Make a folder for results, if it is not there. Raises a StoppedError on all ranks if that is refused. Collective."""
    with failing_together(ranks, f"cannot write into {folder}"):
        if ranks.is_root:
            folder.mkdir(parents=True, exist_ok=True)


def identity_of(path: Path, ranks: Communicator) -> tuple[int, int] | None:
    """(inode, time of the last change in ns) of a file, on all ranks; None if there is none. Collective.

    They tell a file from another one that takes its place.
    """
    found = None
    if ranks.is_root:
        with suppress(OSError):
            status = path.stat()
            found = status.st_ino, status.st_mtime_ns
    return ranks.bcast(found)


class Continuing:
    """A file that rank 0 reads when a run goes on, before anything is changed. Every method is collective.

    With `resume_step` what it holds up to that step is kept and the rest removed in `open`; the last that is kept must be of
    step `last`. Otherwise it begins anew. Raises a SceneError on all ranks for a file that cannot be continued, and a
    StoppedError if the file system refuses.
    """

    file: Any = None  # what is open
    lost: Sequence[str] = ()  # on rank 0: a line for each file that should be there, and is not

    def __init__(self, path: Path, ranks: Communicator, resume_step: int | None, last: int | None):
        self.path, self.ranks = Path(path), ranks
        with failing_together(ranks, f"cannot read {path}"):
            if ranks.is_root and resume_step is not None and not self.path.exists():
                self.lost = [f"{path} is missing: a new one begins after step {resume_step}"] * (last not in (-1, None))
            elif ranks.is_root and resume_step is not None:
                try:
                    self.read_kept(resume_step, last)
                except Exception as error:  # damaged files raise anything
                    way_on = "delete it to continue without its contents, or continue in another folder"
                    raise SceneError(f"{path}: cannot be continued: {_reason(error)}; {way_on}") from None

    def open(self) -> None:
        """Make the file, or remove what is not kept."""
        with failing_together(self.ranks, f"cannot prepare {self.path}"):
            if self.ranks.is_root:
                self.prepare()

    def show(self) -> None:
        """Let readers see all that was written."""

    def wait_for_disk(self) -> None:
        """Wait until all that was shown is on the disk: a checkpoint that comes after it counts on it."""
        with failing_together(self.ranks, f"cannot write {self.path}"):
            if self.ranks.is_root:
                with suppress(FileNotFoundError):  # there is no list of frames before the first one
                    sync(self.path)

    def close(self) -> None:
        """Close the file, if one is open. All that was shown is safe without it."""
        if self.file is not None:
            self.file.close()
            self.file = None

    def read_kept(self, resume_step: int, last: int | None) -> None:
        """Read what is kept, on rank 0. Raises a ValueError that says why it cannot be."""
        raise NotImplementedError

    def prepare(self) -> None:
        """What `open` does, on rank 0."""
        raise NotImplementedError


def check_last(steps: list[int], resume_step: int, last: int | None) -> None:
    """Raise a ValueError unless the `steps` in a file are in order and end with `last`, as when the checkpoint was written.

    `steps`: those up to `resume_step`, the step of the checkpoint. `last` is -1 if there were none, None if that is not known.
    """
    if sorted(set(steps)) != steps:
        raise ValueError("its steps are not in order")
    found = steps[-1] if steps else -1
    if last is not None and found != last:
        raise ValueError(
            f"up to step {resume_step} it should end with step {last}, but it "
            + (f"ends with step {found}" if steps else "is empty")
        )


def _reason(error: Exception) -> str:
    """One line. Where HDF5 gives a paragraph, it is the part that says why, such as "No space left on device"."""
    said = re.search(r"error message = '([^']+)'", str(error))
    return said[1] if said else (str(error) or type(error).__name__).splitlines()[0]


@contextmanager
def mpi_io_errors() -> Iterator[None]:
    """Run a block that writes through MPI-IO; the reason of a failure becomes the text of an OSError.

    Open MPI prints that reason and does not return it: HDF5 knows only that the call failed. So stderr is caught during the
    block; what is not a reason is printed after it.
    """
    stderr, failure = os.dup(2), None
    with open(os.memfd_create("stderr")) as held:
        os.dup2(held.fileno(), 2)
        try:
            yield
        except (OSError, RuntimeError, ValueError, KeyError) as error:
            failure = error
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
        said = os.pread(held.fileno(), os.lseek(held.fileno(), 0, os.SEEK_END), 0)
    reason = MPI_IO_ERROR.search(said.decode(errors="replace")) if failure else None
    if reason:
        raise OSError(reason[1].strip()) from failure
    with suppress(OSError):  # stderr may be on a full disk
        os.write(2, said)
    if failure:
        raise failure


def frame_arrays(arrays: dict[str, Array], dimension: int) -> dict[str, Array]:
    """The columns of a frame for the rows of `arrays`: contiguous arrays, with the same bits as the values given.

    Viewers know three axes, so vectors have three components, with z = 0 in two dimensions. Beyond three dimensions these are the
    first three, and a second column has all of them: `position`, `velocity_full`, `acceleration_full`.
    """
    columns = {}
    for name, values in arrays.items():
        whole, shown = np.ascontiguousarray(values, FIELDS[name].dtype), "Points" if name == "position" else name
        columns[shown] = whole
        if FIELDS[name].rotation and dimension == 2:  # about the axis z
            columns[shown] = np.column_stack((np.zeros((len(values), 2)), whole))
        if FIELDS[name].orientation and whole.shape[1] == 1:
            columns[shown] = whole[:, 0]
        if FIELDS[name].vector and dimension != 3:
            columns[shown] = np.zeros((len(values), 3))
            columns[shown][:, :dimension] = whole[:, :3]
            if dimension > 3:
                columns[name if name == "position" else name + FULL] = whole
    return columns


def write_text(path: Path, ranks: Communicator, text: str) -> None:
    """A text file, replaced as a whole by rank 0. Collective."""
    with failing_together(ranks, f"cannot write {path}"):
        if ranks.is_root:
            replace_text(path, text)


def open_everywhere(ranks: Communicator, path: Path, task: str) -> None:
    """Make sure that each rank can open a file that all of them are going to open together. Collective.

    A folder that machines do not share is there for some ranks only; those that can open the file would wait for the others for
    ever, inside of MPI.
    """
    with failing_together(ranks, task):
        try:
            os.close(os.open(path, os.O_RDWR))
        except FileNotFoundError:
            raise OSError("this rank does not find it: all machines must share the folder") from None


def sync(path: Path) -> None:
    """Wait until what was written to a file, or renamed in a folder, is on the disk, and so lasts through a power cut."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
