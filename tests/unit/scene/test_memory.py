"""How much memory a run needs: told before it runs, and refused where the machine has less."""

import numpy as np
import pytest
from conftest import run_ranks
from with_all import with_all

from particles_mpi import Scene, SceneError, Simulation
from particles_mpi.scene import memory
from particles_mpi.scene.memory import memory_needed, memory_there

GROWTH = """
import resource, sys
from particles_mpi import Scene, Simulation

sim = Simulation(Scene.from_dict({tables}))
sim.run(sys.argv[1])
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024)
"""


def gas(count, **effects):
    side = 4.0 * (count / 32000) ** (1 / 3)
    return {
        "dimension": 3,
        "box": {"lower": [0.0] * 3, "upper": [side] * 3},
        "time": {"step": 0.02, "steps": 3},
        "particles": [{"count": count, "position": "random", "velocity": {"speed": 0.5}, "radius": 0.01}],
        "effects": effects,
        "output": {"every": 3},
    }


@pytest.mark.parametrize(
    "effects",
    [
        {"collisions": {}},
        *with_all({}, {"collisions": {"mode": "event"}}, {"mutual_gravity": {"G": 1e-9, "softening": 0.01, "method": "tree"}}),
    ],
)
def test_as_much_is_used_as_is_told(effects, tmp_path):
    """Within a third, of what two runs differ by; and no more than that in all."""
    used, told = [], []
    for count in (100_000, 300_000):
        tables = gas(count, **effects)
        (tmp_path / "grow.py").write_text(GROWTH.format(tables=tables))
        done = run_ranks(1, tmp_path / "grow.py", tmp_path / str(count), fresh=True)
        used.append(int(done.stdout))
        told.append(memory_needed(Scene.from_dict(tables), count, 1))
    (small, large), (least, most) = used, told
    assert 0.67 < (large - small) / (most - least) < 1.33 and large < 1.33 * most


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
        Simulation(Scene.from_dict(gas(300_000, collisions={})))
    assert np.isfinite(Simulation(Scene.from_dict(gas(30_000, collisions={}))).measure()["kinetic"])
