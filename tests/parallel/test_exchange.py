"""Rows get to the rank they are sent to, whole, once: any number of them, any rank, empty ranks."""

import json

import pytest
from conftest import run_ranks
from hypothesis import given, settings
from hypothesis import strategies as st

pytestmark = pytest.mark.parallel
case = st.tuples(st.integers(0, 10**6), st.integers(0, 60), st.integers(1, 4), st.integers(0, 4))


@pytest.mark.parametrize("ranks", [2, 3, pytest.param(5, marks=pytest.mark.slow)])
def test_rows_arrive(tmp_path_factory, ranks):
    @settings(max_examples=2, deadline=None)
    @given(st.lists(case, min_size=30, max_size=60))
    def rows_arrive(cases):
        file = tmp_path_factory.mktemp("exchange") / "cases.json"
        file.write_text(json.dumps(cases))
        done = run_ranks(ranks, "tests/parallel/exchange_rows.py", file)
        assert "all arrived" in done.stdout, done.stderr

    rows_arrive()
