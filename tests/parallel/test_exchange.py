"""Rows get to the rank they are sent to, whole, once: any number of them, any rank, empty ranks. Ranks get equal work."""

import json
from math import ceil, log2

import pytest
from conftest import run_ranks
from hypothesis import given, settings
from hypothesis import strategies as st
from with_all import with_all

pytestmark = pytest.mark.parallel
case = st.tuples(st.integers(0, 10**6), st.integers(0, 60), st.integers(1, 4), st.integers(0, 4))


@pytest.mark.parametrize("ranks", [2, 3, *with_all(5)])
def test_rows_arrive(tmp_path_factory, ranks):
    @settings(max_examples=2)
    @given(st.lists(case, min_size=30, max_size=60))
    def rows_arrive(cases):
        file = tmp_path_factory.mktemp("exchange") / "cases.json"
        file.write_text(json.dumps(cases))
        done = run_ranks(ranks, "tests/parallel/exchange_rows.py", file)
        assert "all arrived" in done.stdout, done.stderr

    rows_arrive()


@pytest.mark.parametrize("ranks", [2, 3, *with_all(8)])
def test_ranks_get_equal_work(ranks):
    """Space, and the keys of the tree, are divided evenly, with one reduction a level of cuts where positions are spread."""
    done = run_ranks(ranks, "tests/parallel/equal_work.py")
    assert done.returncode == 0, done.stderr
    told, levels = json.loads(done.stdout), ceil(log2(ranks))
    for name, (balance, reductions, balance_of_keys, rounds) in told.items():
        if name == "one place":
            assert balance == balance_of_keys == ranks, name
            continue
        assert balance < 1.01 and balance_of_keys < 1.05, (name, balance, balance_of_keys)
        spread = name not in ("cluster", "crowded")
        assert reductions <= 1 + levels * (1 if spread else 4), (name, reductions)  # the first one: how far positions extend
        assert rounds <= 11, (name, rounds)  # 63 bits, 6 in a round


@pytest.mark.parametrize("ranks", [1, 2, 3])
def test_messages_that_are_too_long_for_mpi_are_sent_in_pieces(ranks):
    done = run_ranks(ranks, "tests/parallel/long_messages.py")
    assert "the same bits" in done.stdout, done.stderr
