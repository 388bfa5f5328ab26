"""The source files of this program, as they were when the process started.

A process compiles the sources that it has read. If a file was edited since then, the compiled kernels must not be stored for the
new version of the file.
"""

import os
from contextlib import suppress
from pathlib import Path

PACKAGE = Path(__file__).parent


def sources_now() -> str:
    """Path, time in ns and size in bytes of each file with sources, a line each; not of what a run wrote below the package."""
    lines = []
    for folder, folders, names in os.walk(PACKAGE):
        if "__init__.py" not in names:
            folders.clear()
            continue
        for name in names:
            if name.endswith(".py") and not name.startswith("."):  # an editor's own files
                path = os.path.join(folder, name)
                with suppress(FileNotFoundError):  # it has gone just now
                    about = os.stat(path)
                    lines.append(f"{path} {about.st_mtime_ns} {about.st_size}")
    return "\n".join(sorted(lines))


AT_START = sources_now()


def edited() -> bool:
    """Has a file changed since this process began?"""
    return sources_now() != AT_START
