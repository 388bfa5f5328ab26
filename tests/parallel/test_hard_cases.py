"""Hard cases on several ranks: what must hold, holds, with the bits of one rank."""

import json

import pytest
from conftest import run_ranks

pytestmark = pytest.mark.parallel
SPREAD = "on borders|crossing many|one rank's corner|squeezed|rough hits"
MORE = "three particles|overlap at|between a floor"
SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    ("ranks", "only"), [(2, SPREAD), *(pytest.param(*one, marks=SLOW) for one in ((2, MORE), (5, f"{SPREAD}|{MORE}")))]
)
def test_the_bits_of_one_rank(tmp_path, ranks, only):
    """The command on several ranks runs each case on all and on one, and compares."""
    file = tmp_path / "new" / "outcomes.json"
    done = run_ranks(ranks, "-m", "particles_mpi", "study", "hard-cases", "--only", only, "--output", file, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    outcomes = json.loads(file.read_text())
    assert len(outcomes) == 4 * len(only.split("|"))
    assert all(outcome["holds"] and outcome["same_bits"] for outcome in outcomes)
    assert f"{len(outcomes)} of {len(outcomes)} hold, each with the same bits on {ranks} ranks as on one" in done.stdout


def test_a_case_that_fails_is_exit_code_3(monkeypatch, capsys):
    """`study_hard_cases` says so, and which."""
    from particles_mpi.study.hard_cases import catalogue

    wrong = catalogue.Case("wrong", "nothing", "that 1 is 2", lambda run: ("1", False), (None,), (2,), False)
    monkeypatch.setattr(catalogue, "catalogue", lambda: [wrong])
    assert not catalogue.study_hard_cases(None, False, None)
    assert "FAIL" in capsys.readouterr().out
    done = run_ranks(1, "-m", "particles_mpi", "study", "hard-cases", "--only", "no such case")
    assert done.returncode == 2 and "--only: no case" in done.stderr and "Traceback" not in done.stderr
