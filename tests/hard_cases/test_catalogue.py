"""The catalogue of hard cases: what must hold, holds; on several ranks with the bits of one."""

import json

import pytest
from conftest import run_ranks

from particles_mpi.study.hard_cases import catalogue, examine, settings
from particles_mpi.study.hard_cases.report import where

# Cases that take seconds, by the beginnings of their names: the modes and dimensions that run without --all.
HEAVY = {
    "resting ball": (),  # test_rest.py has them, and looks at more
    "resting columns": (),
    "beds of 200": (("event", 2),),
    "1e5 bounces of an elastic ball": (("rewind", 2),),
    "1e5 bounces under gravity": ((None, 2),),
    "1e6 Kepler orbits": (),
    "close encounter, e = 0.999, not softened": ((None, 2),),
}


def parameters():
    """All cases that take less than minutes, in each of their modes and dimensions."""
    for one, mode, dimension in settings([one for one in catalogue() if not one.long]):
        few = next((few for name, few in HEAVY.items() if one.name.startswith(name)), ((mode, dimension),))
        marks = () if (mode, dimension) in few else pytest.mark.slow
        yield pytest.param(one, mode, dimension, marks=marks, id=f"{one.name}, {where(mode, dimension)}")


SPREAD = "on borders|crossing many|one rank's corner|three particles|overlap at|squeezed"


@pytest.mark.parametrize(("one", "mode", "dimension"), parameters())
def test_what_must_hold(one, mode, dimension):
    outcome = examine(one, mode, dimension)
    assert outcome.holds, f"{one.must}; measured: {outcome.measured}"


@pytest.mark.parallel
@pytest.mark.parametrize("ranks", [2, pytest.param(5, marks=pytest.mark.slow)])
def test_the_bits_of_one_rank(tmp_path, ranks):
    """The command on several ranks runs each case on all and on one, and compares."""
    file = tmp_path / "outcomes.json"
    done = run_ranks(ranks, "-m", "particles_mpi", "study", "hard-cases", "--only", SPREAD, "--output", file, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    outcomes = json.loads(file.read_text())
    assert len(outcomes) == 4 * len(SPREAD.split("|"))
    assert all(outcome["holds"] and outcome["same_bits"] for outcome in outcomes)
    assert f"{len(outcomes)} of {len(outcomes)} hold, each with the bits of one rank on {ranks}" in done.stdout


@pytest.mark.parallel
def test_a_case_that_fails_is_exit_code_3(monkeypatch, capsys):
    """`study` says so, and which."""
    from particles_mpi.study.hard_cases import Case, report

    wrong = Case("wrong", "nothing", "that 1 is 2", lambda bench: ("1", False), (None,), (2,), False)
    monkeypatch.setattr(report, "catalogue", lambda: [wrong])
    assert not report.study(None, False, None)
    assert "FAIL" in capsys.readouterr().out
    done = run_ranks(1, "-m", "particles_mpi", "study", "hard-cases", "--only", "no such case")
    assert done.returncode == 2 and "--only: no case" in done.stderr and "Traceback" not in done.stderr
