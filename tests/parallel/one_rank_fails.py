"""A user's script in which something goes wrong on one rank only: one_rank_fails.py FOLDER raise|nan|given rewind|event

What is raised on all ranks is caught; with "raise" it is an exception of that rank alone, which ends all of them.
"""

import sys

import numpy as np

from particles_mpi import Scene, Simulation, StoppedError

tables = {
    "dimension": 2,
    "seed": 3,
    "box": {"lower": [0, 0], "upper": [4, 4]},
    "time": {"step": 0.01, "steps": 40},
    "particles": [{"count": 30, "position": "random", "velocity": {"speed": 2.0}, "radius": 0.1, "acceleration": [0, 0]}],
    "effects": {"collisions": {"mode": sys.argv[3]}, "walls": {}, "user_acceleration": {}},
    "output": {"every": 1, "checkpoint_every": 3, "diagnostics_every": 1},
}
sim = Simulation(Scene.from_dict(tables))
plain_step = sim.step


def step():
    plain_step()
    if sim.steps_done == 10 and sim.ranks.rank == 1:
        if sys.argv[2] == "given":
            sim.particles.acceleration[:9] = np.nan
            return
        sim.rows.velocity[:9] = 1 / 0 if sys.argv[2] == "raise" else np.nan  # ghosts of rank 0 among them


sim.step = step
try:
    sim.run(sys.argv[1])
except StoppedError as error:
    print(error, file=sys.stderr)
    sys.exit(3)
