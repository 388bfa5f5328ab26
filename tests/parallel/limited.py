"""limited.py setup|steps LIMIT ARGUMENTS...: the command line, where numbers of 32 bits seem to end at LIMIT, from then on."""

import sys

from particles_mpi import Simulation, cli
from particles_mpi.kernels import limits

when, limit, step = sys.argv.pop(1), int(sys.argv.pop(1)), Simulation.step


def limited_step(sim):
    limits.INT32_MAX = limit
    step(sim)


if when == "setup":
    limits.INT32_MAX = limit
Simulation.step = limited_step
cli.main()
