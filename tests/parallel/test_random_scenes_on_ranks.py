"""Scenes at random, with any effects at once, have the same bits on any number of ranks, however ranks share the work."""

import json

import numpy as np
import pytest
from conftest import run_ranks
from random_scenes import random_scenes
from with_all import with_all, with_search

pytestmark = pytest.mark.parallel

SHARED = [{}, {"few": 0}, {"large": True}, {"windows": True}]  # of final_state.py


@pytest.mark.parametrize(
    ("seed", "count", "axes", "on_three"),
    [(50, 24, 3, 6), *with_all((22, 40, 4, 1)), *with_search((50, 40, 3, 1), *((seed, 40, 4, 1) for seed in range(23, 31)))],
)
def test_same_bits(seed, count, axes, on_three, tmp_path):
    """One rank and two; and three, which share two cores and take three times as long, for some of the scenes or for all.

    `interactions` is left out: where all are fixed, forces may be summed once or twice.
    """
    scenes = {name: tables for name, tables, _ in random_scenes(seed, count, axes)}
    for number, tables in enumerate(scenes.values()):
        how = SHARED[number % len(SHARED)]
        event = tables["effects"].get("collisions", {}).get("mode") == "event"
        tables |= how if event or "windows" not in how else {}
    names = {1: list(scenes), 2: list(scenes), 3: list(scenes)[::on_three]}
    for ranks, some in names.items():
        file = tmp_path / f"scenes.{ranks}.json"
        file.write_text(json.dumps({name: scenes[name] for name in some}))
        done = run_ranks(ranks, "tests/parallel/final_state.py", file, tmp_path, timeout=300)
        assert done.returncode == 0, done.stderr[-2000:]
    different = []
    for ranks in (2, 3):
        for name in names[ranks]:
            one, many = (np.load(tmp_path / f"{name}.{number}.npz") for number in (1, ranks))
            keys = set(one.files) - {"traffic", "windows", "interactions"}
            different += [(name, ranks, key) for key in keys if one[key].tobytes() != many[key].tobytes()]
    assert not different
