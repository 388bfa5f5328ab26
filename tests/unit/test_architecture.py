"""The rules of the house that a test can read."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "particles_mpi"
ALLOWED = {"mpi4py": ("parallel/", "cli.py"), "h5py": ("output/",), "meshio": ("output/",)}


def imports(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (name.name.split(".")[0] for name in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module.split(".")[0]


@pytest.mark.parametrize("library", ALLOWED)
def test_libraries_stay_where_they_belong(library):
    users = [str(p.relative_to(PACKAGE)) for p in PACKAGE.rglob("*.py") if library in imports(p)]
    assert users and not [u for u in users if not u.startswith(ALLOWED[library])]


def test_plots_read_files_only():
    scripts = list((PACKAGE.parent / "python_viz").glob("*.py"))
    assert scripts and not [p for p in scripts if "particles_mpi" in imports(p)]


def test_an_effect_that_is_not_named_is_not_imported():
    script = """
import sys
from particles_mpi import Scene, Simulation
Simulation(Scene(dimension=2, time={"step": 0.1, "steps": 2}, particles=[{"position": [[0.0, 0.0]]}],
                 effects={"uniform_gravity": {"acceleration": [0.0, -1.0]}})).run()
loaded = sorted(m.split(".")[-1] for m in sys.modules if m.startswith("particles_mpi.effects."))
assert loaded == ["uniform_gravity"], loaded
assert "particles_mpi.collide.rewind" not in sys.modules and "particles_mpi.neighbours.pairs" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", script], check=True, timeout=100)
