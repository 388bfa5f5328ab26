"""What is installed, whether it works together, and what to do if not.

Nothing that needs MPI or HDF5 is imported here: small programs do that and answer in JSON, so that a library that is broken, or
hangs, becomes a row of the table. run.sh checks an installation with `python particles_mpi/run/doctor.py`, before any other.
"""

import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from importlib import metadata
from pathlib import Path
from typing import Any

PROBE_TIMEOUT = 60

# Runs on every rank, or in a single process; rank 0 answers.
PROBE_PROGRAM = """
import json, sys
import numpy as np
from mpi4py import MPI
comm = MPI.COMM_WORLD
found = {"size": comm.size, "library": " ".join(MPI.Get_library_version().strip("\\0").split("\\n")[0].split(",")[0].split())}
large = np.full(1 << 17, comm.rank + 1.0)
comm.Allreduce(MPI.IN_PLACE, large)
found["sum_right"] = bool((large == comm.size * (comm.size + 1) / 2).all())
try:
    import h5py
    found["hdf5"] = h5py.version.hdf5_version
    found["parallel"] = bool(h5py.get_config().mpi)
    if found["parallel"]:
        with h5py.File(sys.argv[1] + "/probe.h5", "w", driver="mpio", comm=comm) as file:
            rows = file.create_dataset("rank", (comm.size,), "i8")
            with rows.collective:
                rows[comm.rank : comm.rank + 1] = comm.rank
            file.flush()
            comm.Barrier()
            found["written"] = rows[:].tolist() == list(range(comm.size))
except Exception as error:
    found["hdf5_error"] = f"{type(error).__name__}: {error}"
if comm.rank == 0:
    print("PROBE" + json.dumps(found), flush=True)
"""


REINSTALL = "remove .venv, then ./run.sh setup"
MARKS = {"Open MPI": "Open MPI", "OpenRTE": "Open MPI", "Intel": "Intel MPI", "MPICH": "MPICH", "HYDRA": "MPICH"}

Answer = tuple[str, str]  # what was found, and what to do about it: empty if all is right


def launcher() -> str | None:
    """The path of mpirun: the one next to this Python comes before any other on the PATH."""
    path = os.pathsep.join([str(Path(sys.prefix) / "bin"), os.environ.get("PATH", "")])
    return shutil.which("mpirun", path=path) or shutil.which("mpiexec", path=path)


def probe(ranks: int) -> dict[str, Any]:
    """Start `ranks` processes (1: without a launcher) that try MPI and HDF5; their answer, or {"error": ...}."""
    start = [str(launcher()), "-n", str(ranks)] if ranks > 1 else []
    # Under mpirun these variables would connect the new processes with this one; settings (OMPI_MCA_...) are kept.
    ties = ("OMPI_COMM_", "OMPI_UNIVERSE", "OMPI_MCA_ess", "OMPI_MCA_orte", "OMPI_MCA_pmix", "PMIX_", "PMI_", "HYDI_", "HYDRA_")
    environment = {name: value for name, value in os.environ.items() if not name.startswith(ties)}
    with tempfile.TemporaryDirectory(prefix="particles_mpi_doctor_") as folder:
        command = [*start, sys.executable, "-c", PROBE_PROGRAM, folder]
        try:
            answer = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=PROBE_TIMEOUT)
        except subprocess.TimeoutExpired:
            return {"error": f"no answer within {PROBE_TIMEOUT} s"}
        except OSError as error:
            return {"error": str(error)}
    for line in answer.stdout.splitlines():
        if line.startswith("PROBE"):
            return {**json.loads(line.removeprefix("PROBE")), "stderr": answer.stderr}
    said = [line for line in answer.stderr.splitlines() if line.strip(" -")] or [f"exit code {answer.returncode}"]
    raised = [line for line in said if line.split(":")[0].endswith(("Error", "Exception"))]
    return {"error": (raised or said)[0], "stderr": answer.stderr}


def report(world: int) -> list[tuple[str, Answer]]:
    """All rows of the table; `world`: the number of ranks with which this process runs."""
    alone = probe(1)
    here = alone.get("library", alone.get("error", "")), f"mpi4py cannot start MPI: {REINSTALL}" if "error" in alone else ""
    return [
        ("Python", (f"{platform.python_version()} ({sys.executable})", "")),
        *((name, _package(name)) for name in ("numpy", "numba", "scipy", "pydantic", "mpi4py")),
        ("MPI library", here),
        ("launcher", _launcher(alone)),
        _ranks(world),
        ("h5py", _package("h5py")),
        ("HDF5", _hdf5(alone)),
        ("meshio", _package("meshio")),
        ("matplotlib", _package("matplotlib")),
        ("vtk", _package("vtk", "only the tests read with it")),
        ("cores", (f"{usable_cores()} for this process, {os.cpu_count()} in the machine", "")),
        ("kernel cache", _kernels(Path(os.environ.get("NUMBA_CACHE_DIR") or Path(__file__).parents[1]))),
    ]


def _package(name: str, optional_for: str = "") -> Answer:
    try:
        return metadata.version(name), ""
    except metadata.PackageNotFoundError:
        return (f"not installed ({optional_for})", "") if optional_for else ("not installed", "./run.sh setup")


def _family(text: str) -> str:
    """The MPI implementation that a version text names; hydra is the launcher of MPICH."""
    return next((family for mark, family in MARKS.items() if mark in text), "unknown")


def _launcher(alone: dict[str, Any]) -> Answer:
    path = launcher()
    if path is None:
        return "no mpirun or mpiexec found", "install an MPI, or: PARTICLES_MPI_SETUP=pip ./run.sh setup"
    try:
        said = subprocess.run([path, "--version"], capture_output=True, text=True, timeout=PROBE_TIMEOUT)
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"{path}: {error}", "this launcher does not start"
    ours, theirs = _family(said.stdout + said.stderr), _family(alone.get("library", ""))
    if "unknown" in (ours, theirs) or ours == theirs:
        return f"{path} ({ours})", ""
    return f"{path} belongs to {ours}, mpi4py to {theirs}", f"start with the mpirun of {theirs}"


def _ranks(world: int) -> tuple[str, Answer]:
    """Do ranks see each other: those of this run if there are several, otherwise two that are started for it."""
    started = max(world, *(int(os.environ.get(name, 1)) for name in ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE")))
    if started > world:
        return "ranks", (f"{started} started, but each is alone", "this mpirun belongs to another MPI than mpi4py: see launcher")
    if world > 1:
        return "ranks", (f"{world} started, {world} see each other (this very run)", "")
    return "2-rank check", _pair(probe(2)) if launcher() else ("not tried: no launcher", "see launcher")


def _pair(pair: dict[str, Any]) -> Answer:
    if "error" in pair:
        return pair["error"], "a 2-rank program does not run: try the launcher by hand"
    if pair["size"] != 2:
        return f"2 started, but MPI counts {pair['size']}", "launcher and mpi4py belong to different MPIs"
    if not pair["sum_right"]:
        return "a wrong sum over the ranks", "this MPI is broken: PARTICLES_MPI_SETUP=pip ./run.sh setup"
    if "hdf5_error" in pair or pair.get("written") is False:
        return f"HDF5: {pair.get('hdf5_error', 'wrong rows')}", REINSTALL
    return "2 ranks see each other, sums correct" + ", collective HDF5 write correct" * ("written" in pair), ""


def _hdf5(alone: dict[str, Any]) -> Answer:
    if "hdf5_error" in alone:
        return alone["hdf5_error"], REINSTALL
    if "hdf5" not in alone:
        return "not known: MPI does not start", "see MPI library"
    serial = "serial: one rank gathers and writes, the files are the same"
    return f"{alone['hdf5']}, {'parallel: every rank writes its own rows' if alone['parallel'] else serial}", ""


def _kernels(folder: Path) -> Answer:
    try:
        import particles_mpi.kernels  # noqa: F401  (looks for a folder)
    except ImportError:
        return "not known: the program cannot be imported", REINSTALL
    except ValueError as error:
        return str(error).partition(": ")[0], "set NUMBA_CACHE_DIR to a folder that can be written"
    if not os.access(folder, os.W_OK):
        return f"{folder} cannot be written: numba keeps kernels in the home folder, the first run compiles them", ""
    if compiled := sum(1 for _ in folder.rglob("*.nbi")):
        return f"{compiled} compiled, in {folder}", ""
    return "empty: the first run compiles them (./run.sh setup does it now)", ""


def usable_cores() -> int | None:
    """The number of cores on which this process may run."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()


def main(is_root: bool, size: int) -> int:
    """Print the table on rank 0. Exit code 0: all is right; 1: something has to be done, which the table says."""
    if not is_root:
        return 0
    from rich.table import Table

    from particles_mpi.run.console import Screen

    rows = report(size)
    table = Table("", "", "found", "what to do", title="particles_mpi doctor", title_justify="left", box=None, padding=(0, 1))
    for what, (found, advice) in rows:
        table.add_row("[red]NO[/]" if advice else "[green]ok[/]", what, found, advice)
    screen = Screen(is_root, quiet=False)
    screen.table(table)
    return int(screen.console.unwritten or any(advice for _, (_, advice) in rows))


if __name__ == "__main__":  # for run.sh: what two ranks see, as JSON
    print(json.dumps(probe(2)))
