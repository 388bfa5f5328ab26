"""Columns of numbers in a CSV file, of which each rank reads a part: from about its share of the bytes, whole lines."""

import warnings
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple
from zlib import crc32

import numpy as np

from particles_mpi.errors import listed
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Array

BOM = b"\xef\xbb\xbf"  # with which some programs begin a text
NAMES = {"position": ("x", "y", "z"), "velocity": ("vx", "vy", "vz")}  # of columns in a header


class Table(NamedTuple):
    """The rows `first` ... first + len(values) - 1 of a file with `total` rows; values (n, columns)."""

    values: Array
    first: int
    total: int


def read_table(ranks: Communicator, path: Path, quantity: str, dimension: int) -> Table | str:
    """The d columns of a quantity in a CSV file, or what is wrong with it, the same on all ranks. Collective.

    A first line that begins with no number is a header: columns with the names of the quantity's components (NAMES) are taken,
    or, if no column has a name in NAMES, the first ones. Files that are not the same on all ranks are refused: each rank also
    looks at what the next one reads.
    """
    fault, block, seen = "", b"", (0, 0)
    try:
        block = lines_of(path, ranks.rank, ranks.size)
        seen = crc32(block), crc32(lines_of(path, (ranks.rank + 1) % ranks.size, ranks.size))
    except OSError as error:
        fault = f"{path} cannot be read ({error.strerror})"
    if first := first_of(ranks, fault):
        return first
    crcs = ranks.allgather(seen)
    for rank in range(1, ranks.size):
        if crcs[rank - 1][1] != crcs[rank][0]:
            return f"{path}: not the same on rank {rank} as on rank {rank - 1}"
    lines = block.count(b"\n") + (not block.endswith(b"\n") and len(block) > 0)
    line = 1 + sum(ranks.allgather(lines)[: ranks.rank])  # the number of the first line of this rank
    header = line == 1 and lines > 0 and not begins_with_number(block)
    headers = ranks.allgather(block.partition(b"\n")[0] if header else b"")  # of the rank that has the first line
    columns = columns_of(max(headers), quantity, dimension)
    if isinstance(columns, str):
        return f"{path}: {columns}"
    cells = max(ranks.allgather(block.partition(b"\n")[0].count(b",") + 1 if line == 1 and lines > 0 else 0))
    values = np.empty((0, dimension))
    try:
        values = parsed(block, columns, header)
    except ValueError:
        fault = f"{path}: {wrong_line(block, columns, header, line)}"
    else:
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if uneven := uneven_line(block, cells, line):
            fault = f"{path}: {uneven}"
        elif len(bad):
            fault = f"{path}: {listed((bad + line + header).tolist(), 'line')} not finite"
    if first := first_of(ranks, fault, name_rank=False):
        return first
    counts = ranks.allgather(len(values))
    return Table(values, sum(counts[: ranks.rank]), sum(counts)) if sum(counts) else f"{path} holds no rows"


def gives(ranks: Communicator, path: Path, quantity: str, dimension: int) -> bool:
    """Has a CSV file a header that names columns of this quantity? False if it cannot be read. Collective."""
    header = b""
    with suppress(OSError):  # that is told where the places are read
        if ranks.is_root:
            with path.open("rb") as file:
                header = file.readline().removeprefix(BOM)
    return dimension <= 3 and not set(names_in(ranks.bcast(header))).isdisjoint(NAMES[quantity][:dimension])


def names_in(header: bytes) -> list[str]:
    """Names of the columns."""
    return [cell.strip().strip('"').lower() for cell in header.decode("utf-8", "replace").split(",")]


def uneven_line(block: bytes, cells: int, first: int) -> str:
    """Which of the lines, of which the first has this number, has not so many `cells` as line 1, or ""; empty ones have none."""
    text = np.frombuffer(block, np.uint8)
    ends = np.append(np.flatnonzero(text == ord("\n")), len(text))
    begins = np.append(0, ends[:-1] + 1)
    commas = np.diff(np.searchsorted(np.flatnonzero(text == ord(",")), np.append(begins, len(text))))
    for line in np.flatnonzero((commas + 1 != cells) & (ends > begins)).tolist():
        content = block[begins[line] : ends[line]].strip()
        if content and not content.startswith(b"#"):
            return f"line {first + line} has {commas[line] + 1} columns, and line 1 has {cells}"
    return ""


def columns_of(header: bytes, quantity: str, dimension: int) -> list[int] | str:
    """Numbers of the columns that a header gives to a quantity, or what is wrong with it."""
    given = names_in(header)
    names = NAMES.get(quantity, ())[:dimension]
    named = [name for name in given if any(name in of for of in NAMES.values())]
    if not named or not names or (dimension > 3 and given[:3] == list(names)):
        return list(range(dimension))
    if dimension > 3:
        return f"its header has {', '.join(named)}; in dimension {dimension} columns are taken in order: leave it out"
    if missing := [name for name in names if name not in given]:
        have = [name for name in names if name in given] or named
        return f"its header has {', '.join(have)} and no {missing[0]}"
    return [given.index(name) for name in names]


def first_of(ranks: Communicator, fault: str, name_rank: bool = True) -> str:
    """The fault of the lowest rank that has one, or "". Collective."""
    faults = ranks.allgather(fault)
    rank = next((rank for rank, text in enumerate(faults) if text), None)
    if rank is None:
        return ""
    return f"rank {rank}: {faults[rank]}" if name_rank and set(faults) != {faults[rank]} else faults[rank]


def lines_of(path: Path, rank: int, size: int) -> bytes:
    """The lines that begin in the part of a rank of so many."""
    total = path.stat().st_size
    with open(path, "rb") as file:
        begin, end = (line_start(file, total * r // size) for r in (rank, rank + 1))
        file.seek(begin)
        return file.read(end - begin).removeprefix(BOM)


def line_start(file: BinaryIO, at: int) -> int:
    """Where the first line begins that begins at this byte or behind."""
    if at > 0:
        file.seek(at - 1)
        file.readline()
    return file.tell()


def begins_with_number(block: bytes) -> bool:
    try:
        float(block.partition(b"\n")[0].split(b",")[0])
    except ValueError:
        return False
    return True


def parsed(block: bytes, columns: list[int], header: bool) -> Array:
    """The numbers (n, columns) of some lines; ValueError if one has none."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # no line at all: an empty array
        text = BytesIO(block)
        table = np.loadtxt(text, delimiter=",", skiprows=int(header), usecols=columns, ndmin=2, encoding="utf-8")
        return table.reshape(-1, len(columns))


def wrong_line(block: bytes, columns: list[int], header: bool, first: int) -> str:
    """Which of the lines, of which the first has this number, cannot be read."""
    for number, line in enumerate(block.split(b"\n")[int(header) :], first + header):
        try:
            parsed(line, columns, header=False)
        except ValueError as error:
            return f"line {number}: {' '.join(str(error).split())}"
    return "cannot be read as columns of numbers"
