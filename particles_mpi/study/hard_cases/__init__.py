"""The catalogue of hard cases: what naive programs do there, what must hold here, and what is measured.

A case is a function of a `Bench`, which builds simulations in one mode and dimension on a communicator. It returns what it
measured, as a text, and whether that is what must hold. `python -m particles_mpi study hard-cases` prints the table, the
tests run the same functions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from hashlib import sha256
from importlib import import_module
from typing import Any

from particles_mpi import Scene, Simulation
from particles_mpi.measure import snapshot
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Particles

CHAPTERS = ("forces", "contacts", "crowds", "resting", "orbits", "numbers", "spread")
MODES = ("rewind", "event")


@dataclass
class Bench:
    """Builds simulations, and remembers them, so that their bits can be compared with those of one rank."""

    mode: str | None
    dimension: int
    comm: Any = None
    built: list[Simulation] = field(default_factory=list)

    def simulate(self, **scene: Any) -> Simulation:
        """A simulation of the scene in this mode and dimension (unless it says another)."""
        effects = {name: dict(options) for name, options in scene.pop("effects", {}).items()}
        if self.mode and "collisions" in effects:
            effects["collisions"]["mode"] = self.mode
        sim = Simulation(Scene(**{"dimension": self.dimension, "effects": effects, **scene}), comm=self.comm)
        self.built.append(sim)
        return sim

    def digest(self) -> str:
        """A hash of the last states of all simulations: every bit of every field. Collective."""
        text = sha256()
        for sim in self.built:
            p = everyone(sim)
            for name in p.arrays:
                text.update(name.encode() + p[name].tobytes())
        return text.hexdigest()


def everyone(sim: Simulation) -> Particles:
    """All particles in id order, on every rank. Collective."""
    return snapshot.gather_all(sim.ranks, sim.particles)


@dataclass(frozen=True)
class Case:
    """One row of the table, or several: a mode and a dimension each. `long`: minutes, not seconds."""

    name: str
    naive: str
    must: str
    measure: Callable[[Bench], tuple[str, bool]]
    modes: tuple[str | None, ...]
    dimensions: tuple[int, ...]
    long: bool


@dataclass(frozen=True)
class Outcome:
    """What a case came to in one mode and dimension."""

    case: Case
    mode: str | None
    dimension: int
    measured: str
    holds: bool
    same_bits: bool

    @property
    def passed(self) -> bool:
        return self.holds and self.same_bits


CATALOGUE: list[Case] = []


def case(
    name: str,
    naive: str,
    must: str,
    modes: tuple[str | None, ...] = MODES,
    dimensions: tuple[int, ...] = (2, 3),
    long: bool = False,
) -> Callable[[Callable[[Bench], tuple[str, bool]]], Callable[[Bench], tuple[str, bool]]]:
    """Enters a function into the catalogue."""

    def enter(measure: Callable[[Bench], tuple[str, bool]]) -> Callable[[Bench], tuple[str, bool]]:
        CATALOGUE.append(Case(name, naive, must, measure, modes, dimensions, long))
        return measure

    return enter


def catalogue() -> list[Case]:
    """All cases, in the order of the table."""
    for chapter in CHAPTERS:
        import_module(f"particles_mpi.study.hard_cases.{chapter}")
    return CATALOGUE


def settings(cases: list[Case]) -> Iterator[tuple[Case, str | None, int]]:
    """Each case in each of its modes and dimensions."""
    for one in cases:
        for mode in one.modes:
            for dimension in one.dimensions:
                yield one, mode, dimension


def examine(one: Case, mode: str | None, dimension: int, comm: Any = None) -> Outcome:
    """Run a case; on several ranks also on this rank alone, for the bits must be the same. Collective."""
    bench = Bench(mode, dimension, comm)
    measured, holds = one.measure(bench)
    same_bits, ranks = True, Communicator(comm)
    if ranks.size > 1:
        alone = Bench(mode, dimension, Communicator.alone().comm)
        one.measure(alone)
        same_bits = bool(ranks.allreduce_min(float(bench.digest() == alone.digest()))[0])
    return Outcome(one, mode, dimension, measured, bool(ranks.allreduce_min(float(holds))[0]), same_bits)
