"""Started by mpirun in tests/ranks.py: every rank runs the scripts that it is told of, one after the other.

rank_worker.py FOLDER: rank r reads the arguments of script k, as JSON, from line k of the pipe FOLDER/pipe.r, until its end.
What it says goes to FOLDER/k.out.r and FOLDER/k.err.r, its exit code to FOLDER/k.code.r.
"""

import gc
import json
import os
import runpy
import sys
import traceback
import tracemalloc
from pathlib import Path

from mpi4py import MPI

import particles_mpi  # noqa: F401  so that the first script need not wait for it

FREEZE = gc.freeze  # what a script leaves here; one that ends as a process would must not freeze what it leaves
gc.freeze = lambda: None
folder, rank = Path(sys.argv[1]), MPI.COMM_WORLD.Get_rank()


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
    for number, line in enumerate((folder / f"pipe.{rank}").open()):
        for name, descriptor in (("out", 1), ("err", 2)):
            file = os.open(folder / f"{number}.{name}.{rank}", os.O_WRONLY | os.O_CREAT)
            os.dup2(file, descriptor)
            os.close(file)
        try:
            code = run(json.loads(line))
        except BaseException:  # others may wait for this rank
            traceback.print_exc()
            sys.stderr.flush()
            MPI.COMM_WORLD.Abort(3)
        sys.stdout.flush()
        sys.stderr.flush()
        MPI.COMM_WORLD.Barrier()  # files that all of them opened are closed by all together
        tracemalloc.stop()  # a script that looked at its memory would make all after it slower
        gc.enable()
        gc.collect()
        FREEZE()
        part = folder / f"{number}.part.{rank}"
        part.write_text(str(code))
        part.rename(folder / f"{number}.code.{rank}")


main()
