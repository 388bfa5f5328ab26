"""What a user changes between two steps counts: going on is the same, to the bit, as a new simulation of that state.

For every field, effect, mode and integrator, on one, two and three ranks, whose results are the same too.
"""

import json

import numpy as np
import pytest
from changed_state import KINDS, SCENES, differences
from conftest import run_ranks
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

RANKS = (1, 2, 3)
TOGETHER = (  # what is changed at once, so that all of it is tried in every scene within seconds
    ("reversed", "radius"),
    ("fixed", "velocity", "position"),
    ("loose", "mass", "swapped"),
    ("drag", "acceleration", "g", "G"),
    ("off", "on", "restitution", "time"),
    ("remove", "add", "h", "off"),
)


def cases():
    """All changes in each scene; in mode event also with space divided between the ranks."""
    for name, tables in SCENES.items():
        after = 2 if name == "adaptive" else 5
        for seed, kinds in enumerate(TOGETHER):
            for divided in (False, True) if name.endswith("event") else (False,):
                changes = [[kind, seed] for kind in kinds]
                yield dict(tables=tables, before=4, changes=changes, after=after, divided=divided)


assert {kind for kinds in TOGETHER for kind in kinds} == set(KINDS)
CASES = list(cases())


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """{ranks: what was printed}, and {(case, ranks): arrays}."""
    folder = tmp_path_factory.mktemp("changed")
    (folder / "cases.json").write_text(json.dumps(CASES))
    said = {}
    for ranks in RANKS:
        done = run_ranks(ranks, "tests/parallel/changed_state.py", folder / "cases.json", folder, timeout=300)
        assert done.returncode == 0, done.stderr[-2000:]
        said[ranks] = done.stdout.splitlines()
    states = {(n, r): dict(np.load(folder / f"{n}.{r}.npz")) for n in range(len(CASES)) for r in RANKS}
    return said, states


@pytest.mark.parallel
@pytest.mark.parametrize("ranks", RANKS)
def test_changed_is_the_same_as_started_fresh(results, ranks):
    assert results[0][ranks] == []


@pytest.mark.parallel
@pytest.mark.parametrize("ranks", RANKS[1:])
def test_changed_on_ranks_is_the_same_as_on_one(results, ranks):
    states = results[1]
    wrong = [
        (n, CASES[n]["changes"], name)
        for n in range(len(CASES))
        for name in states[n, 1]
        if states[n, 1][name].tobytes() != states[n, ranks][name].tobytes()
    ]
    assert not wrong


@settings(max_examples=100, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    name=st.sampled_from([name for name in SCENES if name != "adaptive"]),
    before=st.integers(0, 8),
    changes=st.lists(st.tuples(st.sampled_from(KINDS), st.integers(0, 99)), min_size=1, max_size=4),
)
def test_any_changes_are_the_same_as_a_fresh_start(name, before, changes):
    assert differences(SCENES[name], before, changes, 3)[1] == []
