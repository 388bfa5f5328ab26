"""Columns of numbers in a CSV file, of which each rank reads a part: from about its share of the bytes, whole lines."""

import re
import warnings
from contextlib import suppress
from io import BytesIO
from itertools import chain
from pathlib import Path
from typing import BinaryIO, NamedTuple
from zlib import crc32

import numpy as np

from particles_mpi.errors import listed, one_line
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import FIELDS, Array, components

MOST_SHOWN = 6  # columns of a header in a message
BOM = b"\xef\xbb\xbf"  # with which some programs begin a text
# Of columns in a header, by what they give; other quantities are called by their own names
NAMES = {"position": ("x", "y", "z"), "velocity": ("vx", "vy", "vz")}


class Table(NamedTuple):
    """The rows `first` ... first + len(values) - 1 of a file with `total` rows; values (n, columns)."""

    values: Array
    first: int
    total: int


class Beginning(NamedTuple):
    """The first line of a file that says anything, what stands in its columns, and how many `lines` before it say nothing.

    Those are empty or begin with "#". `header`: has it names, and no numbers? `at`: the byte where numbers begin.
    """

    line: bytes = b""
    cells: tuple[str, ...] = ()
    header: bool = False
    lines: int = 0
    at: int = 0


def read_table(ranks: Communicator, path: Path, quantity: str, dimension: int) -> Table | str:
    """The columns of a quantity in a CSV file, or what is wrong with it, the same on all ranks. Collective.

    A first line of names, that is of cells which begin with a letter and are no numbers, is a header: columns with the names of
    the quantity's components (`names_of`) are taken. Without a header, or in more than three dimensions, the first columns are.
    Files that are not the same on all ranks are refused: each rank also looks at what the next one reads.
    """
    fault, block, seen, start = "", b"", (0, 0), Beginning()
    try:
        start = beginning(path)
        block = lines_of(path, start.at, ranks.rank, ranks.size)
        after = lines_of(path, start.at, (ranks.rank + 1) % ranks.size, ranks.size)
        seen = crc32(start.line + block), crc32(start.line + after)
    except OSError as error:
        fault = f"{path} cannot be read ({error.strerror})"
    if first := first_of(ranks, fault):
        return first
    crcs = ranks.allgather(seen)
    for rank in range(1, ranks.size):
        if crcs[rank - 1][1] != crcs[rank][0]:
            return f"{path}: not the same on rank {rank} as on rank {rank - 1}"
    lines = block.count(b"\n") + (not block.endswith(b"\n") and len(block) > 0)
    line = 1 + start.lines + start.header + sum(ranks.allgather(lines)[: ranks.rank])  # the number of this rank's first line
    columns = columns_of(start.cells if start.header else (), quantity, dimension)
    separated = " (columns are separated by commas)" if b";" in start.line else ""
    if isinstance(columns, str):
        return f"{path}: {columns}{separated}"
    values = np.empty((0, len(columns)))
    try:
        values = parsed(block, columns)
    except ValueError:
        fault = f"{path}: {wrong_line(block, columns, line)}{separated}"
    else:
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if uneven := uneven_line(block, start, line):
            fault = f"{path}: {uneven}"
        elif len(bad):
            fault = f"{path}: {listed((bad + line).tolist(), 'line')}: a number is not finite"
    if first := first_of(ranks, fault, name_rank=False):
        return first
    counts = ranks.allgather(len(values))
    return Table(values, sum(counts[: ranks.rank]), sum(counts)) if sum(counts) else f"{path} holds no rows"


def beginning(path: Path) -> Beginning:
    """Where the numbers of a file begin, and what stands before them."""
    at = lines = 0
    with path.open("rb") as file:
        for line in file:
            content = (line if lines else line.removeprefix(BOM)).strip()
            if content and not content.startswith(b"#"):
                cells = tuple(cell.strip().strip('"').lower() for cell in content.decode("utf-8", "replace").split(","))
                header = are_names(cells)
                return Beginning(content, cells, header, lines, at + len(line) * header)
            at, lines = at + len(line), lines + 1
    return Beginning(lines=lines, at=at)


def names_of(quantity: str, dimension: int) -> tuple[str, ...]:
    """What a header calls the columns of a quantity, at most three: "x", "y"; "mass"; of other vectors "spin_x" and so on."""
    if quantity in NAMES:
        return NAMES[quantity][:dimension]
    name, column = quantity.lower(), FIELDS[quantity]
    one = not column.vector and components(column, dimension) <= 1
    return (name,) if one else tuple(f"{name}_{axis}" for axis in "xyz"[:dimension])


def columns_in(ranks: Communicator, path: Path, dimension: int, quantities: list[str]) -> tuple[list[str], str]:
    """(which of these quantities a CSV file gives by the names in its header, which columns are not read). Collective.

    Nothing is given where the file cannot be read, which is a fault as soon as its places are read, or in more than three
    dimensions, where columns have no names.
    """
    start = Beginning()
    with suppress(OSError):
        if ranks.is_root:
            start = beginning(path)
    start = ranks.bcast(start)
    known = {quantity: names_of(quantity, dimension) for quantity in quantities}
    named = start.header and dimension <= 3
    given = [quantity for quantity, of in known.items() if named and not set(of).isdisjoint(start.cells)]
    unread = [name for name in filter(None, start.cells) if name not in chain.from_iterable(known.values())] if given else []
    if not given and len(start.cells) > dimension:
        cure = ": add a header that names them" if dimension <= 3 else ""
        return [], f"columns after the first {dimension} of {path} are not read{cure}"
    names = ", ".join(chain.from_iterable(known.values()))
    return given, f"columns {', '.join(unread)} of {path} are not read; known are {names}" if unread else ""


def uneven_line(block: bytes, start: Beginning, first: int) -> str:
    """The first line with another number of cells than `start`, in words, or "". Empty lines and remarks are left out.

    `first`: the number of the first line of the block.
    """
    text = np.frombuffer(block, np.uint8)
    ends = np.append(np.flatnonzero(text == ord("\n")), len(text))
    begins = np.append(0, ends[:-1] + 1)
    commas = np.diff(np.searchsorted(np.flatnonzero(text == ord(",")), np.append(begins, len(text))))
    for line in np.flatnonzero((commas + 1 != len(start.cells)) & (ends > begins)).tolist():
        content = block[begins[line] : ends[line]].strip()
        if content and not content.startswith(b"#"):
            return f"line {first + line} has {commas[line] + 1} columns, but line {start.lines + 1} has {len(start.cells)}"
    return ""


def columns_of(given: tuple[str, ...], quantity: str, dimension: int) -> list[int] | str:
    """Numbers of the columns that a header with these names gives to a quantity, or what is wrong with it."""
    names = names_of(quantity, dimension)
    named = [name for name in given if name in (*chain.from_iterable(NAMES.values()), "radius", "mass")]
    known = {name for column in FIELDS for name in names_of(column, dimension)}
    if dimension > 3 and (wrong := [name for name in given[3 * (given[:3] == names) : dimension] if name in known]):
        return f"its header has {', '.join(wrong)}; in dimension {dimension} columns are taken in order: leave it out"
    if not given or dimension > 3:
        return list(range(dimension))
    if missing := [name for name in names if name not in given]:
        shown = [name if name.isprintable() else ascii(name) for name in given[:MOST_SHOWN]]
        have = [name for name in names if name in given] or named or shown
        return f"its header has {', '.join(have)}, but no {missing[0]}"
    if twice := [name for name in names if given.count(name) > 1]:
        return f"its header has {twice[0]} twice"
    return [given.index(name) for name in names]


def first_of(ranks: Communicator, fault: str, name_rank: bool = True) -> str:
    """The fault of the lowest rank that has one, or "". Collective."""
    faults = ranks.allgather(fault)
    rank = next((rank for rank, text in enumerate(faults) if text), None)
    if rank is None:
        return ""
    return f"rank {rank}: {faults[rank]}" if name_rank and set(faults) != {faults[rank]} else faults[rank]


def lines_of(path: Path, at: int, rank: int, size: int) -> bytes:
    """The lines that begin in part `rank` of the `size` equal parts into which a file is divided from its byte `at` on."""
    length = path.stat().st_size - at
    with open(path, "rb") as file:
        begin, end = (line_start(file, at + length * r // size) for r in (rank, rank + 1))
        file.seek(begin)
        return file.read(end - begin).removeprefix(BOM)


def line_start(file: BinaryIO, at: int) -> int:
    """Where the first line begins that begins at this byte or behind."""
    if at > 0:
        file.seek(at - 1)
        file.readline()
    return file.tell()


def are_names(cells: tuple[str, ...]) -> bool:
    """Are these the cells of a header? Each that is not empty begins with a letter, and none is a number, as nan would be."""
    for cell in filter(None, cells):
        if not (cell[0].isalpha() or cell[0] == "_"):
            return False
        with suppress(ValueError):
            float(cell)
            return False
    return any(cells)


def parsed(block: bytes, columns: list[int]) -> Array:
    """The numbers (n, columns) of some lines; ValueError if one has none."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # no line at all: an empty array
        table = np.loadtxt(BytesIO(block), delimiter=",", usecols=columns, ndmin=2, encoding="utf-8", quotechar='"')
        return table.reshape(-1, len(columns))


def wrong_line(block: bytes, columns: list[int], first: int) -> str:
    """Which of the lines, of which the first has this number, cannot be read."""
    for number, line in enumerate(block.split(b"\n"), first):
        try:
            parsed(line, columns)
        except ValueError as error:
            why = re.sub(r" to float64 at row \d+, column (\d+)\.", r" in column \1 to a number", one_line(error))
            return f"line {number}: " + re.sub(
                r"invalid column index \d+ at row \d+ with (\d+) columns", r"too few columns: \1", why
            )
    return "cannot be read as columns of numbers"
