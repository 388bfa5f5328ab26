"""Runs scenes with effects of the user's on the ranks there are: with output, stopped half way and resumed.

Rank 0 saves the final state.
"""

import json
import sys
from pathlib import Path

import numpy as np

from particles_mpi import Scene, Simulation
from particles_mpi.measure import snapshot
from particles_mpi.parallel.exchange import in_id_order

folder = Path(sys.argv[1])
for path in sorted(folder.glob("*.toml")):
    scene = Scene.load(path)
    sim = Simulation(scene)
    out = folder / f"{path.stem}.{sim.ranks.size}"
    sim.run(out, steps=scene.steps // 2)
    again = Simulation.resume(out / "checkpoint.h5")
    again.run()
    whole = Simulation(scene)
    whole.run()
    same = snapshot.same(*(snapshot.gather_all(one.ranks, one.rows) for one in (again, whole)))
    row = list(whole.measure().values())
    frame = in_id_order(whole.ranks, whole.particles.arrays, whole.ids, 1)
    if whole.ranks.is_root:
        np.savez(folder / f"{path.stem}.{sim.ranks.size}.npz", row=row, **frame)
        (folder / f"{path.stem}.{sim.ranks.size}.json").write_text(json.dumps({"resumed is the same": same}))
