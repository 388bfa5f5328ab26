"""Time steps of a scene on the ranks it is started on: `mpirun -n 2 python steps.py SCENE.json WARM STEPS`.

Prints one JSON line: seconds of the slowest rank for STEPS steps after WARM ones, without output or compilation.
"""

import json
import sys
from pathlib import Path
from time import perf_counter

from mpi4py import MPI

from particles_mpi import Scene, Simulation

comm = MPI.COMM_WORLD
scene = Scene.from_dict(json.loads(Path(sys.argv[1]).read_text()))
warm, steps = int(sys.argv[2]), int(sys.argv[3])
sim = Simulation(scene)
sim.steps(warm)
met = sim.totals["collisions"]
comm.Barrier()
begin = perf_counter()
sim.steps(steps)
seconds = comm.allreduce(perf_counter() - begin, MPI.MAX)
met = comm.allreduce(sim.totals["collisions"] - met)
if comm.rank == 0:
    said = {"seconds": seconds, "particles": sim.total, "steps": steps, "ranks": comm.size, "collisions": met}
    print(json.dumps(said | {"windows": sim.near.window_counts if sim.near else (0, 0)}))
