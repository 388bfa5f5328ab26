"""Keeps an HDF5 file at least as long as its header says.

HDF5 writes into the first bytes of a file how long it is. It lengthens the file after that, and cuts it before. A file that is
shorter than its header says cannot be opened. That would happen if a run were killed in between, or if a limit on the size of
files forbade that length.
"""

import io
import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np

TABLES_BYTES = 2**20  # what HDF5's tables take besides, at most: their smallest parts are much smaller


class Uncut(io.FileIO):
    """A file for HDF5 to change that it cannot cut; `cut` does so when HDF5 has closed it."""

    def __init__(self, path: Path):
        super().__init__(path, "r+")
        self.wanted: int | None = None  # how long HDF5 wants it to be

    def truncate(self, size: int | None = None) -> int:
        self.wanted = self.tell() if size is None else size
        return super().truncate(self.wanted) if self.wanted > os.fstat(self.fileno()).st_size else self.wanted

    def cut(self) -> None:
        if self.wanted is not None:
            super().truncate(self.wanted)


def chunk_bytes(datasets: Iterable[Any]) -> int:
    """How many bytes of the file the chunks of these datasets take, which are whole in it."""
    return sum(-(-data.shape[0] // data.chunks[0]) * int(np.prod(data.chunks)) * data.dtype.itemsize for data in datasets)


def lengthen(path: Path, file: h5py.File) -> None:
    """Make a file that this process alone has open as long as HDF5 is about to say that it is."""
    if os.stat(path).st_size < (size := file.id.get_filesize()):
        try:
            os.truncate(path, size)
        except OSError as error:
            raise OSError(error.strerror) from error


def make_room(path: Path, new_chunks: int) -> None:
    """Make a file that several ranks have open longer than HDF5 is about to say that it is: on one rank, while none writes.

    new_chunks: bytes of the chunks that are new since the file was opened. Parallel HDF5 does not tell how long the file will be.
    It gets twice the room of these chunks, for tables too; HDF5 cuts off what it does not need when the file is closed.
    """
    if new_chunks:
        with suppress(OSError):  # a limit between that length and what is needed is no fault: HDF5 will see
            os.truncate(path, os.stat(path).st_size + 2 * new_chunks + TABLES_BYTES)
