"""The exact state of a run in one HDF5 file, which is replaced as a whole, and the folder in which a run goes on from it.

- /particles/<field>: (N,) or (N, d), in id order, every bit as it was (NaN, -0.0 and subnormals too)
- @particles_mpi_checkpoint = 3, @total, @dimension, and the attributes given: step, time, scene text, counts

Behind the HDF5 file there is a line with its length and CRC-32, which HDF5 ignores: a file that was cut short, or of which a bit
has changed, is never taken for a state.
"""

import json
import os
import shutil
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from particles_mpi.errors import SceneError
from particles_mpi.output.files import failing_together, replacing, sync_folder
from particles_mpi.parallel.agreement import differences
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import IdRange, allgather_rows, in_id_order
from particles_mpi.particles import FIELDS, Array, shape

MARK, FORMAT = "particles_mpi_checkpoint", 4
SEAL = f"\n{MARK} {{:20d}} {{:08x}}\n"  # the last line of a file: length and CRC-32 of the HDF5 file before it
OURS = ("trajectory.vtkhdf", "particles.pvd", "vtk", "checkpoint.h5", "diagnostics.csv", "run.json", "stopped.h5", "plots")
INTERVALS = {f"output.{name}" for name in ("every", "formats", "checkpoint_every", "diagnostics_every")}
FREE = {"title", "time.end", "time.steps"} | INTERVALS  # keys of a scene that may change when a run is continued


def save(
    path: Path, ranks: Communicator, arrays: dict[str, Array], ids: IdRange, dimension: int, attributes: dict[str, Any]
) -> None:
    """Write the state of all ranks, whose ids lie in `ids`. Collective.

    `arrays`: this rank's owned rows in any order, with every field that a restart needs; `attributes`: numbers and texts.
    """
    rows = in_id_order(ranks, arrays, ids, 1)
    with failing_together(ranks, f"cannot write {path} at step {attributes.get('step', '?')}"):
        if ranks.is_root:
            _replace(Path(path), rows, {MARK: FORMAT, "total": ids.total, "dimension": dimension} | attributes)


def dump(path: Path, ranks: Communicator, arrays: dict[str, Array], attributes: dict[str, Any]) -> None:
    """Write all rows, however wrong, and the `rank` that holds each: for inspection, not for a restart. Collective."""
    rows = allgather_rows(ranks, arrays | {"rank": np.full(len(arrays["id"]), ranks.rank)})
    with failing_together(ranks, f"cannot write {path}"):
        if ranks.is_root:
            with replacing(path) as part:
                _write(part, rows, attributes)


def _write(path: Path, rows: dict[str, Array], attributes: dict[str, Any]) -> None:
    with h5py.File(path, "w", locking=False) as file:
        for name, values in rows.items():
            file[f"particles/{name}"] = values
        file.attrs.update(attributes)


def _replace(path: Path, rows: dict[str, Array], attributes: dict[str, Any]) -> None:
    with replacing(path) as part:
        _write(part, rows, attributes)
        seal = _seal(part, part.stat().st_size)
        with open(part, "ab") as written:
            written.write(seal)
            written.flush()
            os.fsync(written.fileno())  # on the disk before it takes the name, or a power cut leaves an empty file of that name
    sync_folder(path.parent)


def _seal(path: Path, length: int) -> bytes:
    return SEAL.format(length, zlib.crc32(np.memmap(path, np.uint8, "r", shape=length).data)).encode()


def _check_seal(path: Path) -> None:
    """Raise a SceneError unless the file is a checkpoint, as it was written. HDF5 may crash on a file that is not."""
    length = path.stat().st_size - len(SEAL.format(0, 0))
    with open(path, "rb") as file:
        file.seek(max(length, 0))
        found = file.read()
    if length <= 0 or not found.startswith(f"\n{MARK} ".encode()):
        raise SceneError(f"{path}: not a checkpoint of this version of particles_mpi, or cut short")
    if found != _seal(path, length):
        raise SceneError(f"{path}: damaged: it is not what was written (CRC-32)")


def load(path: Path, rows: slice = slice(None)) -> tuple[dict[str, Array], dict[str, Any]]:
    """(arrays of the `rows` in id order, attributes). Not collective. SceneError, one line, for any other or a damaged file."""
    try:
        _check_seal(Path(path))
        with h5py.File(path, "r", locking=False) as file:
            attributes = {name: value.item() if hasattr(value, "item") else value for name, value in file.attrs.items()}
            if attributes.pop(MARK, None) != FORMAT:
                raise SceneError(f"{path}: not a checkpoint of this version of particles_mpi")
            total, dimension = attributes["total"], attributes["dimension"]
            arrays = {}
            stored = file["particles"]
            for name in sorted(stored, key=lambda n: list(FIELDS).index(n) if n in FIELDS else len(FIELDS)):  # as at the start
                dataset, ours = stored[name], name in FIELDS
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


def changed(one: dict[str, Any], two: dict[str, Any]) -> Iterator[str]:
    """The keys in which two scenes, as tables, differ so that they are different runs: all but those in FREE."""
    return (key for key, _, _ in differences(one, two) if key not in FREE)


def claim(folder: Path, ranks: Communicator, scene: dict[str, Any], resumed: bool, overwrite: bool) -> bool:
    """Take the folder for a run of this scene; True if a resumed run continues there, where its checkpoint is. Collective.

    Otherwise files of an earlier run are a SceneError, or are deleted with `overwrite`.
    """
    continues = False
    with failing_together(ranks, f"cannot use {folder}"):
        if ranks.is_root:
            held = [name for name in OURS if (folder / name).exists()]
            continues = resumed and _is_of(folder / "checkpoint.h5", scene)
            if held and not continues and not overwrite:
                what = "another run than the one to be resumed" if resumed else "a run"
                way = "--overwrite to replace it, or another folder" if resumed else "--overwrite or --resume"
                raise SceneError(f"--output: {folder} already holds {what} ({', '.join(held)}); use {way}")
    with failing_together(ranks, f"cannot write into {folder}"):  # only now, when no rank has found a fault
        if ranks.is_root:
            folder.mkdir(parents=True, exist_ok=True)
            for name in OURS if not continues else ():
                path = folder / name
                shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    return bool(ranks.bcast(continues))


def _is_of(path: Path, scene: dict[str, Any]) -> bool:
    """Is the file a checkpoint of this run?"""
    try:
        return not any(changed(json.loads(load(path, slice(0, 0))[1]["scene"]), scene))
    except (SceneError, KeyError, ValueError):
        return False
