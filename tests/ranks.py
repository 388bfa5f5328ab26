"""Starting scripts on several ranks: by an mpirun of their own, or on ranks that stay for the whole session.

An mpirun takes about two seconds until its ranks have imported everything. Tests that only want what a script computes share
one mpirun for each number of ranks (`StandingRanks`), whose ranks run one script after the other. Tests that look at how ranks
start, end, are killed or fail ask for a start of their own (`fresh=True`).
"""

import ctypes
import json
import os
import platform
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
from pathlib import Path
from time import monotonic, sleep

ROOT = Path(__file__).parents[1]
MPI_ENVIRONMENT = {  # Open MPI 4 and 5: as root, on more ranks than cores, and a rank that waits gives its core away
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
    "OMPI_MCA_mpi_yield_when_idle": "1",
    "OMPI_MCA_odls_base_sigkill_timeout": "0",  # and after a rank failed, the others are killed without waiting for them
}
CRASH = "PMIx_server_finalize"  # where Open MPI's mpirun itself may crash when all ranks have ended: then it is started again
NAP = 0.005  # seconds between two looks whether a script has ended
MOST = 4  # ranks that stay: more would only take memory
SLICE = 100_000  # nanoseconds that a rank keeps a core which another process waits for; Linux's least, its own value is 1 to 3 ms
SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}  # the number of this system call of Linux


def environment():
    """Of an mpirun that a test starts."""
    return MPI_ENVIRONMENT | os.environ | {"PYTHONPATH": str(ROOT)}


def take_turns_often() -> None:
    """Let this process and those that it starts from now on share cores in slices of `SLICE`. Only Linux >= 6.12 does it.

    Ranks exchange messages every few microseconds. Where more processes than cores want to run, a rank that is waited for would
    get its core back after milliseconds only: a sum over two ranks beside two busy processes takes 6 ms with the slices that
    Linux takes by itself, and 0.02 ms with these and ranks that give their cores away (`MPI_ENVIRONMENT`).
    """
    number = SCHED_SETATTR.get(platform.machine())
    if sys.platform == "linux" and number:
        nice = os.getpriority(os.PRIO_PROCESS, 0)
        attributes = struct.pack("IIQiIQQQ", 48, os.SCHED_OTHER, 0, nice, 0, SLICE, 0, 0)  # struct sched_attr; 48 bytes of it
        ctypes.CDLL(None).syscall(number, 0, attributes, 0)  # an older Linux ignores the slice


def run_ranks(n: int, *arguments: object, timeout: float = 120, fresh: bool = False) -> subprocess.CompletedProcess[str]:
    """Run `python arguments...` on n ranks; a hang is a failure (TimeoutExpired), output is text.

    The arguments begin with the path of a script, or with "-m" and the name of a module. `fresh`: by an mpirun of its own.
    """
    words = [str(word) for word in arguments]
    if fresh or n > MOST:
        command = ["mpirun", "-n", str(n), sys.executable, *words]
        for _ in range(2):
            done = subprocess.run(command, cwd=ROOT, env=environment(), capture_output=True, text=True, timeout=timeout)
            if done.returncode != -signal.SIGSEGV or CRASH not in done.stderr:
                break
        return done
    if n not in _standing:
        _standing[n] = StandingRanks(n)
    return _standing[n].run(words, timeout)


class StandingRanks:
    """`n` ranks of tests/rank_worker.py, which run what a pipe tells each of them, one script after the other."""

    def __init__(self, n: int):
        self.n, self.jobs = n, 0
        self.folder = Path(tempfile.mkdtemp(prefix="ranks"))
        pipes = [self.folder / f"pipe.{rank}" for rank in range(n)]
        for pipe in pipes:
            os.mkfifo(pipe)
        self.pipes = [os.open(pipe, os.O_RDWR) for pipe in pipes]  # the ranks end when this process closes them, or is gone
        command = ["mpirun", "-n", n, sys.executable, ROOT / "tests" / "rank_worker.py", self.folder]
        self.said = (self.folder / "mpirun").open("w+")
        self.process = subprocess.Popen(
            list(map(str, command)), cwd=ROOT, env=environment(), stdin=subprocess.DEVNULL, stdout=self.said, stderr=self.said
        )

    def run(self, words: list[str], timeout: float) -> subprocess.CompletedProcess[str]:
        """As `run_ranks`. Standard output and error are those of rank 0, then 1, and so on."""
        number, self.jobs = self.jobs, self.jobs + 1
        for pipe in self.pipes:
            os.write(pipe, json.dumps(words).encode() + b"\n")
        codes = [self.folder / f"{number}.code.{rank}" for rank in range(self.n)]
        end = monotonic() + timeout
        while not all(path.exists() for path in codes) and self.process.poll() is None:
            if monotonic() > end:
                self.close(wait=0.0)
                raise subprocess.TimeoutExpired(words, timeout)
            sleep(NAP)
        code = next((found for path in codes if path.exists() and (found := int(path.read_text()))), 0)
        out, err = (
            "".join(p.read_text() for r in range(self.n) if (p := self.folder / f"{number}.{name}.{r}").exists())
            for name in ("out", "err")
        )
        if self.process.poll() is not None:  # a rank ended all of them
            code = code or self.process.returncode or 1
            err += (self.folder / "mpirun").read_text()
            self.close(wait=0.0)
        return subprocess.CompletedProcess(words, code, out, err)

    def close(self, wait: float = 10.0) -> None:
        """End the ranks; the next call of `run_ranks` starts others."""
        _standing.pop(self.n, None)
        for pipe in self.pipes:
            os.close(pipe)
        try:
            self.process.wait(wait)
        except subprocess.TimeoutExpired:
            self.process.terminate()
            self.process.wait()
        self.said.close()
        shutil.rmtree(self.folder, ignore_errors=True)


_standing: dict[int, StandingRanks] = {}


def end_standing_ranks() -> None:
    """At the end of a session."""
    for ranks in list(_standing.values()):
        ranks.close()
