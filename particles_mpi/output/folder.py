"""May a run use its output folder? It is empty, or has the files of this very run, which goes on; otherwise it is refused."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from particles_mpi.errors import SceneError
from particles_mpi.output import checkpoint
from particles_mpi.output.files import failing_together
from particles_mpi.parallel.agreement import differences
from particles_mpi.parallel.communicator import Communicator

OURS = ("trajectory.vtkhdf", "particles.pvd", "vtk", "checkpoint.h5", "diagnostics.csv", "run.json", "stopped.h5", "plots")
# Keys of a scene that may change when a run is continued.
FREE = (
    "title",
    "time.end",
    "time.steps",
    *(f"output.{k}" for k in ("every", "formats", "checkpoint_every", "diagnostics_every")),
)


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
        return not any(changed(json.loads(checkpoint.load(path, slice(0, 0))[1]["scene"]), scene))
    except (SceneError, KeyError, ValueError):
        return False
