"""Kernels that come from the cache: what is read of them and imported for them, and that others can still call them."""

import subprocess
import sys

import pytest
from conftest import ROOT
from numba import version_info
from numba.core.caching import IndexDataCacheFile

from particles_mpi.kernels.loading import KNOWN

SCRIPT = """
import sys
import numpy as np
from numba import njit
from particles_mpi.neighbours.cells import bounds

x = np.random.default_rng(1).random((50, 3))
low, high = bounds(x)
assert (low == x.min(axis=0)).all() and (high == x.max(axis=0)).all()
(result,) = bounds.overloads.values()
library = result.library
assert library.unread is not None and library._shared_module is None, "its bitcode was read"
assert library.get_pointer_to_function(result.fndesc.llvm_func_name) != 0
assert library.get_pointer_to_function("nothing of this name") == 0
assert not {"numba.np.arraymath", "numba.typed.typedlist", "scipy.linalg"} & sys.modules.keys(), "what only a compiler needs"

@njit
def widths(x):
    low, high = bounds(x)
    return high - low

assert (widths(x) == np.ptp(x, axis=0)).all()
assert library.unread is None and library._shared_module is not None, "it was not linked"
"""


@pytest.mark.skipif(version_info[:2] not in KNOWN, reason="another version of numba loads kernels its own way")
def test_what_a_compiler_needs_is_read_when_another_kernel_is_compiled():
    done = subprocess.run([sys.executable, "-c", SCRIPT], cwd=ROOT, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr


SCENES = """
import sys
from particles_mpi import Scene, Simulation

for name in sys.argv[1:]:
    sim = Simulation(Scene.load(f"particles_mpi/scenes/{name}.toml"))
    imported = set(sys.modules)
    sim.steps(2)
    sim.measure()
    print(name, sorted(module for module in sys.modules.keys() - imported if module.startswith(("numba.", "scipy."))))
"""


@pytest.mark.skipif(version_info[:2] not in KNOWN, reason="another version of numba loads kernels its own way")
def test_steps_import_nothing_that_only_a_compiler_needs():
    """Whatever numba has of its own in a kernel: bodies in one loop, a tree, lasting contacts, both operators."""
    scenes = ["solar_system", "plummer", "hourglass", "rubble_pile", "marbles", "headline"]
    done = subprocess.run([sys.executable, "-c", SCENES, *scenes], cwd=ROOT, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "".join(f"{name} []\n" for name in scenes)


KEEPING = """
import sys
from numba.core.caching import IndexDataCacheFile
import particles_mpi.kernels.jit

files = IndexDataCacheFile(sys.argv[1], "kernel", "stamp")
print("begins", flush=True)
sys.stdin.readline()
for number in range(100):
    files.save((sys.argv[2], number), (sys.argv[2], number))
"""


@pytest.mark.skipif(version_info[:2] not in KNOWN, reason="another version of numba keeps kernels its own way")
def test_what_two_processes_keep_at_the_same_time_is_all_there(tmp_path):
    """Different kernels of the same function: none is forgotten, or read for another one."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "cwd": ROOT}
    processes = [subprocess.Popen([sys.executable, "-c", KEEPING, tmp_path, name], **pipes) for name in "ab"]
    assert [process.stdout.readline() for process in processes] == ["begins\n"] * 2
    for process in processes:
        process.stdin.write("go\n")
        process.stdin.flush()
    for process in processes:
        process.communicate(timeout=60)
        assert process.returncode == 0
    files = IndexDataCacheFile(str(tmp_path), "kernel", "stamp")
    for key in ((name, number) for name in "ab" for number in range(100)):
        assert files.load(key) == key


@pytest.mark.skipif(version_info[:2] not in KNOWN, reason="another version of numba keeps kernels its own way")
def test_a_process_that_is_killed_while_it_keeps_a_kernel_leaves_none_under_a_wrong_name(tmp_path, monkeypatch):
    """After a change of the file there is code that no index names any more, in files whose names are used again."""
    before, now = (IndexDataCacheFile(str(tmp_path), "kernel", stamp) for stamp in ("before", "now"))
    for key in ("first", "second"):
        before.save(key, f"{key} of before")

    def killed(*_):
        raise KeyboardInterrupt

    for what in ("_save_data", "_save_index"):
        with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
            patch.setattr(now, what, killed)
            now.save("second", "second of now")
        assert now.load("second") is None and now.load("first") is None
    now.save("second", "second of now")
    assert now.load("second") == "second of now" and now.load("first") is None
