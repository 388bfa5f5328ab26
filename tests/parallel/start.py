"""Starts of scenes on the ranks that run this: prints, as JSON of rank 0, a digest of all particles of each, or its faults.

start.py FOLDER, in which there are CSV files.
"""

import hashlib
import json
import sys
import tracemalloc
from pathlib import Path

import numpy as np

from particles_mpi import Scene, SceneError
from particles_mpi.initial import random_addition
from particles_mpi.initial.populate import populate
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import allgather_rows

folder, ranks = Path(sys.argv[1]), Communicator()
COLLIDING = {"collisions": {}, "walls": {}}
MIXED = {"min": 0.002, "max": 0.02}


def scene(particles, effects=COLLIDING, d=2, upper=1.0, periodic=False, step=1e-4, **more):
    """Some populations in a box."""
    box = {"lower": [0.0] * d, "upper": [upper] * d, "periodic": periodic}
    tables = {"dimension": d, "seed": 3, "box": box, "time": {"step": step, "steps": 1}, "effects": effects}
    return Scene.from_dict(tables | {"particles": particles} | more, folder)


def gas(count, radius, **more):
    """Random places, speeds in a range, masses in a range."""
    return {"count": count, "position": "random", "radius": radius, "mass": {"min": 1, "max": 2}} | more


LEFT = {"planes": [{"point": [0.0, 0.0], "normal": [1.0, 0.0]}]}
SLOPE = {"planes": [{"point": [0.5, 0.5], "normal": [1.0, 1.0]}]}
TWO = [gas(900, MIXED, velocity={"speed": {"min": 0.1, "max": 0.2}}), gas(40, 0.03), {"position": [[0.5, 0.5], [0.01, 0.99]]}]
STARS = {"count": 300, "position": {"plummer": 1.0}, "velocity": "equilibrium", "mass": {"min": 0.1, "max": 1.0}}
WARM = {"temperature": 2.0}
FIXED = [k % 7 == 0 for k in range(500)]
CROWD = {"position": [[0.05 * k % 1, 0.25 * (k // 20) + 0.01 * (k % 3)] for k in range(80)], "radius": 0.03}
PULL = [[float(k == 17), 1.0] for k in range(30)]
SCENES = {
    "discs": scene(TWO),
    "periodic discs": scene(TWO, {"collisions": {}}, periodic=True),
    "spheres": scene([gas(3000, 0.02, velocity=WARM)], d=3, periodic=[True, False, True]),
    "rods": scene([gas(300, 0.001)], d=1),
    "five dimensions": scene([gas(200, 0.1, velocity={"speed": 1.0})], d=5, periodic=True, effects={"collisions": {}}),
    "a slope": scene([gas(300, 0.01)], {"collisions": {}, "walls": SLOPE}),
    "free points": scene([gas(500, 0.2, velocity=WARM, fixed=FIXED)], {}),
    "a lattice": scene([{"count": 700, "position": "lattice", "radius": 0.017}, {"count": 0, "position": "random"}]),
    "a crystal": scene([{"count": 1000, "position": "lattice", "radius": 0.05}], d=3, periodic=True, effects={"collisions": {}}),
    "stars": scene([STARS], {"mutual_gravity": {}}, d=3, box=None, G=1.0),
    "pushed apart": scene([CROWD], {"collisions": {"allow_overlap": True}}, periodic=True),
    "a file": scene([{"position": {"file": "rows.csv"}, "velocity": {"file": "bare.csv"}, "radius": 1e-4}]),
    "a file that cannot be read": scene([{"position": {"file": "oops.csv"}}]),
    "a file with a number that is none": scene([{"position": {"file": "nan.csv"}}]),
    "an empty file": scene([{"position": {"file": "empty.csv"}}]),
    "no file": scene([{"position": {"file": "none.csv"}}]),
    "overlaps": scene([{"position": [[0.01 * (k % 97) + 0.01, 0.5] for k in range(100)], "radius": 0.005}], {"collisions": {}}),
    "outside": scene([{"position": [[0.02 * k, 0.5] for k in range(60)]}], {}),
    "in walls": scene([{"position": [[0.02 * k + 0.01, 0.02] for k in range(40)], "radius": 0.03}], {"walls": LEFT}),
    "too fast": scene([gas(100, 0.01, velocity={"speed": {"min": 10.0, "max": 1000.0}})]),
    "too many": scene([gas(500, 0.05)]),
    "too wide": scene([gas(5, 0.6)]),
    "masses": scene([gas(30, 0.01, mass=[float(k % 3) for k in range(30)])]),
    "warm and massless": scene([gas(30, 0.0, mass=[float(k % 3) for k in range(30)], velocity=WARM)], {}),
    "at one place": scene([{"position": [[0.1 * (k // 2), 0.0] for k in range(20)]}], {"mutual_gravity": {}}, G=1.0, box=None),
    "endless falls": scene([gas(30, 0.0, acceleration=PULL)], {"user_acceleration": {}}, periodic=[True, False]),
}


def digest(described):
    """Of all particles in id order, and warnings; or the faults."""
    try:
        mine, warnings = populate(described, ranks)
    except SceneError as error:
        return error.faults
    low, high = ranks.share(int(ranks.allreduce_sum(len(mine))[0]))
    assert np.array_equal(mine.id, np.arange(low, high))
    all_ = allgather_rows(ranks, mine.arrays)
    return [hashlib.sha256(b"".join(all_[name].tobytes() for name in sorted(all_))).hexdigest(), *warnings]


told = {}
for few, points in ((50, 200), (10_000, 100_000)):  # random places by parts of space, and all on all ranks
    random_addition.FEW_LEFT, random_addition.POINTS_AT_ONCE = few, points
    for name, described in SCENES.items():
        found = digest(described)
        assert told.setdefault(name, found) == found or name == "too many", (name, few)  # that tells how many it tried
random_addition.SPHERES_AT_ONCE, random_addition.FEW_LEFT = 300, 50
for name in ("discs", "periodic discs", "spheres"):
    told[f"{name}, in parts"] = digest(SCENES[name])
random_addition.SPHERES_AT_ONCE, random_addition.FEW_LEFT = 2**20, 10_000
tracemalloc.start()
populate(scene([gas(60_000, 0.001, velocity=WARM)], d=3), ranks)
told["bytes a particle"] = int(ranks.allreduce_max(tracemalloc.get_traced_memory()[1])[0]) / 60_000
everywhere = ranks.allgather(told)
assert all(other == told for other in everywhere)
if ranks.is_root:
    print(json.dumps(told))
