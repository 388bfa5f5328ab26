"""`step_to_collision`, `copy`, `==`, `attach` and JSON say the same on all ranks, and on any number of them."""

import json

import pytest
from conftest import run_ranks

pytestmark = pytest.mark.parallel


def test_the_library_on_any_ranks(tmp_path):
    said, files = [], []
    for ranks in (1, 2, 3):
        done = run_ranks(ranks, "tests/parallel/library.py", tmp_path)
        assert done.returncode == 0, done.stderr[-2000:]
        said.append(done.stdout.strip())
        files.append(json.loads((tmp_path / f"{ranks}.json").read_text())["particles"])
    assert said[0].count("0x1.") >= 12 and "('same again', True)" in said[0] and "('charge', True, True)" in said[0]
    assert "('same before and after', False)" in said[0] and "('json', True)" in said[0]
    assert said[1] == said[0] and said[2] == said[0]
    assert files[1] == files[0] and files[2] == files[0]
