"""One rank that fails ends all, with one line that names it.

`raising_together` and `same_on_all` are for the set-up, where all ranks do the same: what goes wrong on one is raised on all.
In the time loop the others may be waiting inside a collective call that the failing rank never comes to: `abort_all` is for what
nobody caught. It lets the lowest of the ranks that fail speak, and ends all of them.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter, sleep
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from mpi4py import MPI

from particles_mpi.errors import Interrupted, SceneError, StateError, StoppedError
from particles_mpi.parallel.communicator import NAP, Communicator
from particles_mpi.particles import Array, Particles

PATIENCE = 1.0  # seconds for other ranks to fail as this one did, before all are ended
SETUP_PATIENCE = 3.0  # seconds for the other ranks to come to the end of a phase of the set-up in which this one failed
TAG = 1664  # of the messages between ranks that fail; rows go with tag 0
FRAMES = 5  # calls that a line tells of an unexpected error, the innermost ones
LENGTH = 2000  # characters of a message between ranks that fail: short ones are sent without the receiver's help
SHORT = 60  # characters of a value that a line repeats
PACKAGE = Path(__file__).parents[1]


class Notice(NamedTuple):
    """What a rank has to say of its end; `shared`: an error that ranks share, after which files and MPI can be closed."""

    code: int
    text: str
    shared: bool = False
    trace: bool = False  # is the text a traceback?


@contextmanager
def raising_together(ranks: Communicator) -> Iterator[None]:
    """Run a phase of the set-up on all ranks; an exception on any of them is raised on all. Collective at its end.

    It is the lowest failing rank's, its text begins with "rank r: " unless all ranks say the same. A SceneError and a
    StoppedError keep their kind; memory that is refused is a SceneError, and what nobody expected a StoppedError. A rank that
    waits for others in vain, because they are in a collective call inside the block, ends all of them.
    """
    error: Exception | None = None
    try:
        yield
    except Exception as raised:
        error = raised if isinstance(raised, SceneError | StoppedError) else _translated(raised)
    if ranks.size == 1:
        if error is not None:
            raise error
        return
    mine, worst = np.array([error is not None], np.int8), np.zeros(1, np.int8)
    _await(ranks.comm.Iallreduce(mine, worst, MPI.MAX), error, SETUP_PATIENCE)
    if worst[0]:
        raise_first(ranks, error)


def await_all(ranks: Communicator, error: SceneError | StoppedError) -> None:
    """After an error that should have come to all ranks: returns if it has, else ends all. Collective."""
    if ranks.size > 1:
        _await(ranks.comm.Ibarrier(), error, PATIENCE)


def raise_first(ranks: Communicator, error: Exception | None, root_reads: bool = False) -> None:
    """Raise the error of the lowest rank that has one on all ranks; nothing happens if none has. Collective.

    The text names the rank, unless all say the same, or a SceneError is of what only rank 0 reads for all (`root_reads`).
    """
    mine = None if error is None else (_kind(error), getattr(error, "faults", str(error)))
    found = ranks.allgather(mine)
    for rank, failure in enumerate(found):
        if failure is None:
            continue
        kind, text = failure
        if any(other != failure for other in found) and not (root_reads and kind is SceneError):
            text = f"rank {rank}: {text}" if isinstance(text, str) else [f"rank {rank}: {fault}" for fault in text]
        raise kind(text) from (error.__cause__ if error is not None else None)


def same_on_all(ranks: Communicator, tables: dict[str, Any], arrays: dict[str, Array] | None = None) -> None:
    """SceneError on all ranks if one has other tables (plain data) or arrays than rank 0: names it, and the keys. Collective."""
    if ranks.size == 1:
        return
    digest = hashlib.blake2b(json.dumps(tables, sort_keys=True, default=str).encode())
    for name, array in (arrays or {}).items():
        digest.update(f"{name}{array.dtype}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).data)
    digests = ranks.allgather(digest.digest())
    if all(other == digests[0] for other in digests):
        return
    of_root = ranks.bcast(tables)
    keys = [f"{key}: {_beside(one, two)}" for key, one, two in differences(tables, of_root)]
    fault = None
    if digests[ranks.rank] != digests[0]:
        fault = SceneError(keys or ["particles: not the same values as on rank 0 (files with other contents?)"])
    raise_first(ranks, fault)


def differences(one: Any, two: Any, key: str = "") -> Iterator[tuple[str, Any, Any]]:
    """The keys in which two tables of plain data differ, with both values; None where there is none."""
    if isinstance(one, dict) and isinstance(two, dict):
        for name in sorted(one.keys() | two.keys()):
            yield from differences(one.get(name), two.get(name), f"{key}.{name}" if key else name)
    elif one != two:
        yield key, one, two


def _beside(one: Any, two: Any) -> str:
    """Two values that differ, if they can be told in a line."""
    texts = [value if isinstance(value, str) else json.dumps(value, default=str) for value in (one, two)]
    return "not as on rank 0" if max(map(len, texts)) > SHORT else f"{texts[0]}, but {texts[1]} on rank 0"


def _kind(error: Exception) -> type[Exception]:
    """Of the errors that ranks share, the one that this is."""
    return next(kind for kind in (SceneError, StateError, StoppedError) if isinstance(error, kind))


def _translated(error: Exception) -> Exception:
    """What nobody expected, as one of the errors that ranks share."""
    kind = SceneError if isinstance(error, MemoryError) else StoppedError
    shared = kind(describe_unexpected(error))
    shared.__cause__ = error
    return shared


def describe_unexpected(error: BaseException) -> str:
    """One line: the exception, and the calls of this package that led to it (of all, where there are none)."""
    said = next((line.strip() for line in str(error).splitlines() if line.strip()), "")
    frames = traceback.extract_tb(error.__traceback__)
    ours = [f for f in frames if PACKAGE in Path(f.filename).parents and f.filename != __file__] or frames
    calls = " > ".join(f"{Path(f.filename).name}:{f.lineno} {f.name}" for f in ours[-FRAMES:])
    name = "not enough memory" if isinstance(error, MemoryError) else f"unexpected {type(error).__name__}"
    return name + (f": {said}" if said else "") + (f" (at {calls})" if calls else "")


def _await(request: MPI.Request, error: Exception | None, patience: float) -> None:
    """Until all ranks have come; one with an error does not wait for ever for those that may be waiting for it elsewhere."""
    if error is None:
        request.Wait()
        return
    end = perf_counter() + patience
    while not request.Test():
        if perf_counter() > end:
            abort_all(error)
        sleep(NAP)


def abort_all(error: BaseException, whole: bool = False) -> int:
    """Say what ended this rank, and end all. Returns the exit code if all ranks share the error, otherwise does not return.

    One line, or one a fault of a scene; with `whole` a traceback for what nobody expected. Where several ranks fail within
    PATIENCE, only the lowest speaks.
    """
    comm, notice = MPI.COMM_WORLD, _notice(error, whole)
    found = {0: notice} if comm.Get_size() == 1 else _notices(comm, notice)
    lowest, complete = min(found), len(found) == comm.Get_size()
    code = found[lowest].code
    sys.stdout.flush()
    if comm.Get_rank() == lowest:
        alone = not (complete and all(other.text[:LENGTH] == notice.text[:LENGTH] for other in found.values()))
        before = "" if notice.trace else f"particles-mpi: rank {lowest}: " if alone else "particles-mpi: "
        sys.stderr.write("".join(f"{before}{line}\n" for line in notice.text.splitlines()))
        sys.stderr.flush()
    if comm.Get_size() > 1 and not (complete and all(other.shared for other in found.values())):
        if comm.Get_rank() != lowest:
            sleep(PATIENCE)  # the lowest ends all, when it has spoken
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # MPICH would add a line of its own
        comm.Abort(code)
    return code


def _notice(error: BaseException, whole: bool) -> Notice:
    """What a rank has to say of its end."""
    if isinstance(error, SceneError | StoppedError | Interrupted):
        return Notice(error.exit_code, str(error), shared=True)
    if isinstance(error, KeyboardInterrupt):
        return Notice(Interrupted.exit_code, str(error) or "interrupted")
    if whole:
        return Notice(StoppedError.exit_code, "".join(traceback.format_exception(error)), trace=True)
    return Notice(StoppedError.exit_code, describe_unexpected(error))


def _notices(comm: MPI.Comm, mine: Notice) -> dict[int, Notice]:
    """What this rank, and others that fail within PATIENCE, have to say, by rank."""
    found = {comm.Get_rank(): mine}
    short = mine._replace(text=mine.text[:LENGTH])
    sent = [comm.isend(short, p, TAG) for p in range(comm.Get_size()) if p not in found]
    status, end = MPI.Status(), perf_counter() + PATIENCE
    while len(found) < comm.Get_size() and perf_counter() < end:
        if comm.iprobe(tag=TAG, status=status):
            found[status.source] = comm.recv(source=status.source, tag=TAG)
        else:
            sleep(NAP)
    _pending.extend(sent)
    return found


_pending: list[Any] = []  # a message must outlive the call that sends it


def abort_uncaught(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """What nobody caught in a user's script ends all ranks, with the exit code of the error; `sys.excepthook` of every rank."""
    sys.exit(abort_all(error.with_traceback(trace), whole=True))


if MPI.COMM_WORLD.Get_size() > 1 and sys.excepthook is sys.__excepthook__:
    sys.excepthook = abort_uncaught


def describe_not_finite(ranks: Communicator, p: Particles, when: str) -> str:
    """Whose position or velocity is not finite, or too large for its square to be. Collective."""
    with np.errstate(over="ignore", invalid="ignore"):
        bad = p.id[~np.isfinite((p.velocity**2).sum(axis=1) + p.position.sum(axis=1))]
    found = [(int(ids.min()), rank) for rank, ids in enumerate(ranks.allgather(bad)) if len(ids)]
    if not found:
        return f"{when}: velocities are too large for the sum of their squares"
    particle, rank = min(found)
    return f"{when}: particle {particle} on rank {rank} has a position or velocity that is not finite"
