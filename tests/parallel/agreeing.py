"""Faults of the set-up on one of two ranks, one after the other: prints what each rank was told, as JSON. agreeing.py FOLDER"""

import json
import resource
import sys
import time
from pathlib import Path

from mpi4py import MPI

from particles_mpi import Scene, SceneError, Simulation, StoppedError
from particles_mpi.initial.populate import Populator
from particles_mpi.run.scene_file import load

folder, rank = Path(sys.argv[1]), MPI.COMM_WORLD.Get_rank()
GAS = {"count": 30, "position": "random", "velocity": {"speed": 2.0}, "radius": 0.1}
TABLES = {
    "dimension": 2,
    "box": {"lower": [0, 0], "upper": [4, 4]},
    "time": {"step": 0.01, "steps": 4},
    "particles": [GAS],
    "effects": {"collisions": {}, "walls": {}},
}
ROWS = {"position": {"file": "rows.csv"}}


def scene(**changed):
    """The scene with other tables; files are in a folder of the rank's own."""
    return Scene.from_dict(TABLES | changed, folder / str(rank))


def here(name):
    """A file in the folder of this rank."""
    return folder / str(rank) / name


def little_memory():
    """100 MB more than now on rank 1, which half of the particles do not fit into."""
    if rank == 1:
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + 10**8, resource.RLIM_INFINITY))
    try:
        Simulation(scene(particles=[{"count": 4_000_000, "position": "lattice"}], effects={}))
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))


def failing(owner, name):
    """The method fails on rank 1, once."""
    whole = getattr(owner, name)

    def fails(*arguments, **keywords):
        setattr(owner, name, whole)
        return 1 / 0 if rank == 1 else whole(*arguments, **keywords)

    setattr(owner, name, fails)
    Simulation(scene())


here("").mkdir()
sim = Simulation(scene())
sim.run(folder / "run")
sim.to_json(folder / "state.json")
checkpoint, state = (folder / "run" / "checkpoint.h5").read_bytes(), (folder / "state.json").read_text()
if rank == 0:
    here("none.csv").write_text("1,1\n2,2\n")
    here("scene.toml").write_text("dimension = 2\ntime = {step = 0.01, steps = 4}\nparticles = []\n")
    here("checkpoint.h5").write_bytes(checkpoint)
    here("state.json").write_text(state)
    here("damaged.json").write_text(state)
else:
    here("damaged.json").write_text(state.replace('"step": 4', '"step": 3', 1))
here("damaged.h5").write_bytes(checkpoint if rank == 1 else checkpoint[:999] + bytes([checkpoint[999] ^ 1]) + checkpoint[1000:])
here("rows.csv").write_text("1,1\n2,2\n" if rank == 0 else "1,1\n2,3\n")

FAULTS = {
    "scene": lambda: load(here("scene.toml")),
    "scene on rank 0": lambda: load(folder / str(1 - rank) / "scene.toml"),
    "file": lambda: Simulation(scene(particles=[{"position": {"file": "none.csv"}}])),
    "rows": lambda: Simulation(scene(particles=[ROWS])),
    "checkpoint": lambda: Simulation.resume(here("checkpoint.h5")),
    "damaged": lambda: Simulation.resume(here("damaged.h5")),
    "json": lambda: Simulation.from_json(here("state.json")),
    "another json": lambda: Simulation.from_json(here("damaged.json")),
    "scenes": lambda: Simulation(scene(time={"step": 0.01, "steps": 4 + rank}, output={"every": 100})),
    "option": lambda: Simulation(scene()).run(folder / "new", steps=2 + rank),
    "memory": little_memory,
    "populate": lambda: failing(Populator, "columns"),
    "assemble": lambda: failing(sys.modules["particles_mpi.between_steps.state"], "integrator_of"),
}
told = {}
for what, run in FAULTS.items():
    begin = time.perf_counter()
    try:
        run()
    except (SceneError, StoppedError) as error:
        told[what] = type(error).__name__, str(error), time.perf_counter() - begin
    MPI.COMM_WORLD.Barrier()
everywhere = MPI.COMM_WORLD.gather(told)
if rank == 0:
    print(json.dumps(everywhere))
