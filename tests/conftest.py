"""Shared by all tests: starting a script on several ranks."""

import os
import subprocess
import sys
from pathlib import Path

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
