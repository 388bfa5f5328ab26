"""Time steps of a scene on the ranks it is started on: `mpirun -n 2 python steps.py SCENE.json WARM STEPS [FOLDER]`.

Prints one JSON line: seconds of the slowest rank for STEPS steps after WARM ones, without output or compilation; bytes that all
ranks used together, in a run to the end with output into FOLDER if there is one, and what the plan would tell of them.
"""

import json
import resource
import sys
from pathlib import Path
from time import perf_counter

from mpi4py import MPI

from particles_mpi import Scene, Simulation
from particles_mpi.scene.memory import memory_needed

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
if len(sys.argv) > 4:
    sim.run(sys.argv[4])
used = comm.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024)
if comm.rank == 0:
    said = {"seconds": seconds, "particles": sim.total, "steps": steps, "ranks": comm.size, "collisions": met}
    said |= {"memory": used, "told": memory_needed(scene, sim.rows.arrays, sim.total, comm.size)}
    print(json.dumps(said | {"windows": sim.near.window_counts if sim.near else (0, 0)}))
