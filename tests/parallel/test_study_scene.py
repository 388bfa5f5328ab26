"""The study of a user's scene under mpirun: the same errors to the bit, and one decision for all ranks."""

import json

import pytest
from conftest import run_ranks

pytestmark = pytest.mark.parallel


def test_errors_of_a_scene_have_the_same_bits_on_any_ranks(tmp_path):
    for ranks in (1, 2):
        done = run_ranks(ranks, "tests/parallel/study_errors.py", tmp_path, timeout=300)
        assert done.returncode == 0, done.stderr
    one, two = (json.loads((tmp_path / f"{ranks}.json").read_text()) for ranks in (1, 2))
    assert one == two and len(one["gas"]["rows"]) == 4 and one["gas"]["floors"]
