"""What is built: the columns of this rank, and its share of each population in them."""

from typing import Any, NamedTuple

import numpy as np

from particles_mpi.initial.faults import Faults
from particles_mpi.initial.random_numbers import draw, stream_key, uniform
from particles_mpi.initial.table_file import Table
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import by_destination, send_rows
from particles_mpi.particles import FIELDS, Array
from particles_mpi.scene.model import LARGEST_NUMBER
from particles_mpi.scene.population import Population
from particles_mpi.scene.schema import Scene

LARGEST_WHOLE = 2.0**53 - 1.0  # up to which no two whole numbers are the same float64


class Share(NamedTuple):
    """This rank's share of a population: the particles with these `numbers`, which are in these `rows` of the columns."""

    number: int  # of the population, in messages and in random numbers
    population: Population
    total: int  # particles of the population, on all ranks
    begin: int  # particles of the populations built before it
    numbers: tuple[int, int]  # (first, last + 1) of this rank's, counted from the first of the population
    rows: slice
    files: dict[str, Table]  # by the key whose values they hold

    @property
    def key(self) -> str:
        """What messages call it."""
        return f"particles[{self.number}]"


def is_listed(name: str, value: Any, dimension: int) -> bool:
    """Is a value of a field a list with an entry for each particle, and not one number or vector for all of them?"""
    if not isinstance(value, list):
        return False
    vector = FIELDS[name].vector or (FIELDS[name].rotation and dimension == 3)
    return not vector or not value or isinstance(value[0], list)


class Columns:
    """The columns that are built (`arrays`, which may begin with rows that exist already), and how they are filled."""

    def __init__(self, scene: Scene, ranks: Communicator, faults: Faults, arrays: dict[str, Array], total: int):
        """`total`: particles that are built, on all ranks."""
        self.scene, self.ranks, self.faults, self.arrays, self.total = scene, ranks, faults, arrays, total

    def of(self, share: Share, name: str, value: Any) -> Any:
        """Return this rank's part of a value of a population: a list, a file, random numbers in a range, or one number for all.

        Collective.
        """
        if isinstance(value, dict) and "file" in value:
            # Ranks have read the rows of the file in order: each row goes to the rank that builds its particle
            table, ranks = share.files[name], self.ranks
            first = share.begin + table.first
            owner = ranks.sharer(self.total, np.arange(first, first + len(table.values)))
            rows = send_rows(ranks, {"values": table.values}, *by_destination(owner, ranks.size))[0]["values"]
            return rows if self.arrays[name].ndim == 2 else rows[:, 0]
        if isinstance(value, dict):
            key = stream_key(self.scene.seed, share.number, name)
            part, least, most = draw(key, *share.numbers, uniform), value["min"], value["max"]
            if self.arrays[name].dtype.kind in "iu" and least == int(least) and most == int(most):  # each of them as likely
                return np.minimum(np.floor(least + part * (most - least + 1)), most)
            return least + part * (most - least)
        return value[slice(*share.numbers)] if is_listed(name, value, self.scene.dimension) else value

    def fill(self, share: Share, name: str, value: Any) -> None:
        """Fill a field of a population from a number, a list, a file or a range. Collective."""
        mine, own = self.of(share, name, value), self.arrays[name][share.rows]
        values = np.broadcast_to(np.asarray(mine, float) if len(own) else 0.0, own.shape)
        if own.dtype.kind in "iu":
            least, most = max(np.iinfo(own.dtype).min, -LARGEST_WHOLE), min(np.iinfo(own.dtype).max, LARGEST_WHOLE)
            whole = (values >= least) & (values <= most) & (values == np.rint(values))
            limit = " up to 2^53 - 1" if most == LARGEST_WHOLE else ""
            self.refuse(share, name, ~whole, f"not a whole number of type {own.dtype}{limit} for")
            values = np.where(whole, values, 0.0)
        largest = min(LARGEST_NUMBER, np.finfo(own.dtype).max) if own.dtype.kind == "f" else LARGEST_NUMBER
        beyond = np.abs(values) > largest
        self.refuse(share, name, beyond, f"beyond {largest:g} for")
        own[:] = np.where(beyond, 0.0, values) if beyond.any() else values
        if name == "mass":  # 1/m must be a number too
            self.refuse(share, name, (own > 0.0) & (own < 1.0 / LARGEST_NUMBER), f"below {1.0 / LARGEST_NUMBER:g} for")

    def refuse(self, share: Share, name: str, bad: Array, why: str) -> None:
        """Add a fault of a key of the population, which names the particles that are `bad` (n,) or (n, d). Collective."""
        which = np.flatnonzero(bad.any(axis=1) if bad.ndim == 2 else bad)
        self.faults.name(f"{share.key}.{name}: {why} ", self.arrays["id"][share.rows][which])
