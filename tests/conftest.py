"""Shared by all tests: which of them run, on which process, and that none of them compiles anything."""

import gc
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parent))  # for the modules that tests share
from ranks import ROOT, end_standing_ranks, environment, run_ranks, take_turns_often

from particles_mpi.setup.kernel_sources import PACKAGE, Sources

__all__ = ["ROOT", "environment", "run_ranks"]


def pytest_addoption(parser):
    parser.addoption("--all", action="store_true", help="run the slow tests too: many ranks, long physics, kills")
    parser.addoption("--search", action="store_true", help="look for faults in many more scenes at random, some new each time")


def pytest_configure(config):
    """Property tests have no limit of time for an example; only with --search they look for examples that are new each time."""
    settings.register_profile("here", deadline=None, derandomize=not config.getoption("--search"))
    settings.load_profile("here")


def pytest_collection_modifyitems(config, items):
    """Leave out what takes long, unless --all or --search asks for it."""
    asked = {"slow": config.getoption("--all"), "search": config.getoption("--search")}

    def left_out(item):
        return any(item.get_closest_marker(name) for name, wanted in asked.items() if not wanted)

    if deselected := [item for item in items if left_out(item)]:
        config.hook.pytest_deselected(items=deselected)
        items[:] = [item for item in items if not left_out(item)]


def pytest_collection_finish():
    """All that is there by now stays: Python need not look again and again whether some of it is garbage."""
    gc.collect()
    gc.freeze()


# Files whose tests share what one process has made; all other tests go to whichever process is free.
SHARING = {
    "test_architecture.py",
    "test_browser.py",
    "test_accuracy_study.py",
    "test_kernel_sources.py",
    "test_study_gravity.py",
    "test_study_scaling.py",
    "test_time_stepped.py",
    "test_tree.py",
}
CORES = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
RANKS = "tests/parallel"
ENDED = {"test_nothing_lost.py", "test_one_rank_fails.py"}  # runs that are killed, or fail: they wait more than they compute
ENDING = f"{RANKS}: runs that end early"


def group_of(nodeid):
    """One process gets all tests of a group: those of ENDED, the rest of tests/parallel, each of SHARING; others one by one.

    Pairs of ranks at once would wait for one another. Tests of ENDED leave a core free most of the time. Those of `study scaling`
    look at how many cores there are, which `pytest_runtest_setup` changes for tests of ranks: so their ranks run beside them, and
    less urgently.
    What compiles all kernels for an older processor takes one core for a minute or more, beside all else; those of four
    dimensions are compiled when they are needed, by one process instead of both at once.
    """
    path = nodeid.partition("::")[0]
    if nodeid.endswith(("[4]", "-4]")) and not path.startswith(RANKS):
        return "4D"
    name = Path(path).name
    if path.startswith(f"{RANKS}/") and name not in SHARING and "older_processor" not in nodeid:
        return ENDING if name in ENDED else RANKS
    return path if name in SHARING else nodeid


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Which tests xdist gives to one process."""
    from xdist.scheduler import LoadScopeScheduling

    class Scheduling(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            return group_of(nodeid)

    return Scheduling(config, log)


def on_a_worker(config):
    """Is this one of the processes among which xdist divides the tests?"""
    return hasattr(config, "workerinput")


def pytest_runtest_setup(item):
    """Ranks take turns often; and no other process is as urgent as those that exchange messages all the time.

    Beside one that wants a core for itself, and is as urgent, two ranks take four times as long; beside one as nice as can be 6 %
    more. Ranks that wait for others keep their cores busy. Where there are two cores, those of RANKS are on the first one, and
    take 5 % longer: other tests have the second one meanwhile.
    """
    group = group_of(item.nodeid)
    ranks = group in (RANKS, ENDING)
    if ranks:
        take_turns_often()
    if on_a_worker(item.config):  # 19: as nice as can be
        os.nice(max((0 if ranks else 19) - os.getpriority(os.PRIO_PROCESS, 0), 0))
        cores = CORES[:1] if group == RANKS else CORES
        if len(CORES) == 2 and set(cores) != os.sched_getaffinity(0):
            end_standing_ranks()  # they would keep the cores of when they were started
            os.sched_setaffinity(0, cores)


@pytest.fixture(scope="session", autouse=True)
def ranks_that_stay():
    """Those of `run_ranks` end with the session."""
    yield
    end_standing_ranks()


def compiled():
    """The files of compiled kernels that numba keeps of the package."""
    return set(PACKAGE.rglob("*.nbc"))


COMPILED = pytest.StashKey[set]()  # before the session, by set-up
MISSING = pytest.StashKey[list]()  # compiled in the session


def pytest_sessionstart(session):
    """Remember what is compiled; nothing is checked while somebody works on the kernels."""
    if not on_a_worker(session.config) and Sources(PACKAGE).up_to_date() and "NUMBA_CACHE_DIR" not in os.environ:
        session.config.stash[COMPILED] = compiled()


def pytest_sessionfinish(session):
    """After set-up no test compiles a kernel of the package; one that does makes the session fail."""
    before = session.config.stash.get(COMPILED, None)
    new = sorted(compiled() - before) if before is not None else []
    if new:
        command = [sys.executable, Path(__file__).parent / "kernel_names.py", *new]
        missing = subprocess.run(command, env=environment(), capture_output=True, text=True, check=True).stdout.splitlines()
    if new and missing:
        session.config.stash[MISSING] = missing
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter, config):
    if missing := config.stash.get(MISSING, []):
        terminalreporter.section("compiled in this session: a scene is missing in particles_mpi/setup/warmup.py", red=True)
        for kernel in missing:
            terminalreporter.line(kernel)
