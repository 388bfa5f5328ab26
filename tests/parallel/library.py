"""The library under MPI: prints on every rank what must be the same on all, on any number of them."""

import sys
from pathlib import Path

import numpy as np
from random_scenes import random_tables

from particles_mpi import Scene, Simulation

folder = Path(sys.argv[1])
tables = {
    "dimension": 2,
    "seed": 3,
    "box": {"lower": [0, 0], "upper": [4, 4]},
    "time": {"step": 0.02, "steps": 60},
    "particles": [{"count": 30, "position": "random", "velocity": {"speed": 2.0}, "radius": 0.1, "mass": 0.5}],
    "effects": {"collisions": {"mode": "event", "restitution": 0.9}, "walls": {}, "uniform_gravity": {"acceleration": [0, -1]}},
}
sim = Simulation(Scene.from_dict(tables))
met = []
while len(met) < 12:
    pair = sim.step_to_collision()
    if pair:
        met.append((*pair, sim.time.hex()))
twin = sim.copy()
sim.step()
met.append(("same before and after", sim == twin))
twin.step()
met.append(("same again", sim == twin))

piling = Simulation(Scene.from_dict(random_tables(np.random.default_rng(2059)) | {"output": {}}))  # with contacts that last
for _ in range(10):
    met.append((piling.step_to_collision(), piling.time.hex()))

tables["effects"]["collisions"] = {"restitution": 0.9}
roaming = Simulation(Scene.from_dict(tables))
roaming.attach("charge", np.arange(30) * 0.5)
roaming.run()
p = roaming.particles
away = int(roaming.ranks.allreduce_sum(roaming.totals["exchanges"])[0])
met.append(("charge", bool((p.charge == p.id * 0.5).all()), away > 0 or roaming.ranks.size == 1))
roaming.to_json(folder / f"{roaming.ranks.size}.json")
roaming.ranks.comm.Barrier()
met.append(("json", Simulation.from_json(folder / f"{roaming.ranks.size}.json") == roaming))
everywhere = roaming.ranks.allgather(met)
assert all(other == met for other in everywhere), everywhere
if roaming.ranks.is_root:
    print(met)
