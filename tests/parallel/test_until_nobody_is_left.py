"""Ranks with all particles, with few and with none take the same decisions, and come to the same bits."""

import json

import pytest
from conftest import run_ranks
from with_all import with_all, with_search

pytestmark = pytest.mark.parallel


@pytest.mark.parametrize(("seed", "count"), [(61, 6), *with_all((62, 20)), *with_search(*((seed, 60) for seed in range(63, 68)))])
def test_until_nobody_is_left(seed, count, tmp_path):
    found = []
    for ranks in (1, 2, 3):
        done = run_ranks(ranks, "tests/parallel/until_nobody_is_left.py", seed, count, tmp_path / f"{ranks}.json", timeout=240)
        assert done.returncode == 0, done.stderr[-2000:]
        found.append(json.loads((tmp_path / f"{ranks}.json").read_text()))
    assert found[1] == found[0] and found[2] == found[0]
    assert sum(isinstance(states, list) for states in found[0]) > count // 2
