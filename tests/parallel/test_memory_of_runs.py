"""The memory that a run takes is that which the plan tells."""

import json

import pytest
from conftest import run_ranks
from with_all import with_all

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
        told.append(json.loads((tmp_path / str(count) / "run.json").read_text())["plan"]["memory_bytes"])
    (small, large), (least, most) = used, told
    assert 0.67 < (large - small) / (most - least) < 1.33 and large < 1.33 * most
