"""Scenes at random, with any effects at once, have the same bits on one, two and three ranks, however ranks share the work."""

import json

import numpy as np
import pytest
from conftest import run_ranks
from random_scenes import random_scenes

pytestmark = pytest.mark.parallel

COUNT = 40
SHARED = [{}, {"few": 0}, {"large": True}, {"windows": True}]  # of final_state.py


@pytest.mark.parametrize(("seed", "axes"), [(21, 3), *(pytest.param(seed, 4, marks=pytest.mark.slow) for seed in range(22, 30))])
def test_same_bits(seed, axes, tmp_path):
    """`interactions` is left out: where all are fixed, forces may be summed once or twice."""
    scenes = random_scenes(seed, COUNT, axes)
    for number, tables in enumerate(scenes.values()):
        how = SHARED[number % len(SHARED)]
        event = tables["effects"].get("collisions", {}).get("mode") == "event"
        tables |= how if event or "windows" not in how else {}
    (tmp_path / "scenes.json").write_text(json.dumps(scenes))
    for ranks in (1, 2, 3):
        done = run_ranks(ranks, "tests/parallel/final_state.py", tmp_path / "scenes.json", tmp_path, timeout=300)
        assert done.returncode == 0, done.stderr[-2000:]
    different = []
    for name in scenes:
        one = np.load(tmp_path / f"{name}.1.npz")
        for ranks in (2, 3):
            many = np.load(tmp_path / f"{name}.{ranks}.npz")
            keys = set(one.files) - {"traffic", "windows", "interactions"}
            different += [(name, ranks, key) for key in keys if one[key].tobytes() != many[key].tobytes()]
    assert not different
