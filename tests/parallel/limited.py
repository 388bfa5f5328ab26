"""limited.py setup|steps LIMIT ARGUMENTS...: the command line, where numbers of 32 bits seem to end at LIMIT, from then on."""

import sys

from particles_mpi import Simulation, cli
from particles_mpi.kernels import limits

when, limit, step, largest = sys.argv.pop(1), int(sys.argv.pop(1)), Simulation.step, limits.INT32_MAX


def limited_step(sim):
    limits.INT32_MAX = limit
    step(sim)


if when == "setup":
    limits.INT32_MAX = limit
Simulation.step = limited_step
try:
    cli.main()
finally:  # another script may be run by this process
    limits.INT32_MAX, Simulation.step = largest, step
