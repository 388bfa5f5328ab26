"""Particles are added and removed between the parts of a run in one folder, which is resumed: come_and_go.py FOLDER.

Prints, on rank 0, what must be so on any number of ranks, as JSON.
"""

import json
import sys
from pathlib import Path

import numpy as np

from particles_mpi import Scene, SceneError, Simulation, StoppedError
from particles_mpi.measure import snapshot

folder = Path(sys.argv[1])
tables = {
    "dimension": 2,
    "seed": 1,
    "box": {"lower": [0, 0], "upper": [10, 10]},
    "time": {"step": 0.01, "steps": 30},
    "particles": [{"count": 50, "position": "random", "radius": 0.2, "velocity": {"speed": 1.0}}],
    "effects": {"collisions": {}, "walls": {}},
    "output": {"every": 5, "checkpoint_every": 5, "diagnostics_every": 5},
}


def refused(action):
    """What a refused action says."""
    try:
        action()
    except (SceneError, StoppedError, ValueError) as error:
        return str(error)
    return "accepted"


sim = Simulation(Scene(**tables))
sim.run(folder, steps=10)
first = sim.add({"count": 8, "position": "random", "radius": 0.1})
sim.run(folder, steps=20, resumed=True)
place = snapshot.gather_all(sim.ranks, sim.rows).position[7]
said = {
    "overlap": refused(lambda: sim.add({"position": place[None] + 0.1, "radius": 0.2})),
    "outside": refused(lambda: sim.add({"position": [[10.5, 1.0]], "radius": 0.1})),
    "key": refused(lambda: sim.add({"position": [[1.0, 1.0]], "radios": 0.1})),
    "unknown": refused(lambda: sim.remove([3, 99])),
}
sim.remove([3, 4, int(first[0])] if sim.ranks.is_root else [])  # one rank may name them
sim.remove([first[-1]])
second = sim.add({"position": np.array([[-1.0, -1.0]]) + place, "mass": 2.0, "velocity": [0.0, 0.5]})
sim.run(folder, steps=25, resumed=True)
again = Simulation.resume(folder / "checkpoint.h5")
sim.to_json(folder / f"state.{sim.ranks.size}.json")
said |= {
    "ids": [first.tolist(), second.tolist()],
    "total": [sim.total, again.total, len(snapshot.gather_all(sim.ranks, sim.rows))],
    "next id": [sim.next_id, again.next_id],
    "resumed": again == sim,
    "json": Simulation.from_json(folder / f"state.{sim.ranks.size}.json") == sim,
    "copied": sim.copy() == sim,
}
again.run(folder, resumed=True)
sim.rows.replace({name: column[sim.rows.id != 20] for name, column in sim.rows.arrays.items()})
said["lost"] = refused(sim.watch)
if sim.ranks.is_root:
    print(json.dumps(said))
