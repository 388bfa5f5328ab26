"""Small piles that settle: some checkpoints with each number of contacts are resumed, and go on as the run itself does.

resumed_piles.py FOLDER
"""

import sys
from collections import Counter
from pathlib import Path

from particles_mpi import Scene, Simulation
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.run.job import Job

X = [2.139, 1.098, 0.988, 1.511, 2.63, 1.751, 0.817, 1.733]
Y = [4.272, 2.738, 4.087, 4.984, 6.98, 8.507, 1.658, 0.822]
RADII = [0.425, 0.479, 0.455, 0.345, 0.36, 0.475, 0.301, 0.464]
ranks, folder = Communicator(), Path(sys.argv[1])
resumed_with = Counter()  # how many with so many rows of contacts
ENOUGH = 8  # in a pile that lies still the next ones would show nothing new


def pile(count, steps, **rough):
    law = {"restitution": 0.5, **rough}
    return Scene(
        dimension=2,
        box={"lower": [0.0, 0.0], "upper": [3.0, 9.1]},
        time={"step": 0.01, "steps": steps},
        particles=[{"position": list(zip(X, Y, strict=True))[:count], "radius": RADII[:count], "mass": 1.0}],
        effects={"uniform_gravity": {"acceleration": [0.0, -10.0]}, "collisions": law, "walls": law},
        output={"formats": ["hdf5"], "every": 1000, "checkpoint_every": 1},
    )


def save_and_resume(job, save=Job.save):
    (rows,) = ranks.total(len(job.sim.lasting_contacts().id))
    if not rows or resumed_with[rows] >= ENOUGH:
        return
    save(job)
    resumed, copy = Simulation.resume(job.folder / "checkpoint.h5"), job.sim.copy()
    resumed.step()
    copy.step()
    assert resumed == copy, f"{job.folder}: not the same after step {job.sim.steps_done}, of {rows} contacts"
    resumed_with[rows] += 1


saved_by = Job.save
try:
    Job.save = save_and_resume
    for name, scene in {"four": pile(4, 120), "eight": pile(8, 120), "rough": pile(8, 120, friction=0.3)}.items():
        Simulation(scene).run(folder / name)
finally:
    Job.save = saved_by  # ranks may stay, for other scripts
assert {4, 8} <= resumed_with.keys()  # as many as ids, whose order is found in another way
if ranks.is_root:
    print("the same bits")
