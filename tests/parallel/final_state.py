"""Run scenes (a JSON file of named ones) and save, on rank 0, everything that must not depend on the number of ranks."""

import json
import sys
from pathlib import Path

import numpy as np

from particles_mpi import Scene, Simulation
from particles_mpi.contacts.persistent import solver
from particles_mpi.parallel import exchange
from particles_mpi.parallel.exchange import in_id_order

folder, FEW, FEW_CONTACTS = Path(sys.argv[2]), exchange.ONE_MESSAGE, solver.FEW_HALF_EDGES
for name, tables in json.loads(Path(sys.argv[1]).read_text()).items():
    windows = tables.pop("windows", False)
    exchange.ONE_MESSAGE = tables.pop("few", FEW)
    large = tables.pop("large", False)
    solver.FEW_HALF_EDGES = 0 if large else FEW_CONTACTS  # no rank solves for contacts that are not its own
    scene = Scene.from_dict(tables)
    sim = Simulation(scene)
    if windows and sim.ranks.size > 1:  # divide space however few there are
        sim.near.divided = sim.near.windows.always = True
    if large and sim.persistent:
        sim.persistent.slow.effort = 0
    rows = []
    for _ in range(scene.steps):
        sim.step()
        rows.append(list(sim.measure().values()))
    counts = sim.ranks.allreduce_sum(np.array([sim.totals[name] for name in ("collisions", "wall_hits", "missed")]))
    traffic = sim.ranks.allreduce_sum(
        np.array([sim.ranks.messages, sim.totals["exchanges"], sim.near.ghost_rows if sim.near else 0])
    )
    windows = np.array(sim.near.window_counts if sim.near else (0, 0))
    interactions = np.array(sim.work()["interactions"])
    frame = in_id_order(sim.ranks, sim.particles.arrays, sim.ids, 1)
    if sim.ranks.is_root:
        assert (frame["id"] == np.arange(sim.total)).all()  # a permutation: nobody lost, nobody twice
        about = {"counts": counts, "rows": np.array(rows), "traffic": traffic, "windows": windows, "interactions": interactions}
        np.savez(folder / f"{name}.{sim.ranks.size}.npz", **about, **frame)
exchange.ONE_MESSAGE, solver.FEW_HALF_EDGES = FEW, FEW_CONTACTS
