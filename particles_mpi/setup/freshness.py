"""Makes sure, whenever the program starts, that no kernel is loaded which was compiled from sources that have changed since.

Numba compares a compiled kernel only with the file that defines it. If a kernel uses a function or a constant of another file
that has changed, the old kernel would be loaded without a warning. `kernel_sources` finds these kernels, but takes a second. So
first times and sizes of all files are compared with those of the last check, in a few milliseconds.
"""

import json
import os
from contextlib import suppress
from pathlib import Path
from typing import Any
from zlib import crc32

from particles_mpi.source_files import AT_START, PACKAGE

RECORD = "looked_at.json"  # of the last look: files, and digests of all kernels


def cache_of(package: Path) -> tuple[Path, str]:
    """Where numba keeps what it compiles of the package: a folder, and a pattern of folders in it. In numba's own order."""
    if own := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(own), "*_*"
    if os.access(package, os.W_OK):
        return package, "**/__pycache__"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "numba", "*_*"


def forget_stale_kernels() -> None:
    """Where a file has changed since the last look, delete what was compiled of kernels that it concerns.

    Where the folder for compiled kernels cannot be written there is nothing to be done: none are kept there.
    """
    cache, folders = cache_of(PACKAGE)
    record = PACKAGE / "__pycache__" / RECORD
    if cache != PACKAGE:  # which copies of the package may share
        record = cache / f"{crc32(str(PACKAGE).encode()):08x}_{RECORD}"
    seen: dict[str, Any] = {}  # what the last look has left, if there was one
    with suppress(OSError, ValueError):
        seen = dict(json.loads(record.read_text(encoding="utf-8")))
    if seen.get("files") == AT_START:
        return
    from particles_mpi.setup.kernel_sources import Sources

    with suppress(OSError):  # not to be written, or full
        sources = Sources(PACKAGE, seen.get("kernels"))
        if sources.forget_stale(cache, folders):
            record.parent.mkdir(parents=True, exist_ok=True)
            part = record.with_suffix(f".{os.getpid()}")
            part.write_text(json.dumps({"files": AT_START, "kernels": sources.kernels}), encoding="utf-8")
            part.replace(record)
