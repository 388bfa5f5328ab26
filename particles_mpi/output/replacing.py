"""Files that are replaced as a whole, so that a reader never finds half of one."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def temporary_of(path: Path) -> Path:
    """The temporary file that becomes `path` when it is whole."""
    return path.with_name(path.name + ".tmp")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Gives the name of a temporary file, which becomes `path` at the end: at any time `path` is the old file or the new one."""
    part = temporary_of(path)
    try:
        yield part
        os.replace(part, path)
    except BaseException:
        part.unlink(missing_ok=True)  # half a file is of no use
        raise


def replace_text(path: Path, text: str) -> None:
    """Write a text file as a whole."""
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8")
