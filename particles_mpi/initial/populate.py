"""The particles at the start of a scene: all of them, in id order, the same on every rank.

Random numbers are keyed by (seed, population, quantity), so that changing the radii of one population leaves its
velocities, and all other populations, as they were.
"""

from __future__ import annotations

import os
import warnings as python_warnings
from collections.abc import Mapping
from itertools import pairwise
from math import inf
from typing import Any
from zlib import crc32

import numpy as np
from pydantic import ValidationError

from particles_mpi.contacts.walls import no_planes
from particles_mpi.errors import SceneError, listed
from particles_mpi.initial.checks import check_start, divided_masses
from particles_mpi.initial.placement import JAMMED, MOST_TRIES, Container, RandomAddition, lattice, packing
from particles_mpi.initial.plummer import plummer_places, plummer_velocities
from particles_mpi.particles import FIELDS, OWN, Array, Particles, default_values
from particles_mpi.scene.active import ActiveEffects, fields_of
from particles_mpi.scene.model import LARGEST, faults_of
from particles_mpi.scene.schema import Population, Scene, periodic_length

PER_PARTICLE = ("position", "velocity", "radius", "mass", "fixed", "drag", "acceleration")
STREAMS = {name: k for k, name in enumerate(("position", "velocity", "speed", "radius", "mass", "drag"))}


def populate(scene: Scene) -> tuple[Particles, list[str]]:
    """(particles, warnings) of a scene, row i being id i; SceneError with one line for each fault. The same on every rank."""
    try:
        with np.errstate(over="ignore", under="ignore"):
            return Populator(scene, dict(enumerate(scene.particles))).populate()
    except MemoryError:
        raise SceneError("particles: not enough memory for them") from None


def room_of(scene: Scene) -> Container:
    """Box and walls of a scene as arrays; an open side is infinite."""
    box, effects = scene.box, ActiveEffects(scene, switched_off=True)
    lower, upper = np.full((2, scene.dimension), [[-inf], [inf]]) if box is None else np.array([box.lower, box.upper], float)
    walls, solid = effects.walls.planes if effects.walls else no_planes(scene.dimension), effects.pairs is not None
    bounded = solid or len(walls.point) > 0
    return Container(lower, upper, periodic_length(scene), walls.point, walls.normal, solid, bounded)


def add_population(
    scene: Scene, everyone: Particles, table: Mapping[str, Any], next_id: int, number: int
) -> tuple[Particles, list[str]]:
    """(`everyone`, in id order, and behind them those of one more population, warnings); the same on every rank.

    `table`: the keys of a `[[particles]]` table, whose values may be arrays, and fields of the user's own; `number` tells this
    population from others, in messages and in random numbers.
    """
    key = f"particles[{number}]"
    plain = {name: value.tolist() if isinstance(value, np.ndarray | np.generic) else value for name, value in table.items()}
    own = {name: plain.pop(name) for name in everyone.arrays.keys() - set(fields_of(scene)) - set(OWN) if name in plain}
    try:
        population = Population.model_validate(plain)
    except ValidationError as error:
        raise SceneError(faults_of(error, Population, (key,))) from None
    faults = scene.population_faults(key, population)
    if faults:
        raise SceneError(faults)
    before = len(everyone)
    with np.errstate(over="ignore", under="ignore"):
        particles, warnings = Populator(scene, {number: population}, everyone, next_id).populate()
    for name, value in own.items():
        try:
            particles[name][before:] = value
        except ValueError:
            raise SceneError(f"{key}.{name}: not a value for each of {len(particles) - before} particles") from None
    return particles, warnings


class Populator:
    """Builds populations (by number) one quantity after the other, behind those that are `there`, with ids from `next_id` on."""

    def __init__(self, scene: Scene, populations: dict[int, Population], there: Particles | None = None, next_id: int = 0):
        self.scene, self.populations, self.there, self.next_id = scene, populations, there, next_id
        self.faults: list[str] = []
        self.files: dict[tuple[int, str], Array] = {}

    def populate(self) -> tuple[Particles, list[str]]:
        scene, there, d = self.scene, self.there, self.scene.dimension
        self.check_box()
        counts = [self.count_of(number, p) for number, p in self.populations.items()]
        self.stop_if_faulty()
        self.check_memory(counts)
        before = 0 if there is None else len(there)
        ends = before + np.cumsum([0, *counts])
        n = int(ends[-1])
        self.arrays = {name: default_values(name, n, d) for name in fields_of(scene)}
        for name, column in there.arrays.items() if there is not None else ():
            if name not in self.arrays:  # attached by the user
                self.arrays[name] = np.zeros((n, *column.shape[1:]), column.dtype)
            self.arrays[name][:before] = column
        self.arrays["id"][before:] = self.next_id + np.arange(n - before)
        self.rows = {number: slice(int(a), int(b)) for number, (a, b) in zip(self.populations, pairwise(ends))}
        for number, population in self.populations.items():
            self.scalars(number, population)
        self.stop_if_faulty()
        room = room_of(scene)
        self.positions(room)
        for number, population in self.populations.items():
            self.velocities(number, population)
        self.stop_if_faulty()
        particles = Particles(d, self.arrays)
        self.faults, warnings = check_start(scene, particles, room, before)
        self.stop_if_faulty()
        return particles, warnings

    def stop_if_faulty(self) -> None:
        if self.faults:
            raise SceneError(self.faults)

    def check_box(self) -> None:
        """Numbers that are too large to count with."""
        box = self.scene.box
        if self.scene.seed >= 2**64:
            self.faults.append("seed: must be below 2^64")
        if box is not None and max(map(abs, box.lower + box.upper)) > LARGEST:
            self.faults.append(f"box: a number is beyond {LARGEST:g}")
        elif box is not None and not 1.0 / LARGEST < (volume := np.subtract(box.upper, box.lower).prod()) < inf:
            self.faults.append(f"box: its volume {volume:g} is too small or too large to count with")

    def check_memory(self, counts: list[int]) -> None:
        """A count with a zero too many should be a fault, and not a killed process."""
        total = sum(counts)
        need = total * 8 * (4 + 3 * self.scene.dimension)
        have = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        if need > have or total > 2**31 - 1:
            k = list(self.populations)[int(np.argmax(np.array(counts, float)))]
            raise SceneError(
                f"particles[{k}].count: {total} particles in all need {need / 1e9:.3g} GB, this machine has {have / 1e9:.3g} GB"
            )

    def random(self, number: int, quantity: str) -> np.random.Generator:
        """The stream of one quantity of one population."""
        own = number * len(STREAMS) + STREAMS[quantity] if quantity in STREAMS else crc32(f"{number} {quantity}".encode()) << 31
        return np.random.Generator(np.random.Philox(key=np.array([self.scene.seed, own], np.uint64)))

    def count_of(self, number: int, population: Population) -> int:
        """Particles of a population: `count`, or the length of its lists, which must agree."""
        given = {name: getattr(population, name) for name in PER_PARTICLE} | (population.model_extra or {})
        vectors = {"velocity", "acceleration"} | {name for name, column in self.scene.columns.items() if column.vector}
        lengths = {} if population.count is None else {"count": population.count}
        for name, value in given.items():
            if isinstance(value, dict) and "file" in value:
                table = self.read(f"particles[{number}].{name}", value["file"])
                if table is None:
                    return 0
                self.files[number, name] = table
                lengths[name] = len(table)
            elif isinstance(value, list) and (name not in vectors or (value and isinstance(value[0], list))):
                lengths[name] = len(value)
        if not lengths:
            self.faults.append(f"particles[{number}].count: missing")
            return 0
        reference, count = next(iter(lengths.items()))
        told = f"count = {count}" if reference == "count" else f"{reference} has {count}"
        self.faults += [
            f"particles[{number}].{name}: {length} entries, but {told}" for name, length in lengths.items() if length != count
        ]
        return count

    def read(self, key: str, name: str) -> Array | None:
        """The first d columns of a CSV file; a first line that is no number is a header."""
        path, d, header = self.scene.folder / name, self.scene.dimension, 0
        try:
            with open(path, encoding="utf-8") as file:
                first = file.readline().split(",")[0].strip()
            try:
                float(first)
            except ValueError:
                header = 1
            with python_warnings.catch_warnings():
                python_warnings.simplefilter("ignore", UserWarning)  # an empty file: told below
                table = np.loadtxt(path, delimiter=",", skiprows=header, usecols=range(d), ndmin=2, encoding="utf-8")
        except OSError as error:
            fault = f"{path} cannot be read ({error.strerror})"
        except ValueError as error:
            fault = f"{path}: {' '.join(str(error).split())}"
        else:
            bad = np.flatnonzero(~np.isfinite(table).all(axis=1))
            if len(table) and not len(bad):
                return table
            fault = f"{path}: {listed((bad + 1 + header).tolist(), 'line')} not finite" if len(bad) else f"{path} holds no rows"
        self.faults.append(f"{key}: {fault}")
        return None

    def scalars(self, number: int, population: Population) -> None:
        """radius, mass, fixed, and the fields of effects."""
        key, rows, arrays = f"particles[{number}]", self.rows[number], self.arrays
        arrays["fixed"][rows] = population.fixed
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
        for name, needed in divided_masses(self.scene, arrays["fixed"][rows]).items():
            massless = needed & (arrays["mass"][rows] == 0.0)
            self.refuse(f"{key}.mass", rows, massless, f"0, but [effects.{name}] divides by it, for")

    def drawn(self, number: int, name: str, value: Any) -> Any:
        """A value, or random ones for a population within a range."""
        if not isinstance(value, dict):
            return value
        rows = self.rows[number]
        return value["min"] + self.random(number, name).random(rows.stop - rows.start) * (value["max"] - value["min"])

    def fill(self, number: int, name: str, value: Any) -> None:
        """A field of a population from a number, a list or a range."""
        rows, array = self.rows[number], self.arrays[name]
        try:
            array[rows] = np.asarray(self.drawn(number, name, value), float)
        except OverflowError:
            array[rows] = LARGEST * 2.0
        self.refuse(f"particles[{number}].{name}", rows, np.abs(array[rows]) > LARGEST, f"beyond {LARGEST:g} for")
        if name == "mass":  # 1/m must be a number too
            light = (array[rows] > 0.0) & (array[rows] < 1.0 / LARGEST)
            self.refuse(f"particles[{number}].mass", rows, light, f"below {1.0 / LARGEST:g} for")

    def refuse(self, key: str, rows: slice, bad: Array, why: str) -> None:
        """A fault that names the particles of `rows` that are `bad` (n,) or (n, d)."""
        which = np.flatnonzero(bad.any(axis=1) if bad.ndim == 2 else bad)
        if len(which):
            self.faults.append(f"{key}: {why} {listed(self.arrays['id'][rows][which])}")

    def positions(self, room: Container) -> None:
        """Lists and files first, then lattices, then random places around them, the largest spheres first."""
        x, radius, scattered = self.arrays["position"], self.arrays["radius"], []
        known = np.ones(len(x), bool)
        for number, population in self.populations.items():
            rows, given = self.rows[number], population.position
            if given == "random":
                scattered.append(number)
                known[rows] = False
            elif given == "lattice":
                count = rows.stop - rows.start
                places = lattice(count, float(radius[rows].max(initial=0.0)), room)
                if places is None:
                    why = f"{count} spheres do not fit (packing fraction {packing(radius[rows], room):.3g})"
                    self.faults.append(f"particles[{number}].position: lattice: {why}")
                else:
                    x[rows] = places
            elif isinstance(given, dict) and "plummer" in given:
                x[rows] = plummer_places(self.random(number, "position"), given["plummer"], self.arrays["mass"][rows])
            else:
                self.fill(number, "position", self.files.get((number, "position"), given))
        self.stop_if_faulty()
        if scattered:
            addition = RandomAddition(room, x, radius, np.flatnonzero(known))
            for number in sorted(scattered, key=lambda k: -radius[self.rows[k]].max(initial=0.0)):
                if fault := self.scatter(room, number, addition):
                    self.faults.append(f"particles[{number}].position: random: {fault}")
                    return

    def scatter(self, room: Container, number: int, addition: RandomAddition) -> str:
        """Random places for a population; returns why there are none, or "" ."""
        rows = self.rows[number]
        count, own, advice = rows.stop - rows.start, self.arrays["radius"][rows], "use lattice, or fewer or smaller spheres"
        wide = np.flatnonzero((room.length == 0.0) & (2.0 * own.max(initial=0.0) > room.upper - room.lower))
        if room.bounded and len(wide):
            return f"spheres of radius {own.max():g} do not fit into the box on axis {wide[0]}"
        most = JAMMED.get(self.scene.dimension, inf)
        if room.solid and count > 1000 and own.min() == own.max() and packing(own, room) > most:
            said = f"{count} spheres have packing fraction {packing(own, room):.3g}, above the {most} at which"
            return f"{said} random places run out; {advice}"
        placed, tries = addition.place(np.arange(rows.start, rows.stop), self.random(number, "position"))
        if placed == count:
            return ""
        fraction = packing(self.arrays["radius"], room)
        said = f"only {placed} of {count} spheres fit after {max(tries, MOST_TRIES)} tries (packing fraction {fraction:.3g})"
        return f"{said}; {advice}"

    def velocities(self, number: int, population: Population) -> None:
        """Explicit, or drawn; fixed particles have none."""
        rows, value, key = self.rows[number], population.velocity, f"particles[{number}].velocity"
        v, fixed = self.arrays["velocity"][rows], self.arrays["fixed"][rows] != 0
        if value is None or not len(v):
            return
        if isinstance(value, list) or "file" in value:
            self.fill(number, "velocity", self.files.get((number, "velocity"), value))
            self.refuse(key, rows, fixed & (v != 0.0).any(axis=1), "not zero, but fixed:")
            return
        random = self.random(number, "velocity")
        if value == "equilibrium":
            gravity = self.scene.effects["mutual_gravity"]
            G = self.scene.G if gravity.G is None else gravity.G
            x, mass = self.arrays["position"][rows], self.arrays["mass"][rows]
            v[:] = plummer_velocities(random, x, population.position["plummer"], mass, G)
        elif fixed.all() and value not in ({"speed": 0}, {"temperature": 0}):
            self.refuse(key, rows, fixed, "given, but fixed:")
            return
        elif "temperature" in value:
            self.warm(key, rows, float(value["temperature"]), random.standard_normal(v.shape))
        else:
            direction = random.standard_normal(v.shape)
            norm = np.sqrt((direction**2).sum(axis=1))
            v[:] = direction * (self.drawn(number, "speed", value["speed"]) / np.where(norm > 0.0, norm, 1.0))[:, None]
        v[fixed] = 0.0
        self.refuse(key, rows, ~(np.abs(v) <= LARGEST), f"beyond {LARGEST:g} for")

    def warm(self, key: str, rows: slice, temperature: float, normal: Array) -> None:
        """Maxwellian: variance T/m a component, without drift of the whole, and scaled so that sum m v^2 = d N T."""
        mass, movable = self.arrays["mass"][rows], self.arrays["fixed"][rows] == 0
        self.refuse(key, rows, movable & (mass == 0.0), "a temperature needs a mass:")
        if self.faults:
            return
        m = mass[movable][:, None]
        v = normal[movable] * np.sqrt(temperature / m)
        if len(v) > 1:
            v -= (m * v).sum(axis=0) / m.sum()
            energy = float((m * v**2).sum())
            if energy > 0.0:
                v *= np.sqrt(v.size * temperature / energy)
        self.arrays["velocity"][rows][movable] = v
