"""The faults that tests/benchmarks/mutations.py makes on purpose are still faults of the code as it is."""

import sys

import pytest
from conftest import ROOT

sys.path.insert(0, str(ROOT / "tests" / "benchmarks"))
from mutations import MUTATIONS


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.name)
def test_each_can_be_made(mutation):
    assert (ROOT / "particles_mpi" / mutation.file).read_text().count(mutation.old) == 1
    assert mutation.new != mutation.old
    assert all(
        word.startswith("-") or (ROOT / word).exists() or before == "-k"
        for before, word in zip(("", *mutation.tests), mutation.tests)
    )
