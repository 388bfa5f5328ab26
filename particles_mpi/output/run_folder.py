"""The folder of a run: whether a run may write into it, and from which checkpoint in it a run goes on."""

import fcntl
import json
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from particles_mpi.errors import SceneError
from particles_mpi.output.checkpoint import Checkpoint
from particles_mpi.output.files import failing_together
from particles_mpi.output.replacing import replace_text
from particles_mpi.parallel.agreement import differences
from particles_mpi.parallel.communicator import Communicator

WRITTEN = ("trajectory.vtkhdf", "particles.pvd", "vtk", "checkpoint.h5", "diagnostics.csv", "run.json", "stopped.h5")
OURS = (*WRITTEN, "plots", "view.html", "view_paraview.py")  # what a run leaves, or what is made of it
IN_FOLDERS = {"vtk": ("particles_*",), "plots": ("*.png", "*.mp4", "*.gif", "*.svg", "*.pdf")}
INTERVALS = {f"output.{name}" for name in ("every", "formats", "checkpoint_every", "diagnostics_every")}
EFFECT_FILE = re.compile(r"effects\.\w+\.file")
CHANGEABLE = {"title", "time.end", "time.steps"} | INTERVALS  # keys of a scene that may change when a run is continued


def changed_keys(one: dict[str, Any], two: dict[str, Any]) -> Iterator[str]:
    """The keys in which two scenes, as tables, differ so that they are different runs: all but those in CHANGEABLE.

    Nor does it matter where the file of an effect is: what is in it is compared when a run goes on.
    """
    return (key for key, _, _ in differences(one, two) if key not in CHANGEABLE and not EFFECT_FILE.fullmatch(key))


def checkpoint_to_continue(folder: Path, ranks: Communicator, scene: dict[str, Any]) -> Path | None:
    """The checkpoint in the folder of a run; None if it has none, and the run begins. Rank 0 looks. Collective.

    What is there without a checkpoint must be the beginning of a run of this scene, and no other run may keep the folder.
    Otherwise raises a SceneError on all ranks.
    """
    path = folder / "checkpoint.h5"
    found = None
    with failing_together(ranks, f"cannot read {folder}"):
        if ranks.is_root:
            if folder.is_dir():
                Lock(folder).release()  # refused while another run keeps it
            present = [name for name in OURS if (folder / name).exists()]
            found = path if path.name in present else None
            if present and not found:
                record = folder / "run.json"
                if record.name not in present:
                    raise SceneError(f"--resume auto: {folder} holds {', '.join(present)} of an unknown run; use --overwrite")
                keys = list(changed_keys(json.loads(record.read_text())["scene"], scene))
                if keys:
                    raise SceneError([f"{key}: differs from the run in {record}; use --overwrite to replace it" for key in keys])
    return ranks.bcast(found)


def has_ended(folder: Path, ranks: Communicator) -> bool:
    """Does run.json tell that the run in a folder has come to its end? A run may be killed just before. Collective."""
    ended = False
    if ranks.is_root:
        with suppress(OSError, ValueError):
            ended = bool(json.loads((folder / "run.json").read_text(encoding="utf-8")).get("ended"))
    return bool(ranks.bcast(ended))


class Lock:
    """Locks a folder for one run until it is released or its process has ended; SceneError if another run has locked it.

    A file system that cannot lock folders, such as NFS and some of clusters, lets both write.
    """

    def __init__(self, folder: Path):
        self.folder = folder
        self.descriptor: int | None = os.open(folder, os.O_RDONLY)
        try:
            fcntl.flock(self.descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise SceneError(f"--output: another run is writing into {folder}") from None
        except OSError:
            pass

    def check(self) -> None:
        """Raise an OSError if the folder is gone, or is another one by now: that may belong to another run."""
        with suppress(FileNotFoundError):
            if self.descriptor is None or os.path.samestat(os.fstat(self.descriptor), self.folder.stat()):
                return
        raise OSError("the folder was deleted, moved or replaced while this run wrote into it")

    def release(self) -> None:
        """Let others write there."""
        if self.descriptor is not None:
            with suppress(OSError):  # at once, for a process that was forked meanwhile has it too
                fcntl.flock(self.descriptor, fcntl.LOCK_UN)
            os.close(self.descriptor)
            self.descriptor = None

    __del__ = release


def claim(
    folder: Path, ranks: Communicator, about: dict[str, Any], resumed: bool, overwrite: bool, own: bool
) -> tuple[bool, Lock | None]:
    """Take the folder for a run of about["scene"], and lock it on rank 0. Collective.

    Returns whether a resumed run continues there, where its checkpoint is, and rank 0's lock. `own`: this simulation wrote the
    checkpoint there, or was read from it, and has taken no step since; its user may have changed the scene. Otherwise files of an
    earlier run are a SceneError, or are deleted with `overwrite`.
    """
    continues, lock = False, None
    with failing_together(ranks, f"cannot use {folder}"):
        if ranks.is_root:
            refuse_what_is_no_folder(folder)
            present = [name for name in OURS if (folder / name).exists()]
            continues = resumed and ((own and "checkpoint.h5" in present) or _is_of(folder / "checkpoint.h5", about["scene"]))
            if present and not continues and not overwrite:
                what = "a run other than the one to be resumed" if resumed else "a run"
                way = "--overwrite or --resume; from Python overwrite=True or resumed=True"
                way = "--overwrite to replace it, or another folder" if resumed else way
                raise SceneError(f"--output: {folder} already holds {what} ({', '.join(present)}); use {way}")
    try:
        with failing_together(ranks, f"cannot write into {folder}"):  # only now, when no rank has found a fault
            if ranks.is_root:
                folder.mkdir(parents=True, exist_ok=True)
                lock = Lock(folder)
                record = folder / "run.json"  # from the beginning it tells whose folder this is
                for path in (folder / name for name in OURS if not continues and name != record.name):
                    remove(path)
                if not continues:
                    replace_text(record, json.dumps(about, indent=2) + "\n")
    except BaseException:
        if lock:
            lock.release()
        raise
    return bool(ranks.bcast(continues)), lock


def remove(path: Path) -> None:
    """Delete what a run left, or what was made of it: of folders only the files that have such names, and folders left empty."""
    if path.is_dir() and not path.is_symlink():
        for one in (one for pattern in IN_FOLDERS.get(path.name, ("*",)) for one in path.glob(pattern)):
            shutil.rmtree(one) if one.is_dir() and not one.is_symlink() else one.unlink()
        with suppress(OSError):  # it holds something else
            path.rmdir()
    else:
        path.unlink(missing_ok=True)


def refuse_what_is_no_folder(folder: Path) -> None:
    """Raise a SceneError if this is a file, or in one, or no name that a folder can have."""
    try:
        files = [part for part in (folder, *folder.parents) if part.exists() and not part.is_dir()]
    except OSError as error:
        raise SceneError(f"--output: {folder}: {error.strerror}") from None
    if files:
        raise SceneError(f"--output: {files[0]} is not a folder")


def _is_of(path: Path, scene: dict[str, Any]) -> bool:
    """Is the file a checkpoint of this run?"""
    try:
        return not any(changed_keys(json.loads(Checkpoint(path).attributes["scene"]), scene))
    except (SceneError, KeyError, ValueError):
        return False
