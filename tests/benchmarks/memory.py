"""Set-up and memory of a rank: `mpirun -n 4 python tests/benchmarks/memory.py [SPHERES] [STEPS]`, at the headline's density."""

import resource
import sys
from time import perf_counter

from mpi4py import MPI

from particles_mpi import Scene, Simulation

count, steps = (int(float(word)) for word in (*sys.argv[1:], *("4e6", "5")[len(sys.argv) - 1 :]))
comm = MPI.COMM_WORLD
side = 4.0 * (count / 32000) ** (1 / 3)
spheres = {"count": count, "position": "random", "velocity": {"speed": 0.5}, "radius": 0.01, "mass": {"min": 0.1, "max": 0.5}}
scene = Scene(
    dimension=3,
    box={"lower": [0.0] * 3, "upper": [side] * 3},
    time={"step": 0.02, "steps": steps},
    particles=[spheres],
    effects={"collisions": {}, "walls": {}},
)


def largest():
    """Of the ranks: MB that each has used at most so far."""
    return comm.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024, MPI.MAX)


at_first, begin = largest(), perf_counter()
sim = Simulation(scene)
made, after = largest(), perf_counter() - begin
begin = perf_counter()
sim.run()
ran, loop = largest(), perf_counter() - begin
after, loop = (comm.allreduce(seconds, MPI.MAX) for seconds in (after, loop))
if comm.rank == 0:
    print(f"{comm.size} ranks, {count} spheres: set-up {after:.1f} s, {steps} steps {loop:.1f} s; largest memory of a rank")
    print(f"libraries {at_first} MB, start {made} MB, run {ran} MB")
