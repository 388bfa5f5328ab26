"""Windows of mode event on more ranks: `mpirun -n 8 python tests/benchmarks/windows.py [SPHERES A RANK] [STEPS]`.

A fluid at packing 0.30 in a periodic box. Counts, not times: more ranks than cores are fine.
"""

import sys
from math import pi

from particles_mpi import Scene, Simulation
from particles_mpi.parallel.communicator import Communicator

ranks = Communicator()
each, steps = (int(word) for word in (*sys.argv[1:], *("3000", "6")[len(sys.argv) - 1 :]))
count, radius = each * ranks.size, 0.01
side = (count * 4.0 / 3.0 * pi * radius**3 / 0.30) ** (1.0 / 3.0)
scene = Scene(
    dimension=3,
    seed=3,
    box={"lower": [0.0] * 3, "upper": [side] * 3, "periodic": True},
    time={"step": 0.01, "steps": steps},
    particles=[{"count": count, "position": "random", "velocity": {"temperature": 1.0}, "radius": radius}],
    effects={"collisions": {"mode": "event"}},
)
sim = Simulation(scene)
sim.run()
counted, collisions = sim.counted(), int(ranks.allreduce_sum(sim.totals["collisions"])[0])
ghosts = int(ranks.allreduce_max(counted["ghost_rows"])[0]) // counted["pair_searches"]
if ranks.is_root:
    windows, redone = counted["windows"], counted["windows_redone"]
    print(f"{ranks.size} ranks, {count} spheres, {collisions / steps / ranks.size:.0f} collisions a step and rank:")
    print(f"{windows / steps:.0f} windows a step, {100 * redone / max(windows, 1):.1f} % redone, {ghosts} ghosts on a rank")
