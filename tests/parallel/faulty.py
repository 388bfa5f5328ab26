"""The program with a fault on one rank: faulty.py FAULT RANK STAMP ARGUMENTS...

FAULT is MODULE:FUNCTION or MODULE:CLASS.METHOD, which raises (ZeroDivisionError) on that rank, or on all of them for RANK
"all"; with "killed:" before it the rank is killed there, with "leaves:" it calls sys.exit, and with "quits:" it is gone without a
word, with exit code 7; "full disk" lets no file of that rank grow beyond 20 kB. The file STAMP
appears when the fault does.
"""

import os
import resource
import signal
import sys
from functools import reduce
from importlib import import_module
from pathlib import Path

from mpi4py import MPI

from particles_mpi.cli import main


def fault(*arguments, **keywords):
    """The division that nobody expected."""
    stamp.touch()
    return 1 / 0


def killed(*arguments, **keywords):
    """As by the kernel, when memory runs out."""
    stamp.touch()
    os.kill(os.getpid(), signal.SIGKILL)


def leaves(*arguments, **keywords):
    """As a user's effect does that knows nothing of ranks."""
    stamp.touch()
    sys.exit("table.dat: not found")


def quits(*arguments, **keywords):
    """As a library in C does."""
    stamp.touch()
    os._exit(7)


FAULTS = {"killed": killed, "leaves": leaves, "quits": quits}
name, rank, stamp = sys.argv[1], sys.argv[2], Path(sys.argv[3])
sys.argv[1:] = sys.argv[4:]
if rank in ("all", str(MPI.COMM_WORLD.Get_rank())):
    if name == "full disk":
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
    else:
        *kind, module, place = name.split(":")
        *owner, function = place.split(".")
        holder = reduce(getattr, owner, import_module(module))
        setattr(holder, function, FAULTS[kind[0]] if kind else fault)
main()
