"""Writes rows of frames into a column of an HDF5 file.

By the calls of HDF5 itself (`h5py.h5d`), since a frame of a few bodies is nothing but calls.
"""

import h5py
import numpy as np

from particles_mpi.particles import Array

WRITE_BYTES = 3 * 2**19  # at once: calls that write 3.6 MB took five times as long at times, all calls of a run or none


def write_rows(dataset: h5py.h5d.DatasetID, first: int, rows: Array) -> None:
    """Write the rows of one frame that this rank has, from row `first` of the file on, in pieces. Not collective."""
    piece = max(WRITE_BYTES // max(rows[:1].nbytes, 1), 1)
    for at in range(0, len(rows), piece):
        part, space = rows[at : at + piece], dataset.get_space()
        space.select_hyperslab((first + at, *(0,) * (rows.ndim - 1)), part.shape)
        dataset.write(h5py.h5s.create_simple(part.shape), space, part)


def write_frames(dataset: h5py.h5d.DatasetID, first: int, total: int, frames: list[Array], collective: h5py.h5p.PropDXID) -> None:
    """Write the rows that this rank has of each of several frames of `total` particles, from row `first` of the file on.

    Collective where `collective` says so: ranks without rows take part too.
    """
    rows, width = len(frames[0]), frames[0].shape[1:]
    values, space = np.concatenate(frames), dataset.get_space()
    memory = h5py.h5s.create_simple(values.shape)
    if rows:
        zeros, ones = (0,) * len(width), (1,) * len(width)
        space.select_hyperslab((first, *zeros), (len(frames), *ones), (total, *ones), (rows, *width))
    else:
        space.select_none()
        memory.select_none()
    dataset.write(memory, space, values, dxpl=collective)
