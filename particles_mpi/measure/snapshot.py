"""The whole state of a simulation apart from any rank: to copy, compare, print and save it as JSON."""

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from particles_mpi.errors import SceneError
from particles_mpi.output.files import write_text
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import allgather_rows, id_range, in_id_order
from particles_mpi.particles import FIELDS, RUN_MADE, Array, Particles, components, rows_of, same_bits

JSON_FORMAT = "particles_mpi state 3"
# The keys of `metadata` of a simulation
METADATA = ("step", "moment", "h", "observed", "totals", "reported", "notes", "next_id", "additions", "scene")
TABLE_ROWS = 20  # rows of a printed table
LARGE_TEXT = 1_000_000  # particles: with more an error tells the user what a text with all of them costs
JSON_BYTES = 1000  # of memory for a particle: its numbers as objects and as text, measured in 3D


def gather_all(ranks: Communicator, particles: Particles) -> Particles:
    """All particles of all ranks in id order, on every rank. Collective."""
    arrived = allgather_rows(ranks, particles.arrays)
    return Particles(particles.dimension, rows_of(arrived, np.argsort(arrived["id"], kind="stable")))


def same(one: Particles, other: Particles) -> bool:
    """The same fields with the same bits, row by row."""
    return one.arrays.keys() == other.arrays.keys() and all(same_bits(one[name], other[name]) for name in one.arrays)


def printed_table(particles: Particles) -> str:
    """The first particles as a table, a line each, lowest ids first."""
    order = np.argsort(particles.id)[:TABLE_ROWS]
    names = [name for name in particles.arrays if name not in RUN_MADE]
    columns = [[name, *(_cell(particles[name][i]) for i in order)] for name in names]
    widths = [max(map(len, column)) for column in columns]
    rows = ["  ".join(map(str.rjust, line, widths)) for line in zip(*columns)]
    more = len(particles) - len(order)
    return "\n".join([*rows, f"... and {more} more"] if more > 0 else rows)


def _cell(value: Any) -> str:
    return "(" + ", ".join(map(_cell, value)) + ")" if np.ndim(value) else f"{value:.6g}"


def save_json(path: Path, ranks: Communicator, rows: Particles, metadata: dict[str, Any], indent: int | None) -> None:
    """Write all particles in id order, floats with the digits that give the same bits back. Rank 0 holds all. Collective."""
    ids = id_range(ranks, rows.id)
    if ids.total > LARGE_TEXT and ranks.is_root:
        needed = ids.total * JSON_BYTES / 1e9
        cost = f"to_json: {ids.total} particles as text need about {needed:.0f} GB on rank 0; use a checkpoint, which needs none"
        warnings.warn(cost, stacklevel=3)
    arrays = in_id_order(ranks, rows.arrays, ids, 1)
    columns = {name: {"dtype": str(column.dtype), "values": _json_values(column)} for name, column in arrays.items()}
    text = json.dumps({"format": JSON_FORMAT, **metadata, "particles": columns}, indent=indent, allow_nan=False) + "\n"
    write_text(path, ranks, text)


def _json_values(column: Array) -> list[Any]:
    """Rows as lists; numbers that JSON does not have as text."""
    finite = np.isfinite(column)
    values: list[Any] = (column if finite.all() else np.where(finite, column.astype(object), column.astype(str))).tolist()
    return values


def load_json(path: Path) -> tuple[dict[str, Array], dict[str, Any]]:
    """(arrays of all particles in id order, what was said about the state). SceneError, one line, for anything else."""
    try:
        state = json.loads(path.read_text())
        if state.pop("format") != JSON_FORMAT:
            raise KeyError("format")
        columns = state.pop("particles")
        arrays = {name: np.array(c["values"], c["dtype"]) for name, c in columns.items()}
        d = state["scene"]["dimension"]
        for name in arrays:
            if name in FIELDS and (width := components(FIELDS[name], d)):
                arrays[name] = arrays[name].reshape(-1, width)
    except FileNotFoundError:
        raise SceneError(f"{path}: no such file") from None
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise SceneError(f"{path}: not a state saved by to_json ({str(error).splitlines()[0]})") from None
    return arrays, state
