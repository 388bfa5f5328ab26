"""The library under MPI: prints on every rank what must be the same on all, on any number of them."""

import sys
from pathlib import Path

import numpy as np
from mpi4py import MPI
from random_scenes import random_tables

from particles_mpi import Scene, SceneError, Simulation

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

gas = Scene.from_dict(tables | {"effects": {"collisions": {}, "walls": {}}, "output": {"observables": True}})
for name, value in (("fixed", True), ("radius", 0.05)):  # of a particle of the last rank, for a step
    changed = Simulation(gas)
    changed.steps(5)
    before, ranks = 0.1 if name == "radius" else False, changed.ranks
    which = ranks.largest(changed.particles.id.max() if ranks.rank == ranks.size - 1 else -1)[0]
    for given in (value, before):
        changed.particles[name][changed.particles.id == which] = given
        changed.step()
    changed.to_json(folder / "changed.json")
    ranks.comm.Barrier()
    for one in (changed, changed.copy(), Simulation.from_json(folder / "changed.json")):
        one.steps(30)
        row = one.measure()
        met.append((name, [key for key in ("collision_rate", "z_virial", "z_rate") if np.isnan(row[key])]))

tables["effects"]["collisions"] = {"restitution": 0.9}
roaming = Simulation(Scene.from_dict(tables))
roaming.attach("charge", np.arange(30) * 0.5)
roaming.run()
for _ in range(20):  # mode rewind, as its particles wander from rank to rank
    met.append((roaming.step_to_collision(), roaming.time.hex()))
    roaming.step()
p = roaming.particles
away = int(roaming.ranks.allreduce_sum(roaming.totals["exchanges"])[0])
met.append(("charge", bool((p.charge == p.id * 0.5).all()), away > 0 or roaming.ranks.size == 1))
roaming.to_json(folder / f"{roaming.ranks.size}.json")
roaming.ranks.comm.Barrier()
met.append(("json", Simulation.from_json(folder / f"{roaming.ranks.size}.json") == roaming))
alone = Simulation(Scene.from_dict(tables), comm=MPI.COMM_SELF)
again = Simulation(Scene.from_dict(tables))
met.append(("the same on other ranks", again == alone, alone == again))
if roaming.ranks.rank == roaming.ranks.size - 1:
    alone.step()
met.append(("a step later on the last rank", again == alone))
mine = roaming.ranks.rank
for what, change in {
    "attach": lambda: again.attach("weight", np.arange(30.0) + mine),
    "name": lambda: again.attach(f"weight{mine}", np.arange(30.0)),
    "time": lambda: setattr(again, "time", "now" if mine else 1.0),
    "option": lambda: setattr(again.effects["collisions"], "restitution", 7.0 if mine else 0.5),
    "add": lambda: again.add([1.0] if mine else {"position": [[0.1, 0.1]]}),
    "steps": lambda: again.run(folder / "none", steps="5" if mine else 5),
}.items():  # told on all ranks, if it is not the same on all
    if roaming.ranks.size > 1:
        try:
            change()
        except SceneError:
            continue
        met.append(f"{what} may differ on ranks")
everywhere = roaming.ranks.allgather(met)
assert all(other == met for other in everywhere), everywhere
if roaming.ranks.is_root:
    print(met)
