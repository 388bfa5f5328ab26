"""Shows a simulation on the ranks that run this; rank 0 prints a digest of what a notebook gets, and of the last state."""

import sys
from hashlib import sha256
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from unittest.mock import patch

from browser import Recorder

from particles_mpi import Scene, Simulation
from particles_mpi.results import notebook

gas = {"count": 60, "position": "random", "radius": 0.2, "velocity": {"speed": 1.0}}
scene = Scene(dimension=3, box={"lower": [0] * 3, "upper": [6] * 3}, time={"step": 0.05, "steps": 20}, particles=[gas],
              effects={"walls": {}, "collisions": {}}, output={"every": 5})  # fmt: skip
plain, sim = Simulation(scene), Simulation(scene)
with patch.object(notebook, "_display", Recorder):
    sim.view()
    sim.run()
plain.run()
assert sim == plain  # to look changes nothing
(view,) = sim.views
if sim.ranks.is_root:
    shown = b"".join(frame[name].tobytes() for frame in view.frames for name in frame.fields)
    print(len(view.frames), sha256(shown).hexdigest())
