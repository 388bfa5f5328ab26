"""Run scenes (a JSON file of named ones) into FOLDER/NAME: to the end, to a step, or on from there.

stop_and_go.py SCENES FOLDER [STEPS | resume]
"""

import json
import sys
from pathlib import Path

from particles_mpi import Scene, Simulation

scenes, folder, how = json.loads(Path(sys.argv[1]).read_text()), Path(sys.argv[2]), sys.argv[3:]
for name, tables in scenes.items():
    out = folder / name
    if how == ["resume"]:
        Simulation.resume(out / "checkpoint.h5").run(out, resumed=True)
    else:
        Simulation(Scene.from_dict(tables)).run(out, steps=int(how[0]) if how else None)
