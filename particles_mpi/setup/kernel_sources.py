"""Finds the compiled kernels that are out of date.

`python -P particles_mpi/setup/kernel_sources.py` ends with exit code 1 if there are any; `freshness` deletes them.

Numba compiles a kernel again when the file that defines it has changed, but not when another file has changed whose functions or
constants it uses. Therefore a digest of each kernel is kept: of all definitions in the package that it uses, directly or through
others, as syntax trees without docstrings. This module imports nothing of the package, so that it runs quickly.

Numba's file of a kernel names the classes of its arguments, also those that the kernel itself does not import, because a caller
in another file has passed them. Numba fails if such a class no longer exists, so kernels that name one are deleted too.
"""

import ast
import gc
import json
import pickle
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).parents[1]
STATE_FILE = "__pycache__/kernels.json"  # the digests at the time when all kernels were compiled
COMPILER = ("numba", "njit")

Place = tuple[str, str]  # a module and a name in it


@contextmanager
def keeping_garbage() -> Iterator[None]:
    """Switch the garbage collector off in a block that makes syntax trees.

    They are many objects without cycles, and looking at them again and again took two thirds of the time.
    """
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.freeze()
            gc.enable()


class Sources:
    """The definitions of a package: `defined[module, name]` are the statements at the top of a module that define a name."""

    @keeping_garbage()
    def __init__(self, package: Path, before: dict[str, str] | None = None):
        """`before`: the digests of kernels at an earlier look, if not those when all were compiled."""
        self.package = package
        self.before = self.compiled().get("kernels", {}) if before is None else before
        self.files: dict[str, Path] = {}
        self.defined: dict[Place, list[ast.stmt]] = defaultdict(list)
        self.links: dict[Place, Place] = {}  # where an imported name is defined
        self.calls: dict[Place, set[Place]] = {}
        self.unread: set[str] = set()  # modules that are half an edit, or gone just now
        for path in sorted(package.rglob("[!.]*.py")):
            module = ".".join((package.name, *path.relative_to(package).with_suffix("").parts)).removesuffix(".__init__")
            self.files[module] = path
            try:
                statements = ast.parse(path.read_text(encoding="utf-8")).body
            except (SyntaxError, FileNotFoundError):
                self.unread.add(module)
                continue
            for statement in statements:
                self.enter(module, statement)

    def enter(self, module: str, statement: ast.stmt) -> None:
        """Enter the names that a statement at the top of a module defines or imports."""
        if isinstance(statement, ast.ImportFrom):
            for name in statement.names:
                self.links[module, name.asname or name.name] = statement.module or "", name.name
        elif isinstance(statement, (ast.FunctionDef, ast.ClassDef)):
            self.defined[module, statement.name].append(statement)
        elif isinstance(statement, (ast.Assign, ast.AnnAssign, ast.AugAssign)):
            targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
            for node in (node for target in targets for node in ast.walk(target)):
                if isinstance(node, ast.Name):
                    self.defined[module, node.id].append(statement)

    def mentioned(self, module: str, trees: Iterable[ast.AST]) -> set[Place]:
        """The names of the package that syntax trees in `module` use, and COMPILER."""
        found = {(module, node.id) for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Name)}
        while linked := found & self.links.keys():
            found = found - linked | {self.links[place] for place in linked}
        return found & (self.defined.keys() | {COMPILER})

    def reached(self, places: set[Place]) -> set[Place]:
        """These places and all that their definitions use, directly or through others."""
        found, waiting = set(places), list(places)
        while waiting:
            place = waiting.pop()
            if place not in self.calls:
                self.calls[place] = self.mentioned(place[0], self.defined.get(place, ()))
            waiting += self.calls[place] - found
            found |= self.calls[place]
        return found

    @cached_property
    @keeping_garbage()
    def kernels(self) -> dict[str, str]:
        """{"module.name": digest} of each compiled function."""
        digests, texts = {}, {}
        for place, trees in self.defined.items():
            decorators = [d for tree in trees if isinstance(tree, ast.FunctionDef) for d in tree.decorator_list]
            if COMPILER in self.reached(self.mentioned(place[0], decorators)):
                parts = sorted(self.reached({place}) - {COMPILER})
                for part in parts:
                    if part not in texts:
                        texts[part] = "".join(ast.dump(without_docstrings(tree)) for tree in self.defined[part])
                digests[".".join(place)] = digest("".join(f"{'.'.join(part)} {texts[part]}\n" for part in parts))
        return digests

    def state(self) -> dict[str, dict[str, str]]:
        """Digests of all kernels, and of the files that define them: numba itself compiles those of a changed file again."""
        kernels = self.kernels
        modules = sorted({name.rpartition(".")[0] for name in kernels})
        return {"kernels": kernels, "files": {m: digest(self.files[m].read_text(encoding="utf-8")) for m in modules}}

    def stale(self) -> list[str]:
        """The kernels whose digest is not what it was before."""
        before, now = self.before, self.kernels
        return sorted(name for name in before.keys() | now.keys() if before.get(name) != now.get(name))

    def compiled(self) -> dict[str, dict[str, str]]:
        """The state that `note` saved; empty if there is none."""
        try:
            return dict(json.loads((self.package / STATE_FILE).read_text()))
        except (OSError, ValueError):
            return {}

    def up_to_date(self) -> bool:
        """Are all kernels compiled from their present source?"""
        return self.compiled() == self.state()

    def unsure(self) -> bool:
        """Might kernels, those there are or were before, use something of a file that could not be read?"""
        importers = {module for (module, _), (source, _) in self.links.items() if source in self.unread}
        kernels = (kernel.rpartition(".") for kernel in self.before.keys() | self.kernels.keys())
        places = {(module, name) for module, _, name in kernels}
        return not places or any(module in self.unread | importers for module, _ in self.reached(places))

    def forget_stale(self, cache: Path, folders: str) -> bool:
        """Delete what was compiled of stale kernels, and of those whose arguments are of classes that are gone.

        Compiled kernels are in these `folders` below `cache`. Returns False, and deletes nothing, where that cannot be known yet.
        """
        if self.unread and self.unsure():
            return False
        stale = {".".join(name.split(".")[-2:]) for name in self.stale()}  # numba's files have no more of the name
        for file in cache.glob(f"{folders}/*.nb[ic]"):
            if file.name.partition("-")[0] in stale:
                file.unlink(missing_ok=True)
        for index in cache.glob(f"{folders}/*.nbi"):
            if not classes_in(index, self.package.name) <= self.defined.keys():
                for old in index.parent.glob(f"{index.stem}.*nb[ic]"):
                    old.unlink(missing_ok=True)
        return True

    def note(self) -> None:
        """Save the state: all kernels have been compiled."""
        file = self.package / STATE_FILE
        file.parent.mkdir(exist_ok=True)
        part = file.with_suffix(".tmp")
        part.write_text(json.dumps(self.state(), indent=1))
        part.replace(file)  # another set-up may read it meanwhile


class Anything:
    """Stands for every class and function that a pickle names."""

    def __init__(self, *_: Any, **__: Any) -> None:
        pass

    def __setstate__(self, _: Any) -> None:
        pass


class ClassReader(pickle.Unpickler):
    """Reads a pickle without importing anything; `named` are the (module, name) of what it would have imported."""

    def __init__(self, file: Any) -> None:
        super().__init__(file)
        self.named: set[Place] = set()

    def find_class(self, module: str, name: str) -> Any:
        self.named.add((module, name))
        return Anything


def classes_in(index: Path, package: str) -> set[Place]:
    """The classes of the package that numba's index file of a kernel names; something unknown if it cannot be read."""
    try:
        with open(index, "rb") as file:
            pickle.load(file)  # the version of numba
            reader = ClassReader(file)
            reader.load()
    except Exception:  # damaged files raise anything
        return {(package, str(index))}
    return {(module, name) for module, name in reader.named if module.split(".")[0] == package}


def without_docstrings(tree: ast.stmt) -> ast.stmt:
    """The same tree with an empty string for each docstring, in place."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and ast.get_docstring(node, clean=False) is not None:
            node.body[0] = ast.Expr(ast.Constant(""))
    return tree


def digest(text: str) -> str:
    return sha256(text.encode()).hexdigest()[:16]


if __name__ == "__main__":
    sys.exit(0 if Sources(PACKAGE).up_to_date() else 1)
