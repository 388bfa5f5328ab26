"""Started by mpirun in tests/ranks.py: every rank runs the scripts that it is told of, one after the other.

rank_worker.py FOLDER PID: the arguments of script k are in FOLDER/k.job, as JSON; what rank r says goes to FOLDER/k.out.r and
FOLDER/k.err.r, and its exit code to FOLDER/k.code.r. Ends when FOLDER/end appears, or when the process PID is gone.
"""

import gc
import json
import os
import runpy
import sys
import traceback
from pathlib import Path
from time import monotonic, sleep

from mpi4py import MPI

import particles_mpi  # noqa: F401  so that the first script need not wait for it

folder, owner, rank = Path(sys.argv[1]), int(sys.argv[2]), MPI.COMM_WORLD.Get_rank()
NAP, LOOK = 0.002, 1.0  # seconds between two looks for a script, and whether there is still somebody to run it for


def alive(pid: int) -> bool:
    """Is there such a process?"""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def next_job(number: int) -> list[str] | None:
    """The arguments of the next script, as soon as there is one; None at the end."""
    looked = monotonic()
    while not (folder / f"{number}.job").exists():
        if monotonic() > looked + LOOK:
            looked = monotonic()
            if not alive(owner):
                return None
        if (folder / "end").exists():
            return None
        sleep(NAP)
    return json.loads((folder / f"{number}.job").read_text())


def run(words: list[str]) -> int:
    """The exit code of `python words...`, within this process."""
    before = sys.argv, list(sys.path), os.getcwd()
    try:
        if words[0] == "-m":
            sys.argv = words[1:]
            runpy.run_module(words[1], run_name="__main__", alter_sys=True)
        else:
            sys.argv = words
            sys.path.insert(0, str(Path(words[0]).resolve().parent))
            runpy.run_path(words[0], run_name="__main__")
    except SystemExit as error:
        if isinstance(error.code, str):
            print(error.code, file=sys.stderr)
        return error.code if isinstance(error.code, int) else int(error.code is not None)
    finally:
        sys.argv, sys.path[:] = before[:2]
        os.chdir(before[2])
    return 0


def main() -> None:
    number = 0
    while (words := next_job(number)) is not None:
        for name, descriptor in (("out", 1), ("err", 2)):
            file = os.open(folder / f"{number}.{name}.{rank}", os.O_WRONLY | os.O_CREAT)
            os.dup2(file, descriptor)
            os.close(file)
        try:
            code = run(words)
        except BaseException:  # others may wait for this rank
            traceback.print_exc()
            sys.stderr.flush()
            MPI.COMM_WORLD.Abort(3)
        sys.stdout.flush()
        sys.stderr.flush()
        MPI.COMM_WORLD.Barrier()  # files that all of them opened are closed by all together
        gc.collect()
        part = folder / f"{number}.part.{rank}"
        part.write_text(str(code))
        part.rename(folder / f"{number}.code.{rank}")
        number += 1


main()
