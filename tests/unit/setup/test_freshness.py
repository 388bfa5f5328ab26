"""Whoever starts the program after an update runs the new code, whichever way it is started."""

import os
import shutil
import subprocess
import sys

import pytest
from with_all import with_all

from particles_mpi.setup.freshness import PACKAGE

# Prints what a kernel gives that uses a function of another file, and how often it was compiled.
CHECK = """
import numpy as np
from particles_mpi.gravity.direct import Attraction, attract
sums = Attraction(np.zeros((1, 3)), 1, 0.0)
sums.add(np.ones((1, 3)), np.ones(1))
print(sums.accelerations()[0, 0], sum(attract.stats.cache_misses.values()))
"""
PULL = "near, first = mass * y * y2, "


@pytest.mark.parametrize("own_folder", [False, *with_all(True)])
def test_a_kernel_is_compiled_again_when_what_it_uses_has_changed(tmp_path, own_folder):
    """Beside the sources or in a folder of the user's own. Its own file is the same: numba alone would load the old kernel."""
    package = tmp_path / PACKAGE.name
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
    told = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"} | {"PYTHONPATH": str(tmp_path)}
    if own_folder:
        told["NUMBA_CACHE_DIR"] = str(tmp_path / "kernels")

    def run():
        done = subprocess.run([sys.executable, "-P", "-c", CHECK], env=told, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr
        pull, compiled = done.stdout.split()
        return float(pull), int(compiled)

    pull = 3.0**-1.5
    assert run() == (pytest.approx(pull), 1)
    powers = package / "gravity" / "powers.py"
    before = powers.read_text()
    assert before.count(PULL) == 1
    powers.write_text(before.replace(PULL, PULL.replace("mass", "(mass + mass)")))
    assert run() == (pytest.approx(2.0 * pull, rel=1e-5), 1)
    assert run() == (pytest.approx(2.0 * pull, rel=1e-5), 0)
