"""The script in the page of the files: it reads what `Run` reads."""

import re
from pathlib import Path

import numpy as np

import particles_mpi.output
from particles_mpi import Run, Scene, Simulation


def test_the_script_reads_the_last_frame(tmp_path):
    """Of a run in which particles came and went, so that a frame begins where the others end."""
    sim = Simulation(
        Scene(dimension=2, seed=1, time={"step": 0.1, "steps": 30}, output={"every": 10},
              particles=[{"count": 5, "position": [[i, 0] for i in range(5)], "velocity": [[i, 1] for i in range(5)]}])
    )  # fmt: skip
    sim.run(tmp_path, steps=10)
    sim.add({"position": [[9, 9]], "velocity": [1, 0]})
    sim.run(tmp_path, steps=20)
    sim.remove([1, 2])
    sim.run(tmp_path)
    page = (Path(particles_mpi.output.__file__).parent / "README.md").read_text()
    (script,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    found = {}
    exec(script.replace("out/marbles", str(tmp_path)), found)
    last = Run(tmp_path)[-1]
    assert (found["step"], found["time"], len(found["position"])) == (30, last.time, 4)
    for name in ("position", "velocity"):
        assert np.array_equal(found[name][:, :2], last[name]) and not found[name][:, 2].any()
