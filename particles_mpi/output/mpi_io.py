"""The reason why a parallel write failed, which Open MPI prints and does not return: HDF5 knows only that it did."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager

REASON = re.compile(r"error in \(?p?\)?\(?(?:write|read)\(?v?\)?: *(.+)")


@contextmanager
def told_reason() -> Iterator[None]:
    """Run a block that writes through MPI-IO; if it fails, what was printed on stderr meanwhile becomes the text of an OSError.

    Whatever else was printed is printed behind the block.
    """
    held, stderr = os.memfd_create("stderr"), os.dup(2)
    os.dup2(held, 2)
    failure = None
    try:
        yield
    except (OSError, RuntimeError, ValueError, KeyError) as error:
        failure = error
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        said = os.pread(held, os.lseek(held, 0, os.SEEK_END), 0)
        os.close(held)
    reason = REASON.search(said.decode(errors="replace")) if failure else None
    if reason:
        raise OSError(reason[1].strip()) from failure
    if said:
        os.write(2, said)
    if failure:
        raise failure
