"""An error on one rank becomes an error on all ranks, or ends all of them, with one line that names the rank.

`raising_together` and `same_on_all` are for the set-up, where all ranks do the same: an error on one rank is raised on all. In
the time loop the other ranks may wait in a collective call that the failing rank never reaches. There, an exception that is not
caught goes to `abort_all`, which prints the message of the lowest failing rank and ends all ranks.
"""

import fcntl
import hashlib
import json
import os
import signal
import stat
import sys
import termios
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from time import perf_counter, sleep
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from mpi4py import MPI

from particles_mpi.errors import Interrupted, SceneError, StateError, StoppedError, one_line
from particles_mpi.parallel.communicator import NAP, Communicator
from particles_mpi.particles import Array, Particles

PATIENCE = 1.0  # seconds in which other ranks may fail as this one did, before all are ended
ABORT_SECONDS = 10  # in which MPI_Abort must have ended this process
SETUP_PATIENCE = 3.0  # seconds in which the other ranks must end a phase of the set-up in which this one failed
TAG = 1664  # of the messages between ranks that fail; messages with rows have tag 0
FRAMES = 6  # innermost calls that the message of an unexpected error names
LENGTH = 2000  # characters of a message between ranks that fail: MPI sends short ones before the receiver asks for them
SHORT_VALUE = 60  # characters of the longest value that a message repeats
PACKAGE = Path(__file__).parents[1]


class Notice(NamedTuple):
    """Why a rank ends, with this exit code. shared: the error is raised on all ranks: files and MPI can be closed in order."""

    code: int
    text: str
    shared: bool = False
    trace: bool = False  # is the text a traceback?


@contextmanager
def raising_together(ranks: Communicator) -> Iterator[None]:
    """Run a phase of the set-up on all ranks; an exception on any of them is raised on all. Collective at its end.

    A SceneError and a StoppedError keep their type; a MemoryError becomes a SceneError, any other exception a StoppedError. If
    the other ranks do not come to the end of the block, because they wait in a collective call inside, all ranks are ended.
    """
    error: Exception | None = None
    try:
        yield
    except (SceneError, StoppedError) as raised:
        error = raised
    except (Exception, SystemExit) as raised:
        error = (SceneError if isinstance(raised, MemoryError) else StoppedError)(describe_unexpected(raised))
        error.__cause__ = raised
    if ranks.size > 1:
        await_all(ranks, error, SETUP_PATIENCE)
        raise_first(ranks, error)
    elif error is not None:
        raise error


def await_all(ranks: Communicator, error: Exception | None, patience: float = PATIENCE) -> None:
    """Wait for all ranks; a rank with an error waits for `patience` seconds only, then it ends all ranks. Collective.

    Code that catches an error and goes on must call it first: if only this rank has the error, the others wait for it elsewhere.
    """
    if error is None:
        ranks.comm.Ibarrier().Wait()
    elif not ranks.sleeping_barrier(patience):
        abort_all(error)


def raise_first(ranks: Communicator, error: Exception | None, root_reads: bool = False) -> None:
    """Raise on all ranks the error of the lowest rank that has one, if any has. Collective.

    The text names it, unless all have the same error, or it is a SceneError about a file that only rank 0 reads (`root_reads`).
    """
    mine = None
    if error is not None:  # of the types that ranks share, the one that this is
        kind = next(kind for kind in (SceneError, StateError, StoppedError) if isinstance(error, kind))
        mine = kind, getattr(error, "faults", str(error))
    found = ranks.allgather(mine)
    rank = next((rank for rank, failure in enumerate(found) if failure), None)
    if rank is None:
        return
    kind, text = found[rank]
    if any(other != found[rank] for other in found) and not (root_reads and kind is SceneError):
        text = f"rank {rank}: {text}" if isinstance(text, str) else [f"rank {rank}: {fault}" for fault in text]
    raise kind(text) from (error.__cause__ if error is not None else None)


def same_on_all(ranks: Communicator, tables: dict[str, Any], arrays: dict[str, Array] | None = None) -> None:
    """Raise a SceneError on all ranks, which names rank and keys, if one has other tables or arrays than rank 0. Collective."""
    if ranks.size == 1:
        return
    digest = hashlib.blake2b(json.dumps(tables, sort_keys=True, default=str).encode())
    for name, array in (arrays or {}).items():
        digest.update(f"{name}{array.dtype}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).data)
    digests = ranks.allgather(digest.digest())
    if len(set(digests)) == 1:
        return
    keys = [f"{key}: {_beside(one, two)}" for key, one, two in differences(tables, ranks.bcast(tables))]
    fault = SceneError(keys or ["particles: values differ from those on rank 0 (files with other contents?)"])
    raise_first(ranks, fault if digests[ranks.rank] != digests[0] else None)


def differences(one: Any, two: Any, key: str = "") -> Iterator[tuple[str, Any, Any]]:
    """The keys in which two nested tables of plain data differ, "a.b[0].c", and both values; None where one has no such key."""
    if isinstance(one, dict) and isinstance(two, dict):
        for name in sorted(one.keys() | two.keys()):
            yield from differences(one.get(name), two.get(name), f"{key}.{name}" if key else name)
    elif are_tables(one) and are_tables(two) and len(one) == len(two):
        for number, rows in enumerate(zip(one, two, strict=True)):
            yield from differences(*rows, f"{key}[{number}]")
    elif one != two:
        yield key, one, two


def are_tables(value: Any) -> bool:
    """Is it a list of tables?"""
    return isinstance(value, list) and all(isinstance(row, dict) for row in value)


def _beside(one: Any, two: Any) -> str:
    """Two values that differ, as a text; without the values if they are long."""
    texts = [value if isinstance(value, str) else json.dumps(value, default=str) for value in (one, two)]
    return "differs from rank 0" if max(map(len, texts)) > SHORT_VALUE else f"{texts[0]}, but {texts[1]} on rank 0"


def is_own(file: Path) -> bool:
    """Is a file of code one of this package or of a user's, and not of Python or of a library?"""
    libraries = {Path(sys.prefix), Path(sys.base_prefix)} & {*file.parents}
    return PACKAGE in file.parents or (file.is_absolute() and not libraries)


def describe_unexpected(error: BaseException) -> str:
    """One line: the exception and the calls of this package and of a user's files that led to it; any calls if there are none."""
    said = one_line(error)
    frames = traceback.extract_tb(error.__traceback__)
    ours = [f for f in frames if is_own(Path(f.filename)) and f.filename != __file__] or frames
    calls = " > ".join(f"{Path(f.filename).name}:{f.lineno} {f.name}" for f in ours[-FRAMES:])
    name = "not enough memory" if isinstance(error, MemoryError) else f"unexpected {type(error).__name__}"
    return name + (f": {said}" if said else "") + (f" (at {calls})" if calls else "")


def abort_all(error: BaseException, whole: bool = False) -> int:
    """Print why this rank ends, and end all ranks. Returns the exit code if processes can end by themselves.

    They can on a single rank, or where every rank fails by an error that is raised on all of them (`Notice.shared`). Prints one
    line, or one for each fault of a scene; with `whole` the traceback of an unexpected exception. Where several ranks fail within
    PATIENCE seconds, only the lowest prints.
    """
    world, notice = Communicator(MPI.COMM_WORLD), _notice(error, whole)
    found = {0: notice} if world.size == 1 else _notices(world, notice)
    lowest, complete = min(found), len(found) == world.size
    code = found[lowest].code
    with suppress(Exception):  # where nothing can be printed (no stderr, a closed pipe), the ranks are ended all the same
        sys.stdout.flush()
    if world.rank == lowest:
        alone = not (complete and all(other.text[:LENGTH] == notice.text[:LENGTH] for other in found.values()))
        before = "" if notice.trace else f"particles-mpi: rank {lowest}: " if alone else "particles-mpi: "
        with suppress(Exception):
            sys.stderr.write("".join(f"{before}{line}\n" for line in notice.text.splitlines()))
            sys.stderr.flush()
        wait_until_read(2, PATIENCE)
    # The first rank that ends has the others killed: not before the message has been read, which may take PATIENCE. A rank that
    # is ended meanwhile never comes; then the others, which would wait for it in MPI_Finalize for ever, are ended too.
    shared = complete and all(other.shared for other in found.values())
    if world.size > 1 and not (shared and world.sleeping_barrier(3.0 * PATIENCE)):
        if world.rank != lowest:
            sleep(PATIENCE)  # the lowest rank ends all when it has printed its message
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # MPICH would add a line of its own
        signal.alarm(ABORT_SECONDS)  # MPI_Abort waits for the launcher; if that never answers, this process ends by itself
        world.comm.Abort(code)
    return code


def wait_until_read(descriptor: int, patience: float) -> None:
    """Wait, at most `patience` seconds, until what was written into a pipe has been read; at once if it is no pipe.

    The launcher reads what ranks print from pipes. Once a rank has ended with an exit code that is not 0, it closes them, and
    what it has not yet read is lost.
    """
    end = perf_counter() + patience
    with suppress(OSError):  # no such descriptor, or nothing that can be asked
        while stat.S_ISFIFO(os.fstat(descriptor).st_mode) and perf_counter() < end:
            if not int.from_bytes(fcntl.ioctl(descriptor, termios.FIONREAD, bytes(4)), sys.byteorder):
                break
            sleep(NAP)


def _notice(error: BaseException, whole: bool) -> Notice:
    """Why a rank ends with this exception."""
    if isinstance(error, SceneError | StoppedError | Interrupted):
        return Notice(error.exit_code, str(error), shared=True)
    if isinstance(error, KeyboardInterrupt):
        return Notice(Interrupted.exit_code, str(error) or "interrupted")
    if whole:
        return Notice(StoppedError.exit_code, "".join(traceback.format_exception(error)), trace=True)
    return Notice(StoppedError.exit_code, describe_unexpected(error))


def _notices(world: Communicator, mine: Notice) -> dict[int, Notice]:
    """The notices of this rank and of those that fail within PATIENCE seconds, by rank."""
    found = {world.rank: mine}
    short = mine._replace(text=mine.text[:LENGTH])
    sent = [world.comm.isend(short, p, TAG) for p in range(world.size) if p not in found]
    status, end = MPI.Status(), perf_counter() + PATIENCE
    while len(found) < world.size and perf_counter() < end:
        if world.comm.iprobe(tag=TAG, status=status):
            found[status.source] = world.comm.recv(source=status.source, tag=TAG)
        else:
            sleep(NAP)
    _pending.extend(sent)
    return found


_pending: list[Any] = []  # a message must outlive the call that sends it


def abort_uncaught(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """End all ranks after an exception that a user's script did not catch, with its exit code; it is `sys.excepthook` then."""
    sys.exit(abort_all(error.with_traceback(trace), whole=True))


if MPI.COMM_WORLD.Get_size() > 1 and sys.excepthook is sys.__excepthook__:
    sys.excepthook = abort_uncaught


def require_finite(ranks: Communicator, p: Particles, values: Any, when: str) -> None:
    """Raise a StateError on all ranks, which names the lowest id at fault, if one of `values`, the same on all, is not finite."""
    if np.isfinite(values).all():
        return
    with np.errstate(over="ignore", invalid="ignore"):
        bad = p.id[~np.isfinite((p.velocity**2).sum(axis=1) + p.position.sum(axis=1))]
    lowest = ranks.allgather(int(bad.min()) if len(bad) else None)
    found = [(particle, rank) for rank, particle in enumerate(lowest) if particle is not None]
    if not found:
        raise StateError(f"{when}: velocities are too large for the sum of their squares")
    particle, rank = min(found)
    raise StateError(f"{when}: particle {particle} on rank {rank} has a position or velocity that is not finite")
