"""`study scaling` of a scene of a few particles: scale_scene.py FOLDER gas|events|listed|cluster [counts], quick."""

import sys
from pathlib import Path

from particles_mpi import Scene
from particles_mpi.study.scaling import measure
from particles_mpi.study.scaling.counted import count_scaling

measure.QUICK_SAMPLE_SECONDS = 0.005  # how long steps take is nobody's question here
SCENES = {
    "gas": {
        "particles": [{"count": 2000, "position": "random", "velocity": {"speed": 0.5}, "radius": 0.01, "mass": 1.0}],
        "box": {"lower": [0, 0, 0], "upper": [1, 1, 1]},
        "effects": {"collisions": {}, "walls": {}},
    },
    "events": {
        "particles": [{"count": 2000, "position": "random", "velocity": {"speed": 0.5}, "radius": 0.01, "mass": 1.0}],
        "box": {"lower": [0, 0, 0], "upper": [1, 1, 1]},
        "effects": {"collisions": {"mode": "event"}, "walls": {}},
    },
    "listed": {"particles": [{"position": [[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], "mass": 1.0}], "effects": {"mutual_gravity": {}}},
    "cluster": {
        "particles": [{"count": 600, "position": {"plummer": 1.0}, "velocity": "equilibrium", "mass": 0.001}],
        "effects": {"mutual_gravity": {"method": "tree"}},
    },
}
time = {"step": 0.01, "steps": 40}
tables = {"title": sys.argv[2], "dimension": 3, "G": 1.0, "time": time, **SCENES[sys.argv[2]]}
(count_scaling if sys.argv[3:] else measure.measure_scaling)(Scene.from_dict(tables), Path(sys.argv[1]), quick=True)
