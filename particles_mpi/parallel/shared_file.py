"""A file into which all ranks write, each at places of its own: MPI-IO, or the plain file of a single rank."""

from pathlib import Path
from typing import Any, cast

import numpy as np
from mpi4py import MPI

from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Array

ONCE = 2**28  # bytes written in one call: MPI counts to 2^31


class SharedFile:
    """An existing file that is open for writing on all ranks. Opening and closing are collective, writing is not."""

    def __init__(self, ranks: Communicator, path: Path):
        self.file: Any = None
        if ranks.size > 1:
            self.file = MPI.File.Open(cast(MPI.Intracomm, ranks.comm), str(path), MPI.MODE_WRONLY)
            self.plain = None
        else:
            self.plain = open(path, "r+b")  # noqa: SIM115 - closed by `close`

    def write(self, place: int, column: Array) -> None:
        """Write the bytes of a column from this byte of the file on."""
        data = np.ascontiguousarray(column).view(np.uint8).reshape(-1)
        for at in range(0, len(data), ONCE):
            if self.plain:
                self.plain.seek(place + at)
                self.plain.write(data[at : at + ONCE].data)
            else:
                self.file.Write_at(place + at, data[at : at + ONCE])

    def close(self) -> None:
        """Close the file on all ranks. What they wrote is in it then, and on the disk if they are on several machines."""
        if self.plain:
            self.plain.close()
        else:
            self.file.Sync()  # rank 0 can wait for its own machine alone, see `files.sync`
            self.file.Close()
