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
Numbers = tuple[int, int]  # (first, last + 1) of a rank's particles of a population, counted from its first one


class Share(NamedTuple):
    """This rank's share of a population: the particles `numbers` of it, which stand in these `rows` of the columns."""

    number: int  # of the population, in messages and in random numbers
    population: Population
    total: int  # particles of the population, on all ranks
    begin: int  # particles of the populations built before it
    numbers: Numbers
    rows: slice
    files: dict[str, Table]  # by the key whose values they hold

    @property
    def key(self) -> str:
        """What messages call it."""
        return f"particles[{self.number}]"


class Columns:
    """The columns that are built (`arrays`, which may begin with rows that are there already), and how they are filled."""

    def __init__(self, scene: Scene, ranks: Communicator, faults: Faults, arrays: dict[str, Array], total: int):
        """`total`: particles that are built, on all ranks."""
        self.scene, self.ranks, self.faults, self.arrays, self.total = scene, ranks, faults, arrays, total

    def of(self, share: Share, name: str, value: Any) -> Any:
        """This rank's part of a value of a population: of a list, a file, random numbers in a range; a number is for all."""
        first, last = share.numbers
        if isinstance(value, dict) and "file" in value:
            table = share.files[name]
            rows = self.own_rows(table.values, share.begin + table.first)
            return rows if self.arrays[name].ndim == 2 else rows[:, 0]
        if isinstance(value, dict):
            key = stream_key(self.scene.seed, share.number, name)
            part, least, most = draw(key, first, last, uniform), value["min"], value["max"]
            if self.arrays[name].dtype.kind in "iu" and least == int(least) and most == int(most):  # each of them as likely
                return np.minimum(np.floor(least + part * (most - least + 1)), most)
            return least + part * (most - least)
        if isinstance(value, list) and (
            not (FIELDS[name].vector or FIELDS[name].rotation) or isinstance(next(iter(value), None), list)
        ):
            return value[first:last]
        return value

    def own_rows(self, values: Array, first: int) -> Array:
        """Rows of a file sent to the ranks that build their particles; returns this rank's, in order. Collective.

        The ranks have read the rows in order: `values` (n, columns) are those of this rank, for the particles with the numbers
        from `first` on, counted over all populations that are built.
        """
        owner = self.ranks.sharer(self.total, np.arange(first, first + len(values)))
        return send_rows(self.ranks, {"values": values}, *by_destination(owner, self.ranks.size))[0]["values"]

    def fill(self, share: Share, name: str, value: Any) -> None:
        """A field of a population from a number, a list, a file or a range. Collective."""
        mine, own = self.of(share, name, value), self.arrays[name][share.rows]
        try:
            values = np.asarray(mine, float)
        except OverflowError:
            values = np.array(LARGEST_NUMBER * 2.0)
        if own.dtype.kind in "iu":
            least, most = max(np.iinfo(own.dtype).min, -LARGEST_WHOLE), min(np.iinfo(own.dtype).max, LARGEST_WHOLE)
            whole = (values >= least) & (values <= most) & (values == np.rint(values))
            wrong = ~whole & np.ones(own.shape if len(own) else (0,), bool)
            self.refuse(share, name, wrong, f"no whole number of {own.dtype} for")
            values = np.where(whole, values, 0.0)
        if len(own):
            own[:] = values
        self.refuse(share, name, np.abs(own) > LARGEST_NUMBER, f"beyond {LARGEST_NUMBER:g} for")
        if name == "mass":  # 1/m must be a number too
            self.refuse(share, name, (own > 0.0) & (own < 1.0 / LARGEST_NUMBER), f"below {1.0 / LARGEST_NUMBER:g} for")

    def refuse(self, share: Share, name: str, bad: Array, why: str) -> None:
        """A fault of a key of the population, which names the particles that are `bad` (n,) or (n, d). Collective."""
        which = np.flatnonzero(bad.any(axis=1) if bad.ndim == 2 else bad)
        self.faults.name(f"{share.key}.{name}: {why} ", self.arrays["id"][share.rows][which])
