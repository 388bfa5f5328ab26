"""The exact state of a run in one small HDF5 file, replaced as a whole: a restart continues with the same bits.

- /particles/<field>: (N,) or (N, d), in id order, every bit as it was (NaN, -0.0 and subnormals too)
- @particles_mpi_checkpoint = 1, @total, @dimension, and the attributes given: step, time, scene text, counts
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import h5py

from particles_mpi.errors import SceneError
from particles_mpi.output import failing_together, sync_folder
from particles_mpi.parallel.exchange import in_id_order
from particles_mpi.parallel.ranks import Ranks
from particles_mpi.particles import FIELDS, Array, shape

MARK, FORMAT = "particles_mpi_checkpoint", 1


def save(path: Path, ranks: Ranks, arrays: dict[str, Array], total: int, dimension: int, attributes: dict[str, Any]) -> None:
    """Write the state of all ranks. Collective.

    `arrays`: this rank's owned rows in any order, every field a restart needs; `attributes`: numbers and texts of any length.
    At every moment `path` is the previous checkpoint or this one. Raises StoppedError on all ranks if it cannot be written.
    """
    rows = in_id_order(ranks, arrays, total, 1)
    with failing_together(ranks, f"cannot write {path} at step {attributes.get('step', '?')}"):
        if ranks.is_root:
            _replace(Path(path), rows, {MARK: FORMAT, "total": total, "dimension": dimension} | attributes)


def _replace(path: Path, rows: dict[str, Array], attributes: dict[str, Any]) -> None:
    part = path.with_name(path.name + ".tmp")
    with h5py.File(part, "w", locking=False) as file:
        for name, values in rows.items():
            file[f"particles/{name}"] = values
        for name, value in attributes.items():
            file.attrs[name] = value
    with open(part, "rb") as written:  # on the disk before it takes the name, or a power cut leaves an empty file of that name
        os.fsync(written.fileno())
    os.replace(part, path)
    sync_folder(path.parent)


def load(path: Path, rows: slice = slice(None)) -> tuple[dict[str, Array], dict[str, Any]]:
    """(arrays of the rows in id order, attributes with the types they were saved with). Any rank, not collective.

    Raises SceneError, one line, for a file that is missing, cut short or no checkpoint.
    """
    try:
        with h5py.File(path, "r", locking=False) as file:
            attributes = {name: value.item() if hasattr(value, "item") else value for name, value in file.attrs.items()}
            if attributes.pop(MARK, None) != FORMAT:
                raise SceneError(f"{path}: not a checkpoint of this version of particles_mpi")
            total, dimension = attributes["total"], attributes["dimension"]
            arrays = {}
            for name, dataset in file["particles"].items():
                ours = name in FIELDS
                if dataset.shape[:1] != (total,) or (
                    ours and (dataset.shape != shape(name, total, dimension) or dataset.dtype != FIELDS[name].dtype)
                ):
                    raise SceneError(f"{path}: particles/{name} is not a field of {total} particles in dimension {dimension}")
                arrays[name] = dataset[rows]
    except FileNotFoundError:
        raise SceneError(f"{path}: no such checkpoint") from None
    except (OSError, RuntimeError, KeyError, AttributeError) as error:
        raise SceneError(f"{path}: cannot be read as a checkpoint ({str(error).splitlines()[0]})") from None
    return arrays, attributes
