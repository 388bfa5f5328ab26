"""The particles at the start of a scene. Each rank makes a share of ids; the result is the same on any number of ranks."""

from typing import Any

import numpy as np
from pydantic import ValidationError

from particles_mpi.errors import SceneError
from particles_mpi.initial.checks import check_start
from particles_mpi.initial.columns import Columns, Share, is_listed
from particles_mpi.initial.faults import Faults
from particles_mpi.initial.quantities import fill_attributes, fill_places, fill_velocities
from particles_mpi.initial.room import room_of
from particles_mpi.initial.table_file import Table, columns_in, read_table
from particles_mpi.kernels import limits
from particles_mpi.parallel.agreement import raising_together
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import BUILT_IN, Array, Particles, default_values
from particles_mpi.scene.active import fields_of
from particles_mpi.scene.memory import memory_needed, memory_there
from particles_mpi.scene.model import faults_of
from particles_mpi.scene.population import Population, population_faults
from particles_mpi.scene.schema import Scene


def populate(scene: Scene, ranks: Communicator | None = None) -> tuple[Particles, list[str]]:
    """(particles of this rank's share of the ids, in order; warnings) of a scene. Collective; by default one rank has all.

    SceneError, the same on all ranks, with one line for each fault.
    """
    with np.errstate(over="ignore", under="ignore"):
        return Populator(scene, dict(enumerate(scene.particles)), ranks or Communicator.alone()).populate()


def add_population(
    scene: Scene, ranks: Communicator, there: Particles, table: dict[str, Any], next_id: int, number: int
) -> tuple[Particles, list[str]]:
    """(this rank's particles that are `there`, and behind them its share of one more population; warnings). Collective.

    `table`: the keys of a `[[particles]]` table, and fields of the user's own; `number` tells this population from others, in
    messages and in random numbers.
    """
    key = f"particles[{number}]"
    tables = dict(table)
    own = {name: tables.pop(name) for name in there.arrays.keys() - set(fields_of(scene)) - set(BUILT_IN) if name in tables}
    try:
        population = Population.model_validate(tables)
    except ValidationError as error:
        raise SceneError(faults_of(error, Population, (key,))) from None
    faults = population_faults(scene, key, population)
    if faults:
        raise SceneError(faults)
    with np.errstate(over="ignore", under="ignore"):
        populator = Populator(scene, {number: population}, ranks, there, next_id)
        particles, warnings = populator.populate()
    for name, value in own.items():
        try:
            values = np.broadcast_to(value, (populator.total, *particles[name].shape[1:]))
            particles[name][len(there) :] = values[populator.first : populator.last]
        except ValueError:
            raise SceneError(f"{key}.{name}: must be one value, or one for each of {populator.total} particles") from None
    return particles, warnings


class Populator:
    """Builds populations (by number) one quantity after the other, behind those that are `there`, with ids from `next_id` on.

    Of all that are built this rank has those with the numbers first ... last - 1.
    """

    def __init__(
        self,
        scene: Scene,
        populations: dict[int, Population],
        ranks: Communicator,
        there: Particles | None = None,
        next_id: int = 0,
    ):
        self.scene, self.populations, self.ranks, self.there, self.next_id = scene, populations, ranks, there, next_id
        self.before = 0 if there is None else len(there)
        self.faults = Faults(ranks)
        self.notes: list[str] = []  # warnings

    def populate(self) -> tuple[Particles, list[str]]:
        """(the particles that are there and behind them this rank's part of the new ones; warnings). Collective."""
        fields = fields_of(self.scene)
        self.populations = {number: self.with_columns(number, some, fields) for number, some in self.populations.items()}
        files: list[dict[str, Table]] = [{} for _ in self.populations]
        counts = [self.count_of(number, p, read) for (number, p), read in zip(self.populations.items(), files, strict=True)]
        self.faults.stop()
        self.check_memory(counts, fields)
        self.total = sum(counts)
        self.first, self.last = self.ranks.share(self.total)
        with raising_together(self.ranks):
            columns = Columns(self.scene, self.ranks, self.faults, self.columns(fields), self.total)
        shares = self.shares(counts, files)
        for share in shares:
            fill_attributes(columns, share)
        self.faults.stop()
        room, scattered = room_of(self.scene), np.zeros(len(columns.arrays["id"]), bool)
        for share in shares:
            scattered[share.rows] = share.population.position == "random"
        fill_places(columns, shares, room, scattered)
        for share in shares:
            fill_velocities(columns, share, shares)
        self.faults.stop()
        particles = Particles(self.scene.dimension, columns.arrays)
        judged = ~scattered  # which rows are tested for overlaps: those with random places have none
        warnings = check_start(self.scene, particles, room, self.faults, self.before, judged)
        self.faults.stop()
        return particles, self.notes + warnings

    def shares(self, counts: list[int], files: list[dict[str, Table]]) -> list[Share]:
        """This rank's part of each population."""
        shares, begin = [], 0
        for (number, population), count, read in zip(self.populations.items(), counts, files, strict=True):
            low, high = (min(max(edge, self.first), self.last) for edge in (begin, begin + count))
            rows = slice(self.before + low - self.first, self.before + high - self.first)
            shares.append(Share(number, population, count, begin, (low - begin, high - begin), rows, read))
            begin += count
        return shares

    def columns(self, fields: list[str]) -> dict[str, Array]:
        """These fields, with what they hold where nothing gives a value, and what the user has attached."""
        d, n = self.scene.dimension, self.before + self.last - self.first
        arrays = {name: default_values(name, n, d) for name in fields}
        for name, column in self.there.arrays.items() if self.there is not None else ():
            if name not in arrays:  # attached by the user
                arrays[name] = np.zeros((n, *column.shape[1:]), column.dtype)
            arrays[name][: self.before] = column
        arrays["id"][self.before :] = self.next_id + np.arange(self.first, self.last)
        return arrays

    def check_memory(self, counts: list[int], fields: list[str]) -> None:
        """SceneError if the particles need more memory than there is, or a rank more rows than an int32 counts. Collective.

        So a count with a zero too many is a fault, and not a killed process.
        """
        total, ranks = sum(counts), self.ranks
        columns = {name: default_values(name, 1, self.scene.dimension) for name in fields}
        need, have = memory_needed(self.scene, columns, total, ranks.size, piles=False), ranks.least(memory_there())
        uncounted = total / ranks.size > limits.INT32_MAX
        here = ranks.largest(ranks.on_this_machine() if need > have else 1)[0]
        if need * here / ranks.size > have or uncounted:
            k = list(self.populations)[int(np.argmax(np.array(counts, float)))]
            each = f", on {here:.0f} of {ranks.size} ranks {need * here / ranks.size / 1e9:.3g} GB" if here < ranks.size else ""
            raise SceneError(
                f"particles[{k}].count: {total} particles in all need about {need / 1e9:.3g} GB{each}; the machine has"
                f" {have / 1e9:.3g} GB"
                + (f"; more than {limits.INT32_MAX} particles on a rank: use more ranks" if uncounted else "")
            )

    def with_columns(self, number: int, population: Population, fields: list[str]) -> Population:
        """A file of places whose header names more columns gives those too, unless the scene says otherwise. Collective."""
        place = population.position
        if not (isinstance(place, dict) and "file" in place):
            return population
        scene, said = self.scene, {name: value for name, value in population if value is not None}
        possible = [name for name in fields if name in Population.model_fields or name in scene.columns]
        given, unread = columns_in(self.ranks, scene.folder / place["file"], scene.dimension, possible)
        if unread:
            self.notes.append(f"particles[{number}].position: {unread}")
        for name in given:
            if said.get(name, place) != place:
                self.notes.append(f"particles[{number}].{name}: the value in the scene is used, not that in {place['file']}")
        return population.model_copy(update={name: place for name in given if name not in said})

    def count_of(self, number: int, population: Population, files: dict[str, Table]) -> int:
        """Particles of a population: `count`, or the length of its lists and `files`, which it reads, and which must agree."""
        lengths = {} if population.count is None else {"count": population.count}
        for name, value in population:
            if isinstance(value, dict) and "file" in value:
                table = read_table(self.ranks, self.scene.folder / value["file"], name, self.scene.dimension)
                if isinstance(table, str):
                    self.faults.add(f"particles[{number}].{name}: {table}")
                    return 0
                files[name] = table
                lengths[name] = table.total
            elif is_listed(name, value, self.scene.dimension):
                lengths[name] = len(value)
        if not lengths:
            self.faults.add(f"particles[{number}].count: missing")
            return 0
        reference, count = next(iter(lengths.items()))
        expected = f"count = {count}" if reference == "count" else f"{reference} has {count}"
        for name, length in lengths.items():
            if length != count:
                self.faults.add(f"particles[{number}].{name}: {length} entries, but {expected}")
        return count
