"""What is refused because no machine, or no job on it, has the memory for it."""

import numpy as np
import pytest

from particles_mpi import Scene, SceneError, Simulation
from particles_mpi.scene import memory
from particles_mpi.scene.memory import memory_there


def gas(count):
    box = {"lower": [0.0] * 3, "upper": [4.0] * 3}
    spheres = {"count": count, "position": "random", "velocity": {"speed": 0.5}, "radius": 0.001}
    time = {"step": 1e-3, "steps": 3}
    return {"dimension": 3, "box": box, "time": time, "particles": [spheres], "effects": {"collisions": {}}}


@pytest.fixture
def groups(tmp_path, monkeypatch):
    """Folders as of Linux's control groups."""
    monkeypatch.setattr(memory, "CGROUPS", tmp_path)
    return tmp_path


def test_a_limit_of_a_job_is_seen(groups, monkeypatch):
    """Of any group that contains the one of this process."""
    whole = memory_there()
    for name in ("memory.max", "memory/memory.limit_in_bytes"):
        (groups / name).parent.mkdir(exist_ok=True)
        (groups / name).write_text("max\n")
    assert memory_there() == whole
    for name in ("memory.max", "memory/memory.limit_in_bytes"):
        (groups / name).write_text("300000000\n")
    assert memory_there() == 3e8
    monkeypatch.setattr("particles_mpi.initial.populate.memory_there", memory_there)
    with pytest.raises(
        SceneError, match=r"particles\[0\].count: 300000 particles .* need about 0.3\d+ GB; the machine has 0.3 GB"
    ):
        Simulation(Scene.from_dict(gas(300_000)))
    assert np.isfinite(Simulation(Scene.from_dict(gas(30_000))).measure()["kinetic"])
