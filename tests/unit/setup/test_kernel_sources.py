"""What set-up compiles again after an edit: the kernels whose code has changed, or that of what they call, and no others."""

import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba import typeof
from numba.core.serialize import dumps

from particles_mpi import Scene, Simulation
from particles_mpi.contacts.law import Loss
from particles_mpi.kernels.geometry import Box
from particles_mpi.setup.kernel_sources import PACKAGE, STATE_FILE, Sources

CELL_ALONG = "particles_mpi.neighbours.cells.cell_along"
COPIED = ("contacts", "gravity", "kernels", "neighbours", "setup", "study")
OTHER_CELL = ("neighbours/cells.py", "(y - origin) * per, 0.0), cells - 1.0)", "(y - origin) * per, 1.0), cells - 1.0)")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A copy of those sources of the package that are edited here, or take what is; all of their kernels count as compiled."""
    package = tmp_path_factory.mktemp("edited") / PACKAGE.name
    for folder in COPIED:
        shutil.copytree(PACKAGE / folder, package / folder, ignore=shutil.ignore_patterns("__pycache__", "hard_cases"))
    Sources(package).note()
    return package


@pytest.fixture
def edit(whole):
    """edit((file, old, new), ...) changes lines of the copy; returns the stale kernels. Taken back afterwards."""
    before = {}

    def change(*lines):
        for file, old, new in lines:
            path = whole / file
            text = path.read_text()
            before.setdefault(path, text)
            assert text.count(old) == 1
            path.write_text(text.replace(old, new))
        return Sources(whole).stale()

    yield change
    for path, text in before.items():
        path.write_text(text)


def test_all_kernels_are_known():
    """Those of every decorator: with options, without, and those that are inlined."""
    kernels = Sources(PACKAGE).kernels
    names = (
        "neighbours.near_paths.paths_may_meet",
        "contacts.event_driven.event_loop.run",
        "gravity.sources.add_cells",
        "study.hard_cases.orbits.circle",
    )
    assert {f"particles_mpi.{name}" for name in names} <= kernels.keys()
    assert not [name for name in kernels if name.endswith(("Simulation", "main"))]


def test_words_compile_nothing(edit):
    """Comments, docstrings, and a constant that no kernel takes; all at once, since every edit costs a look at all sources."""
    stale = edit(
        ("study/timing.py", "from __future__", "# a comment\nfrom __future__"),
        ("study/experiment.py", "ORDER_FLOOR = 1e-13", "ORDER_FLOOR = 1e-12"),
        ("neighbours/cells.py", "The cell of coordinate y on one axis;", "Of coordinate y on one axis, the cell;"),
        ("neighbours/cells.py", "    return int(min(max((y", "    # an interval of cells\n    return int(min(max((y"),
    )
    assert stale == []


def test_a_changed_kernel_takes_its_callers_along(edit):
    stale = edit(OTHER_CELL)
    callers = {"neighbours.cells.cell_at", "neighbours.cells.sort_rows", "neighbours.pair_search.find_partners"}
    assert {CELL_ALONG} | {f"particles_mpi.{name}" for name in callers} <= set(stale)
    assert not [name for name in stale if ".gravity." in name or ".contacts." in name]


def test_a_changed_constant_makes_stale_what_takes_it(edit):
    stale = edit(("gravity/octree.py", "LEAF = 16", "LEAF = 15"))
    assert stale == ["particles_mpi.gravity.octree.divide"]


def forget_stale(package):
    """Delete what was compiled of stale kernels beside their sources; False where it is not known yet which these are."""
    return Sources(package).forget_stale(package, "**/__pycache__")


def test_what_is_stale_is_told_and_forgotten(whole, edit):
    """The script that run.sh asks ends with 0, or 1 where kernels are stale; of these the files are deleted, and no others."""
    script = [sys.executable, "-P", str(whole / "setup/kernel_sources.py")]
    cache = whole / "neighbours" / "__pycache__"
    cache.mkdir(exist_ok=True)
    names = ("partner_lists.cover", "pair_search.find_partners", "partner_lists.list_bits")
    files = [cache / f"{name}-100.py311.1.nbc" for name in names]
    for file in files:
        file.touch()
    assert subprocess.run(script, timeout=300).returncode == 0
    assert forget_stale(whole) and all(file.exists() for file in files)
    edit(OTHER_CELL)
    assert subprocess.run(script, timeout=300).returncode == 1
    assert forget_stale(whole) and [file.exists() for file in files] == [False, False, True]
    (whole / STATE_FILE).write_text("half a file")
    assert subprocess.run(script, timeout=300).returncode == 1


HALF = [("study/plots.py", True), ("kernels/geometry.py", False), ("kernels/jit.py", False)]


@pytest.mark.parametrize(("file", "forgets"), HALF)
def test_half_an_edit_deletes_nothing_that_it_may_concern(whole, file, forgets):
    """When the edit is whole, or taken back, the kernels are needed again; a file that no kernel uses is of no account."""
    text = (whole / file).read_text()
    (whole / file).write_text(text + "\ndef half(\n")
    try:
        assert forget_stale(whole) == forgets
    finally:
        (whole / file).write_text(text)


def test_kernels_with_arguments_of_a_class_that_is_gone_are_forgotten(whole, edit):
    """Numba fails when it reads what it kept of them, even where the kernel itself has not changed."""
    Sources(whole).note()
    cache = whole / "kernels" / "__pycache__"
    cache.mkdir(exist_ok=True)
    for name, bundle in (("kick", Loss(1.0, 1.0)), ("wrap", Box(np.zeros(2), np.ones(2), np.ones(2)))):
        kept = (0.0, 1), {((typeof(bundle),), "cpu"): "1.nbc"}
        (cache / f"motion.{name}-1.py311.nbi").write_bytes(pickle.dumps("0.68") + dumps(kept))
        (cache / f"motion.{name}-1.py311.1.nbc").touch()
    forget_stale(whole)
    assert len(list(cache.iterdir())) == 4
    edit(("contacts/law.py", "class Loss(", "class Taken("))
    forget_stale(whole)
    assert sorted(path.name for path in cache.iterdir()) == ["motion.wrap-1.py311.1.nbc", "motion.wrap-1.py311.nbi"]


def test_no_folder_for_kernels_is_one_line(tmp_path):
    Simulation(Scene(dimension=1, time={"step": 0.1, "steps": 1}, particles=[{"position": [[0.0]]}])).run(tmp_path)
    nowhere = {"NUMBA_CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator", "NUMBA_CACHE_DIR": "/proc/none"}
    scene = PACKAGE / "scenes" / "bounce.toml"

    def told(*command, program=("-m", "particles_mpi")):
        call = [sys.executable, *program, *command]
        done = subprocess.run(call, cwd=PACKAGE.parent, env=os.environ | nowhere, capture_output=True, text=True, timeout=300)
        return done.returncode, done.stderr, done.stdout

    code, error, _ = told("check", scene)
    assert code == 2 and error.count("\n") == 1 and "set NUMBA_CACHE_DIR" in error, error
    code, error, picture = told(tmp_path, program=["python_viz/plot_frame.py"])  # which has two small ones of its own
    assert (code, error) == (0, "") and Path(picture.strip()).exists()
    code, error, table = told("doctor")
    assert (code, error) == (1, "") and "NUMBA_CACHE_DIR" in table
