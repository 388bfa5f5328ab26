"""Loads kernels from numba's cache in a third of the time: what only a compiler needs is read when something is compiled.

With the machine code of a kernel numba keeps its bitcode, for kernels that are compiled later and call it. It reads this, and all
names in it, whenever a kernel is loaded, which takes longer than all else. Before it loads the first one it also imports all its
modules about Python and numpy, and SciPy, which takes as long as a hundred kernels. And for each function of its own that a
kernel calls it imports the module that defines it: for `np.searchsorted` a fifth of a second. Nearly always that is not needed.

Also, this module saves kernels one at a time. If two processes have compiled the same function for other arguments at the same
moment, as the ranks of set-up do, numba would lose one of them, or mix them up. All this changes private functions of numba; with
versions of numba for which it was not written nothing is changed.
"""

import fcntl
import inspect
import sys
from contextlib import suppress
from hashlib import sha256
from itertools import count
from pathlib import Path
from sysconfig import get_path
from types import FunctionType, ModuleType
from typing import Any

import llvmlite.binding as llvm
from numba import version_info
from numba.core import caching, codegen, environment
from numba.core.runtime.nrt import rtsys

from particles_mpi.source_files import edited

KNOWN = {(0, 68)}  # versions of numba
IMPORTED = {"numba.cpython.hashing"}  # of numba's modules those that must be: they make C functions known

library_class: Any = codegen.JITCodeLibrary
cache_class: Any = caching.Cache
files_class: Any = caching.IndexDataCacheFile
import_environment: Any = environment._rebuild_env
known_index_key: Any = cache_class._index_key
LIBRARIES = tuple(get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib"))
PROGRAM = f"{__name__.partition('.')[0]}."  # with which its modules begin


class Library(library_class):  # type: ignore[misc]
    """The compiled code of a kernel; `unread`: machine code and bitcode, if it is from the cache and nothing needed these."""

    unread: tuple[bytes, bytes] | None = None

    @classmethod
    def _unserialize(cls, codegen: Any, state: tuple[str, str, Any]) -> Any:
        """From what was kept: (name, "object", (machine code, bitcode))."""
        name, kind, kept = state
        if kind != "object":
            return super()._unserialize(codegen, state)
        library = codegen.create_library(name)
        library.unread = kept
        library.enable_object_caching()
        library._set_compiled_object(kept[0])
        library._finalize_final_module()
        return library

    def get_pointer_to_function(self, name: str) -> Any:
        """Where the function of this name begins, or 0: it is there if the name is among those of the machine code."""
        if self.unread is not None and name.encode() in self.unread[0]:
            self._codegen._engine._defined_symbols.add(name)
        return super().get_pointer_to_function(name)

    def _get_module_for_linking(self) -> Any:
        """For a kernel that calls this one."""
        if self.unread is not None:
            self._shared_module, self.unread = llvm.parse_bitcode(self.unread[1]), None
            self._codegen._engine._load_defined_symbols(self._shared_module)
        return super()._get_module_for_linking()


def load_overload(cache: Any, signature: Any, context: Any) -> Any:
    """The kernel of this signature from its cache, or None: as `Cache.load_overload`, but that imports what a compiler needs.

    A compiler imports that itself. What kernels call at run time, numba's own functions in C, is made known here.
    """
    rtsys.initialize(context)
    with cache._guard_against_spurious_io_errors(), suppress(ModuleNotFoundError):  # the file of an effect has been moved since
        return cache._load_overload(signature, context)
    return None


def environment_of(module: str, constants: list[Any], name: str) -> Any:
    """The constants of a compiled function, by name; as `_rebuild_env`, but without an import of the numba module it is from.

    The names in that module are for functions in which objects of Python are left as they are: kernels are none of these.
    """
    own = module.startswith("numba.") and module not in sys.modules and module not in IMPORTED
    if not own or environment.lookup_environment(name) is not None:
        return import_environment(module, constants, name)
    found = environment.Environment({"__name__": module})
    found.consts[:], found.env_name = constants, name
    environment.Environment._memo[name] = found
    return found


def save_alone(files: Any, key: Any, data: Any) -> None:
    """As `IndexDataCacheFile.save`, which reads an index file, adds a line and writes it, while no other process does so.

    The code comes before the line that names it: numba's own order, interrupted between the two, leaves a line that names the
    code of something else. What was compiled from files that have been edited since is not kept: other files than its own are
    not compared when it is loaded.
    """
    if edited():
        return
    with open(Path(files._cache_path) / "kernels.lock", "w") as lock:
        with suppress(OSError):  # some file systems have no locks
            fcntl.flock(lock, fcntl.LOCK_EX)
        known = files._load_index()
        names = map(files._data_name, count(1))
        name = known[key] if key in known else next(name for name in names if name not in known.values())
        files._save_data(name, data)
        if key not in known:
            files._save_index(known | {key: name})


def index_key(cache: Any, signature: Any, codegen: Any) -> Any:
    """By which a kernel is found in the cache: one from a user's file also by what it uses of other files.

    Numba compares the file of the kernel itself only: a function, or a number, that it imports may have changed.
    """
    key, function = known_index_key(cache, signature, codegen), cache._py_func
    if function.__module__.startswith(PROGRAM):  # edited sources of the program are set up anew
        return key
    return *key, sha256(repr(used_by(function, set())).encode()).hexdigest()


def used_by(function: Any, seen: set[int]) -> list[Any]:
    """What a function uses from outside of it: numbers, and the files of other functions and of modules, and what these use."""
    seen.add(id(function))
    variables, used = inspect.getclosurevars(function), list[Any]()
    values = {**variables.globals, **variables.nonlocals}
    modules = [value for value in values.values() if isinstance(value, ModuleType)]
    for module in modules:
        if not of_library(getattr(module, "__file__", None)):
            values |= {f"{module.__name__}.{name}": getattr(module, name, None) for name in function.__code__.co_names}
    values |= {f"default {k}": value for k, value in enumerate(function.__defaults__ or ())}
    for name, value in sorted(values.items()):
        inner = getattr(value, "py_func", value)
        if isinstance(inner, FunctionType):
            file = inner.__code__.co_filename
            used += [name, text_of(file), [] if id(inner) in seen or of_library(file) else used_by(inner, seen)]
        elif isinstance(value, ModuleType):
            used += [name, text_of(getattr(value, "__file__", None))]
        elif hasattr(value, "tobytes"):
            used += [name, value.tobytes()]
        elif isinstance(value, int | float | complex | str | tuple):
            used += [name, value]
    return used


def of_library(file: str | None) -> bool:
    """Is it of Python, or installed? Such files are whole: what they use in turn is not looked at."""
    return file is None or file.startswith(LIBRARIES)


def text_of(file: str | None) -> bytes:
    """All that stands in a file; nothing if it cannot be read."""
    with suppress(OSError):
        return Path(file).read_bytes() if file else b""
    return b""


def load_and_keep_kernels() -> None:
    """Let numba load and save kernels by the functions of this module, if its version is known."""
    if version_info[:2] in KNOWN:
        codegen.JITCPUCodegen._library_class = Library
        cache_class.load_overload = load_overload
        environment_of.__module__, environment_of.__qualname__ = import_environment.__module__, import_environment.__qualname__
        environment._rebuild_env = environment_of  # under the name that kept kernels have it by
        files_class.save = save_alone
        cache_class._index_key = index_key
