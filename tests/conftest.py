"""Shared by all tests: starting a script on several ranks."""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import pytest

from particles_mpi.setup.kernel_sources import PACKAGE, Sources

ROOT = Path(__file__).parents[1]
MPI_ENVIRONMENT = {  # Open MPI 4 and 5: as root, and on more ranks than cores
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
}

IMPATIENT = {"OMPI_MCA_odls_base_sigkill_timeout": "0"}  # after a rank failed, kill the others without waiting for them


def run_ranks(n: int, *arguments: object, timeout: float = 120) -> subprocess.CompletedProcess[str]:
    """Run `python arguments...` on n ranks; a hang is a failure (TimeoutExpired), output is text."""
    environment = MPI_ENVIRONMENT | os.environ | {"PYTHONPATH": str(ROOT), **IMPATIENT}
    command = ["mpirun", "-n", str(n), sys.executable, *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=timeout)


def compiled():
    """What numba keeps of the package: "file function (argument types)" of all that was ever compiled, as text."""
    found = set()
    for index in PACKAGE.rglob("*.nbi"):
        with index.open("rb") as file:
            pickle.load(file)  # numba's version
            _, overloads = pickle.loads(file.read())
        found |= {f"{index.name} {signature}" for signature, *_ in overloads if not many_axes(signature)}
    return found


def many_axes(signature):
    """Is the first argument more than three axes, or their number? Those are compiled when they are needed."""
    if not signature:
        return False
    number = getattr(signature[0], "count", None) or getattr(signature[0], "literal_value", None)
    return isinstance(number, int) and number > 3


@pytest.fixture(scope="session", autouse=True)
def nothing_is_compiled():
    """After set-up no test compiles a kernel of the package: what is missing belongs into particles_mpi/setup/warmup.py."""
    if not Sources(PACKAGE).up_to_date() or "NUMBA_CACHE_DIR" in os.environ:
        yield  # somebody works on the kernels
        return
    before = compiled()
    yield
    assert sorted(compiled() - before) == [], "compiled in this session: a scene is missing in particles_mpi/setup/warmup.py"
