"""The rules of the house that a test can read."""

import ast
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

import particles_mpi
from particles_mpi.run.console import PHASES

PACKAGE = Path(__file__).parents[2] / "particles_mpi"
ALLOWED = {"mpi4py": ("parallel/", "cli.py"), "h5py": ("output/",), "meshio": ("output/",)}
# Folders and files at the root, from the lowest floor to the highest: a module imports only from its own floor and those below.
FLOORS = (
    "errors",
    "source_files",
    "timers",
    "kernels",
    "particles",
    "parallel",
    "scene",
    "neighbours",
    "contacts",
    "gravity",
    "effects",
    "integrators",
    "initial",
    "output",
    "results",
    "measure",
    "between_steps",
    "run",
    "simulation",
    "study",
    "setup",
    "cli",
    "__main__",
)


@cache
def nodes(path):
    """All parts of the syntax tree of a file."""
    return list(ast.walk(ast.parse(path.read_text())))


def modules():
    """{dotted name inside the package: file}; a folder stands for its `__init__`."""
    names = {path: ".".join(path.relative_to(PACKAGE).with_suffix("").parts) for path in PACKAGE.rglob("*.py")}
    return {name.removesuffix(".__init__"): path for path, name in names.items() if name != "__init__"}


def imported():
    """{module: modules of the package that it imports}, at its top or inside a function."""
    known, found = modules(), {}
    for name, path in known.items():
        found[name] = set()
        for node in nodes(path):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == PACKAGE.name:
                base = node.module.partition(".")[2]
                for alias in node.names:
                    whole = f"{base}.{alias.name}" if base else particles_mpi.PUBLIC.get(alias.name, alias.name)
                    found[name].add(whole if whole in known else base)
    return found


def libraries(path):
    for node in nodes(path):
        if isinstance(node, ast.Import):
            yield from (name.name.split(".")[0] for name in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module.split(".")[0]


@pytest.mark.parametrize("library", ALLOWED)
def test_libraries_stay_where_they_belong(library):
    users = [str(p.relative_to(PACKAGE)) for p in PACKAGE.rglob("*.py") if library in libraries(p)]
    assert users and not [u for u in users if not u.startswith(ALLOWED[library])]


def test_the_order_of_the_floors_names_every_folder_and_file():
    assert {name.split(".")[0] for name in modules()} == set(FLOORS)
    assert len(list(PACKAGE.glob("*.py"))) <= 8


def test_no_import_points_upward():
    floor = {name: FLOORS.index(name.split(".")[0]) for name in modules()}
    upward = [f"{one} -> {other}" for one, others in imported().items() for other in others if floor[other] > floor[one]]
    assert not upward


def test_no_files_import_one_another_in_a_circle():
    left = imported()
    while free := [name for name, others in left.items() if not others & left.keys() - {name}]:
        for name in free:
            del left[name]
    assert not left


def test_no_function_has_more_than_a_dozen_parameters():
    """What belongs together is handed over in one bundle with names; `self` and `cls` are not counted."""
    counted = {}
    for path in (path for folder in ("particles_mpi", "python_viz", "tests") for path in (PACKAGE.parent / folder).rglob("*.py")):
        for node in nodes(path):
            if isinstance(node, ast.FunctionDef):
                of = node.args
                names = [a.arg for a in (*of.posonlyargs, *of.args, *of.kwonlyargs, of.vararg, of.kwarg) if a]
                counted[f"{path}:{node.lineno} {node.name}"] = len(names) - (names[:1] in (["self"], ["cls"]))
    assert len(counted) > 1000
    assert not {name: count for name, count in counted.items() if count > 12}


@pytest.mark.parametrize("folder", sorted({path.parent for path in modules().values()} - {PACKAGE}), ids=lambda f: f.name)
def test_every_folder_says_what_it_is_for(folder):
    """In the docstring of its `__init__`: one plain sentence, and the names of its files, but for effects, whose names tell."""
    text = ast.get_docstring(ast.parse((folder / "__init__.py").read_text())) or ""
    assert text.partition("\n")[0].rstrip().endswith(".")
    files = {path.stem for path in folder.glob("*.py")} - {"__init__"}
    entries = set(re.findall(r"(?m)(?:^\s*(?:- )?|[;,] |`)`?(\w+)", text))  # where one begins, not any word
    assert folder.name == "effects" or files <= entries


def test_plots_know_a_run_by_its_results_only():
    """They read it as any user does, by `Run`; drawing needs neither MPI nor compiled kernels."""
    scripts = list((PACKAGE.parent / "python_viz").glob("*.py"))
    used = {name for p in scripts for name in re.findall(r"from (particles_mpi\S*) import (.+)", p.read_text())}
    assert {module for module, _ in used} == {
        "particles_mpi",
        *(f"particles_mpi.{m}" for m in ("errors", "results.curves", "results.frame", "results.scenery")),
    }
    assert not [p for p in scripts if {"h5py", "mpi4py"} & set(libraries(p))]


def test_benchmarks_need_nothing_that_only_tests_do():
    """They are run after a set-up in which pytest was not installed."""
    assert not [p for p in (PACKAGE.parent / "tests" / "benchmarks").glob("*.py") if {"pytest", "conftest"} & set(libraries(p))]


def test_the_package_and_a_run_are_read_without_what_only_a_simulation_needs():
    script = """
import sys
import particles_mpi
assert not {"h5py", "numba", "numpy", "pandas", "pydantic"} & sys.modules.keys()
from particles_mpi import Run
assert not {"numba", "pandas", "xarray", "pydantic", "matplotlib"} & sys.modules.keys()
"""
    subprocess.run([sys.executable, "-c", script], check=True, timeout=100)


def test_an_effect_that_is_not_named_is_not_imported():
    script = """
import sys
from particles_mpi import Scene, Simulation
Simulation(Scene(dimension=2, time={"step": 0.1, "steps": 2}, particles=[{"position": [[0.0, 0.0]]}],
                 effects={"uniform_gravity": {"acceleration": [0.0, -1.0]}})).run()
loaded = sorted(m.split(".")[-1] for m in sys.modules if m.startswith("particles_mpi.effects."))
assert loaded == ["uniform_gravity"], loaded
for operator in ("contacts.time_stepped.operator", "contacts.event_driven.operator", "neighbours.neighbour_list"):
    assert f"particles_mpi.{operator}" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", script], check=True, timeout=100)


def test_every_phase_has_a_line_in_the_table_of_phases():
    calls = [node for path in PACKAGE.rglob("*.py") for node in nodes(path) if isinstance(node, ast.Call)]
    timed = [call for call in calls if "timers" in (getattr(call.func, "attr", ""), getattr(call.func, "id", ""))]
    phases = {call.args[0].value for call in timed if call.args and isinstance(call.args[0], ast.Constant)}
    assert len(phases) > 10 and phases <= set(PHASES)
