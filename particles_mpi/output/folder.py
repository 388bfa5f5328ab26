"""The output folder of a run: free, or held by this very run so that it goes on there, or refused before it is touched."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from particles_mpi.errors import SceneError
from particles_mpi.output import checkpoint, failing_together
from particles_mpi.parallel.agreement import differences
from particles_mpi.parallel.communicator import Communicator

OURS = ("trajectory.vtkhdf", "particles.pvd", "vtk", "checkpoint.h5", "diagnostics.csv", "run.json", "stopped.h5", "plots")
FREE = (
    "title",
    "output.every",
    "output.formats",
    "output.checkpoint_every",
    "output.diagnostics_every",
    "time.end",
    "time.steps",
)


def changed(one: dict[str, Any], two: dict[str, Any]) -> Iterator[str]:
    """The keys in which two scenes, as tables, are not the same run: all but its end, its title and how often it writes."""
    return (key for key, _, _ in differences(one, two) if key not in FREE)


def claim(folder: Path, ranks: Communicator, scene: dict[str, Any], resumed: bool, overwrite: bool) -> bool:
    """Does this run go on in the folder? Otherwise what it held is gone, if that was asked for. Collective."""
    continues = False
    with failing_together(ranks, f"cannot use {folder}"):
        if ranks.is_root:
            held = [name for name in OURS if (folder / name).exists()]
            continues = resumed and _is_of(folder / "checkpoint.h5", scene)
            if held and not continues and not overwrite:
                what = "another run than the one to be resumed" if resumed else "a run"
                way = "--overwrite to replace it, or another folder" if resumed else "--overwrite or --resume"
                raise SceneError(f"--output: {folder} already holds {what} ({', '.join(held)}); use {way}")
    with failing_together(ranks, f"cannot write into {folder}"):  # every rank has come here: nothing fails elsewhere any more
        if ranks.is_root:
            folder.mkdir(parents=True, exist_ok=True)
            for name in OURS if not continues else ():
                path = folder / name
                shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    return bool(ranks.bcast(continues))


def _is_of(path: Path, scene: dict[str, Any]) -> bool:
    """Is the file a checkpoint of this run?"""
    try:
        return not any(changed(json.loads(checkpoint.load(path, slice(0, 0))[1]["scene"]), scene))
    except (SceneError, KeyError, ValueError):
        return False
