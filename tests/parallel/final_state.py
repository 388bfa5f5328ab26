"""Run a scene (JSON on the command line) and save, on rank 0, everything that must not depend on the number of ranks."""

import json
import sys

import numpy as np

from particles_mpi import Scene, Simulation
from particles_mpi.parallel.exchange import in_id_order

scene, path = Scene.from_dict(json.loads(sys.argv[1])), sys.argv[2]
sim = Simulation(scene)
rows = []
for _ in range(scene.steps):
    sim.step()
    rows.append(list(sim.measure().values()))
counts = sim.ranks.total(np.array([sim.totals[name] for name in ("collisions", "wall_hits", "missed")]))
frame = in_id_order(sim.ranks, sim.particles.arrays, sim.total, 1, scene.dimension)
traffic = sim.ranks.total(np.array([sim.ranks.messages, sim.totals["exchanges"], sim.near.ghost_rows if sim.near else 0]))
if sim.ranks.is_root:
    assert (frame["id"] == np.arange(sim.total)).all()  # a permutation: nobody lost, nobody twice
    np.savez(path, counts=counts, rows=np.array(rows), traffic=traffic, **frame)
