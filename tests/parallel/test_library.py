"""`step_to_collision`, `copy`, `==`, `attach` and JSON say the same on all ranks, and on any number of them."""

import json

import pytest
from conftest import run_ranks
from with_all import with_all

pytestmark = pytest.mark.parallel


@pytest.mark.parametrize("many", [2, *with_all(3)])
def test_the_library_on_any_ranks(many, tmp_path):
    said, files = [], []
    for ranks in (1, many):
        done = run_ranks(ranks, "tests/parallel/library.py", tmp_path)
        assert done.returncode == 0, done.stderr[-2000:]
        said.append(done.stdout.strip())
        files.append(json.loads((tmp_path / f"{ranks}.json").read_text())["particles"])
    assert said[0].count("0x1.") >= 12 and "('same again', True)" in said[0] and "('charge', True, True)" in said[0]
    assert "('the same on other ranks', True, True), ('a step later on the last rank', False)" in said[0]
    assert "('same before and after', False)" in said[0] and "('json', True)" in said[0]
    assert said[0].count("('fixed', ['collision_rate', 'z_virial', 'z_rate'])") == 3 == said[0].count("('radius', ['z_rate'])")
    assert said[1] == said[0]
    assert files[1] == files[0]
