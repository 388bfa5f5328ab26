"""The particles at the start of a scene. Each rank makes a block of ids; the result is the same on any number of ranks.

Random numbers are keyed by (seed, population, quantity, number of the particle), so that changing the radii of one population
leaves its velocities, and all other populations, as they were.
"""

import os
from collections.abc import Mapping
from functools import partial
from itertools import pairwise
from math import inf
from typing import Any

import numpy as np
from pydantic import ValidationError

from particles_mpi.errors import SceneError
from particles_mpi.initial.checks import check_start, divided_masses
from particles_mpi.initial.container import Container, packing, room_of, size
from particles_mpi.initial.faults import Faults
from particles_mpi.initial.lattices import lattice
from particles_mpi.initial.plummer import centered, plummer_points
from particles_mpi.initial.random_addition import JAMMED, RandomAddition
from particles_mpi.initial.random_numbers import draw, normals, stream_key, uniform
from particles_mpi.initial.table_file import Table, read_table
from particles_mpi.initial.velocities import random_velocities
from particles_mpi.kernels import limits
from particles_mpi.parallel.agreement import raising_together
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exact_sum import exact_sums
from particles_mpi.parallel.exchange import by_destination, send_rows
from particles_mpi.particles import FIELDS, OWN, Array, Particles, default_values, moment_of_sphere
from particles_mpi.scene.active import fields_of
from particles_mpi.scene.model import LARGEST, faults_of
from particles_mpi.scene.schema import Population, Scene

PER_PARTICLE = ("position", "velocity", "radius", "mass", "fixed", "drag", "acceleration", "spin", "moment_of_inertia")


def populate(scene: Scene, ranks: Communicator | None = None) -> tuple[Particles, list[str]]:
    """(particles of this rank's share of the ids, in order; warnings) of a scene. Collective; by default one rank has all.

    SceneError, the same on all ranks, with one line for each fault.
    """
    with np.errstate(over="ignore", under="ignore"):
        return Populator(scene, dict(enumerate(scene.particles)), ranks or Communicator.alone()).populate()


def add_population(
    scene: Scene, ranks: Communicator, there: Particles, table: Mapping[str, Any], next_id: int, number: int
) -> tuple[Particles, list[str]]:
    """(this rank's particles that are `there`, and behind them its share of one more population; warnings). Collective.

    `table`: the keys of a `[[particles]]` table, whose values may be arrays, and fields of the user's own; `number` tells this
    population from others, in messages and in random numbers.
    """
    key = f"particles[{number}]"
    plain = plain_table(table)
    own = {name: plain.pop(name) for name in there.arrays.keys() - set(fields_of(scene)) - set(OWN) if name in plain}
    try:
        population = Population.model_validate(plain)
    except ValidationError as error:
        raise SceneError(faults_of(error, Population, (key,))) from None
    faults = scene.population_faults(key, population)
    if faults:
        raise SceneError(faults)
    with np.errstate(over="ignore", under="ignore"):
        populator = Populator(scene, {number: population}, ranks, there, next_id)
        particles, warnings = populator.populate()
    first, total = populator.first, int(populator.ends[-1])
    for name, value in own.items():
        try:
            particles[name][len(there) :] = np.broadcast_to(value, (total, *particles[name].shape[1:]))[first : populator.last]
        except ValueError:
            raise SceneError(f"{key}.{name}: not a value for each of {total} particles") from None
    return particles, warnings


def plain_table(table: Mapping[str, Any]) -> dict[str, Any]:
    """The table with lists and numbers of Python in place of arrays."""
    return {name: value.tolist() if isinstance(value, np.ndarray | np.generic) else value for name, value in table.items()}


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
        self.faults = Faults(ranks)
        self.files: dict[tuple[int, str], Table] = {}

    def populate(self) -> tuple[Particles, list[str]]:
        self.check_box()
        counts = [self.count_of(number, p) for number, p in self.populations.items()]
        self.faults.stop()
        self.check_memory(counts)
        self.counts, self.ends = dict(zip(self.populations, counts)), np.cumsum([0, *counts])
        self.first, self.last = self.ranks.share(int(self.ends[-1]))
        self.before = 0 if self.there is None else len(self.there)
        with raising_together(self.ranks):
            self.arrays = self.columns()
        self.rows = {}  # of this rank, for each population
        for number, (begin, end) in zip(self.populations, pairwise(self.ends.tolist())):
            low, high = (min(max(edge, self.first), self.last) - self.first + self.before for edge in (begin, end))
            self.rows[number] = slice(low, high)
        self.begins = dict(zip(self.populations, self.ends.tolist()))
        for number, population in self.populations.items():
            self.scalars(number, population)
        self.faults.stop()
        room = room_of(self.scene)
        self.positions(room)
        for number, population in self.populations.items():
            self.velocities(number, population)
        self.faults.stop()
        particles = Particles(self.scene.dimension, self.arrays)
        judged = np.ones(len(particles), bool)  # by whether they overlap: those with random places overlap nobody
        for number in self.scattered():
            judged[self.rows[number]] = False
        warnings = check_start(self.scene, particles, room, self.faults, self.before, judged)
        self.faults.stop()
        return particles, warnings

    def columns(self) -> dict[str, Array]:
        """All fields, with what they hold where nothing gives a value."""
        scene, d, n = self.scene, self.scene.dimension, self.before + self.last - self.first
        arrays = {name: default_values(name, n, d) for name in fields_of(scene)}
        for name, column in self.there.arrays.items() if self.there is not None else ():
            if name not in arrays:  # attached by the user
                arrays[name] = np.zeros((n, *column.shape[1:]), column.dtype)
            arrays[name][: self.before] = column
        arrays["id"][self.before :] = self.next_id + np.arange(self.first, self.last)
        return arrays

    def scattered(self) -> list[int]:
        """The populations with random places."""
        return [number for number, population in self.populations.items() if population.position == "random"]

    def check_box(self) -> None:
        """Numbers that are too large to count with."""
        box = self.scene.box
        if self.scene.seed >= 2**64:
            self.faults.add("seed: must be below 2^64")
        if box is not None and max(map(abs, box.lower + box.upper)) > LARGEST:
            self.faults.add(f"box: a number is beyond {LARGEST:g}")
        elif box is not None and not 1.0 / LARGEST < (volume := np.subtract(box.upper, box.lower).prod()) < inf:
            self.faults.add(f"box: its volume {volume:g} is too small or too large to count with")

    def check_memory(self, counts: list[int]) -> None:
        """A count with a zero too many should be a fault, and not a killed process."""
        total, ranks = sum(counts), self.ranks.size
        need = total * 8 * (4 + 3 * self.scene.dimension) / ranks
        have = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        if need > have or total / ranks > limits.MOST:
            k = list(self.populations)[int(np.argmax(np.array(counts, float)))]
            each = f" on each of {ranks} ranks" if ranks > 1 else ""
            raise SceneError(
                f"particles[{k}].count: {total} particles in all need {need / 1e9:.3g} GB{each},"
                f" this machine has {have / 1e9:.3g} GB"
                + (f"; more than {limits.MOST} particles on a rank: use more ranks" if total / ranks > limits.MOST else "")
            )

    def numbers(self, number: int) -> tuple[int, int]:
        """(first, last + 1) of this rank's particles of a population, counted from its first one."""
        begin, rows = self.begins[number], self.rows[number]
        first = rows.start - self.before + self.first - begin
        return first, first + rows.stop - rows.start

    def count_of(self, number: int, population: Population) -> int:
        """Particles of a population: `count`, or the length of its lists, which must agree."""
        given = {name: getattr(population, name) for name in PER_PARTICLE} | (population.model_extra or {})
        vectors = {"velocity", "acceleration", *(["spin"] if self.scene.dimension == 3 else [])} | {
            name for name, column in self.scene.columns.items() if column.vector
        }
        lengths = {} if population.count is None else {"count": population.count}
        for name, value in given.items():
            if isinstance(value, dict) and "file" in value:
                table = read_table(self.ranks, self.scene.folder / value["file"], self.scene.dimension)
                if isinstance(table, str):
                    self.faults.add(f"particles[{number}].{name}: {table}")
                    return 0
                self.files[number, name] = table
                lengths[name] = table.total
            elif isinstance(value, list) and (name not in vectors or (value and isinstance(value[0], list))):
                lengths[name] = len(value)
        if not lengths:
            self.faults.add(f"particles[{number}].count: missing")
            return 0
        reference, count = next(iter(lengths.items()))
        told = f"count = {count}" if reference == "count" else f"{reference} has {count}"
        for name, length in lengths.items():
            if length != count:
                self.faults.add(f"particles[{number}].{name}: {length} entries, but {told}")
        return count

    def scalars(self, number: int, population: Population) -> None:
        """radius, mass, fixed, and the fields of effects."""
        key, rows, arrays = f"particles[{number}]", self.rows[number], self.arrays
        arrays["fixed"][rows] = self.mine(number, "fixed", population.fixed)
        given = {"radius": population.radius, "mass": 1.0 if population.mass is None else population.mass}
        if "drag" in arrays:
            given["drag"] = self.scene.effects["drag"].rate if population.drag is None else population.drag
        if "acceleration" in arrays:
            given["acceleration"] = population.acceleration
        given |= {name: (population.model_extra or {}).get(name) for name in self.scene.columns}  # of effects from outside
        for name, value in given.items():
            if value is not None:
                self.fill(number, name, value)
                least = FIELDS[name].least
                low = f"below {least:g} for" if name in self.scene.columns else "negative for"
                self.refuse(f"{key}.{name}", rows, arrays[name][rows] < least, low)
        if "spin" in arrays:
            self.spins(number, population)
        for name, needed in divided_masses(self.scene, arrays["fixed"][rows]).items():
            massless = needed & (arrays["mass"][rows] == 0.0)
            self.refuse(f"{key}.mass", rows, massless, f"0, but [effects.{name}] divides by it, for")

    def spins(self, number: int, population: Population) -> None:
        """Moments of inertia, of solid spheres if not given, and spins; what is fixed has none."""
        key, rows, arrays = f"particles[{number}]", self.rows[number], self.arrays
        d, value = self.scene.dimension, population.spin
        moment = arrays["moment_of_inertia"]
        moment[rows] = moment_of_sphere(arrays["mass"][rows], arrays["radius"][rows], d)
        if population.moment_of_inertia is not None:
            self.fill(number, "moment_of_inertia", population.moment_of_inertia)
            self.refuse(f"{key}.moment_of_inertia", rows, moment[rows] < 0.0, "negative for")
        if value is None:
            return
        fixed, spin = arrays["fixed"][rows] != 0, arrays["spin"]
        if isinstance(value, dict):
            normal = draw(
                stream_key(self.scene.seed, number, "spin"), *self.numbers(number), partial(normals, width=spin.shape[1])
            )
            own, turns = moment[rows], ~fixed & (moment[rows] > 0.0)
            spin[rows] = normal * np.sqrt(value["temperature"] / np.where(turns, own, np.inf))[:, None]
            return
        self.fill(number, "spin", value if d == 3 else [[s] for s in value] if isinstance(value, list) else value)
        self.refuse(f"{key}.spin", rows, fixed & (spin[rows] != 0.0).any(axis=1), "not zero, but fixed:")

    def mine(self, number: int, name: str, value: Any) -> Any:
        """This rank's part of a value of a population: of a list, a file, random numbers in a range; a number is for all."""
        first, last = self.numbers(number)
        if isinstance(value, dict) and "file" in value:
            table = self.files[number, name]
            return self.own_rows(table.values, self.begins[number] + table.first)
        if isinstance(value, dict):
            key = stream_key(self.scene.seed, number, name)
            return value["min"] + draw(key, first, last, uniform) * (value["max"] - value["min"])
        if isinstance(value, list) and (
            not (FIELDS[name].vector or FIELDS[name].rotation) or isinstance(next(iter(value), None), list)
        ):
            return value[first:last]
        return value

    def own_rows(self, values: Array, first: int) -> Array:
        """Of rows that the ranks hold in order, this rank's beginning with number `first`, those of the numbers it builds."""
        owner = self.ranks.sharer(int(self.ends[-1]), np.arange(first, first + len(values)))
        return send_rows(self.ranks, {"values": values}, *by_destination(owner, self.ranks.size))[0]["values"]

    def fill(self, number: int, name: str, value: Any) -> None:
        """A field of a population from a number, a list, a file or a range."""
        rows, array = self.rows[number], self.arrays[name]
        mine = self.mine(number, name, value)
        try:
            if rows.stop > rows.start:
                array[rows] = np.asarray(mine, float)
        except OverflowError:
            array[rows] = LARGEST * 2.0
        self.refuse(f"particles[{number}].{name}", rows, np.abs(array[rows]) > LARGEST, f"beyond {LARGEST:g} for")
        if name == "mass":  # 1/m must be a number too
            light = (array[rows] > 0.0) & (array[rows] < 1.0 / LARGEST)
            self.refuse(f"particles[{number}].mass", rows, light, f"below {1.0 / LARGEST:g} for")

    def refuse(self, key: str, rows: slice, bad: Array, why: str) -> None:
        """A fault that names the particles of `rows` that are `bad` (n,) or (n, d). Collective."""
        which = np.flatnonzero(bad.any(axis=1) if bad.ndim == 2 else bad)
        self.faults.name(f"{key}: {why} ", self.arrays["id"][rows][which])

    def positions(self, room: Container) -> None:
        """Lists and files first, then lattices, then random places around them, the largest spheres first."""
        x, radius = self.arrays["position"], self.arrays["radius"]
        largest = {k: float(self.ranks.allreduce_max(radius[rows].max(initial=0.0))[0]) for k, rows in self.rows.items()}
        for number, population in self.populations.items():
            rows, given, (first, last) = self.rows[number], population.position, self.numbers(number)
            if given == "lattice":
                places = lattice(self.counts[number], largest[number], room, first, last)
                if places is None:
                    fraction = self.packing(radius[rows], room)
                    why = f"{self.counts[number]} spheres do not fit (packing fraction {fraction:.3g})"
                    self.faults.add(f"particles[{number}].position: lattice: {why}")
                else:
                    x[rows] = places
            elif isinstance(given, dict) and "plummer" in given:
                key = stream_key(self.scene.seed, number, "position")
                points = draw(key, first, last, partial(plummer_points, a=given["plummer"]))
                x[rows] = centered(self.ranks, points, self.arrays["mass"][rows])
            elif given != "random":
                self.fill(number, "position", given)
        self.faults.stop()
        if scattered := self.scattered():
            known = np.ones(len(x), bool)
            for number in scattered:
                known[self.rows[number]] = False
            addition = RandomAddition(self.ranks, room, x[known], radius[known], [radius[~known]])
            for number in sorted(scattered, key=lambda k: -largest[k]):
                if fault := self.scatter(room, number, addition, largest[number]):
                    self.faults.add(f"particles[{number}].position: random: {fault}")
                    return

    def packing(self, radius: Array, room: Container) -> float:
        """The packing fraction of spheres of all ranks. Collective."""
        return packing(exact_sums(self.ranks, [(radius / size(room)) ** self.scene.dimension])[0], room)

    def scatter(self, room: Container, number: int, addition: RandomAddition, largest: float) -> str:
        """Random places for a population; returns why there are none, or "" . Collective."""
        rows, advice = self.rows[number], "use lattice, or fewer or smaller spheres"
        own = self.arrays["radius"][rows]
        smallest = float(self.ranks.allreduce_min(own.min(initial=inf))[0])
        wide = np.flatnonzero((room.length == 0.0) & (2.0 * largest > room.upper - room.lower))
        if room.bounded and len(wide):
            return f"spheres of radius {largest:g} do not fit into the box on axis {wide[0]}"
        most, fraction = JAMMED.get(self.scene.dimension, inf), self.packing(own, room)
        count = self.counts[number]
        if room.solid and count > 1000 and smallest == largest and fraction > most:
            said = f"{count} spheres have packing fraction {fraction:.3g}, above the {most} at which"
            return f"{said} random places run out; {advice}"
        key = int(np.random.Philox(key=stream_key(self.scene.seed, number, "position")).random_raw())
        self.arrays["position"][rows], missing = addition.place(key, np.arange(*self.numbers(number)), own)
        if not missing:
            return ""
        fraction = self.packing(self.arrays["radius"], room)
        said = f"only {count - missing} of {count} spheres fit after {addition.tries} tries (packing fraction {fraction:.3g})"
        return f"{said}; {advice}"

    def velocities(self, number: int, population: Population) -> None:
        """Explicit, or drawn; fixed particles have none."""
        rows, value, key = self.rows[number], population.velocity, f"particles[{number}].velocity"
        fixed = self.arrays["fixed"][rows] != 0
        if value is None:
            return
        if isinstance(value, list) or "file" in value:
            self.fill(number, "velocity", value)
            self.refuse(key, rows, fixed & (self.arrays["velocity"][rows] != 0.0).any(axis=1), "not zero, but fixed:")
            return
        movable = int(self.ranks.allreduce_sum(np.count_nonzero(~fixed))[0])
        if value != "equilibrium" and not movable and value not in ({"speed": 0}, {"temperature": 0}):
            self.refuse(key, rows, fixed, "given, but fixed:")
            return
        if isinstance(value, dict) and "temperature" in value:
            massless = ~fixed & (self.arrays["mass"][rows] == 0.0)
            self.refuse(key, rows, massless, "a temperature needs a mass:")
            if self.faults.found:
                return
        own = {name: self.arrays[name][rows] for name in ("position", "mass", "fixed")}
        v = random_velocities(self.ranks, self.scene, number, population, own, self.numbers(number))
        v[fixed] = 0.0
        self.arrays["velocity"][rows] = v
        self.refuse(key, rows, ~(np.abs(v) <= LARGEST), f"beyond {LARGEST:g} for")
