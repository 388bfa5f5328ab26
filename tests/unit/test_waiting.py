"""Ranks share the machine with other programs."""

import os
import subprocess
import sys

import pytest
from conftest import ROOT

NAME = "OMPI_MCA_mpi_yield_when_idle"
SCRIPT = f"""
import os, particles_mpi.parallel.communicator
print(os.environ["{NAME}"])
"""


@pytest.mark.parametrize(("given", "taken"), [({}, "1"), ({NAME: "0"}, "0")])
def test_a_rank_that_waits_gives_its_core_away_unless_the_user_says_otherwise(given, taken):
    """Else two ranks take ten times as long beside one busy program."""
    environment = {name: value for name, value in os.environ.items() if name != NAME} | {"PYTHONPATH": str(ROOT)} | given
    done = subprocess.run([sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == taken
