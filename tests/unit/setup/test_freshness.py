"""Whoever starts the program after an update runs the new code, whichever way it is started."""

import os
import shutil
import subprocess
import sys

import pytest
from with_all import with_all

from particles_mpi.source_files import PACKAGE

# Prints what a kernel gives that uses a function of another file, and how often it was compiled.
CHECK = """
import numpy as np
from particles_mpi.gravity.direct import Attraction, attract
sums = Attraction(np.zeros((1, 3)), 1, 0.0)
sums.add(np.ones((1, 3)), np.ones(1))
print(sums.accelerations()[0, 0], sum(attract.stats.cache_misses.values()))
"""
EARLIER = "import particles_mpi.gravity.direct\nprint('it has read its sources', flush=True)\ninput()\n" + CHECK
WORDS = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
PULL, LINE = 3.0**-1.5, "near, first = mass * y * y2, "


class Copy:
    """A copy of the package in a folder, with kernels of its own."""

    def __init__(self, folder, **environment):
        self.package = folder / PACKAGE.name
        shutil.copytree(PACKAGE, self.package, ignore=shutil.ignore_patterns("__pycache__"))
        told = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
        self.environment = told | {"PYTHONPATH": str(folder)} | environment

    def start(self, script=CHECK):
        """A process that computes a pull."""
        return subprocess.Popen([sys.executable, "-P", "-c", script], env=self.environment, **WORDS)

    def told_by(self, process):
        """(the pull, how often its kernel was compiled) as a process says in the end."""
        pull, compiled = process.communicate("go on\n", timeout=300)[0].split()
        assert process.returncode == 0
        return float(pull), int(compiled)

    def run(self):
        return self.told_by(self.start())

    def double_the_pull(self):
        """In a file that is not that of the kernel: numba alone would load the old one."""
        powers = self.package / "gravity" / "powers.py"
        before = powers.read_text()
        assert before.count(LINE) == 1
        powers.write_text(before.replace(LINE, LINE.replace("mass", "(mass + mass)")))


@pytest.mark.parametrize("own_folder", [False, *with_all(True)])
def test_a_kernel_is_compiled_again_when_what_it_uses_has_changed(tmp_path, own_folder):
    """Beside the sources or in a folder of the user's own; also while half of another file has been written."""
    copy = Copy(tmp_path, **({"NUMBA_CACHE_DIR": str(tmp_path / "kernels")} if own_folder else {}))
    assert copy.run() == (pytest.approx(PULL), 1)
    copy.double_the_pull()
    (copy.package / "study" / "plots.py").write_text("def half(")
    assert copy.run() == (pytest.approx(2.0 * PULL, rel=1e-5), 1)
    assert copy.run() == (pytest.approx(2.0 * PULL, rel=1e-5), 0)


def test_what_an_older_process_compiles_is_not_kept(tmp_path):
    """It has read its sources before they were edited; others have begun since then, and have noted what there is now."""
    copy = Copy(tmp_path)
    older = copy.start(EARLIER)
    assert older.stdout.readline() == "it has read its sources\n"
    copy.double_the_pull()
    subprocess.run([sys.executable, "-P", "-c", "import particles_mpi"], env=copy.environment, check=True)
    assert copy.told_by(older) == (pytest.approx(PULL), 1)
    assert copy.run() == (pytest.approx(2.0 * PULL, rel=1e-5), 1)
