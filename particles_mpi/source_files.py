"""The files with sources of this program as they were when it started: code that it has loaded is of these.

Whatever is edited meanwhile, what a process compiles is of the files that it has read, and may not be kept for those that are
there now.
"""

import os
from contextlib import suppress
from pathlib import Path

PACKAGE = Path(__file__).parent


def files_of(package: Path) -> str:
    """Name, time and size of each file with sources, a line each. What a run wrote into a folder of the package is no source."""
    lines = []
    for folder, folders, names in os.walk(package):
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


AT_START = files_of(PACKAGE)


def edited() -> bool:
    """Has a file changed since this process began?"""
    return files_of(PACKAGE) != AT_START
