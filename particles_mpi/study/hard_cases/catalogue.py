"""What a case is, all cases, and how one is run.

A case is a function of a `CaseRun`, which builds simulations in one mode and dimension on a communicator. It returns what it
measured, as a text, and whether that is what must hold. The command prints the table, the tests run the same functions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from hashlib import sha256
from importlib import import_module
from typing import Any, NamedTuple

from particles_mpi import Scene, Simulation
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Particles
from particles_mpi.study.experiment import everyone

CHAPTERS = ("contacts", "crowds", "resting", "orbits", "extremes")
MODES = ("rewind", "event")
Effects = dict[str, dict[str, Any]]  # options by name


@dataclass
class CaseRun:
    """Builds simulations in a mode of collisions and a dimension, and keeps them, so that their bits can be compared."""

    mode: str | None
    dimension: int
    comm: Any = None
    built: list[Simulation] = field(default_factory=list)

    def simulate(
        self, particles: list[dict[str, Any]], step: float, steps: int = 1, effects: Effects | None = None,
        integrator: str = "leapfrog", **scene: Any,
    ) -> Simulation:  # fmt: skip
        """A simulation in this mode and dimension; `scene`: other tables than those of time and particles. Collective."""
        effects = {name: dict(options) for name, options in (effects or {}).items()}
        if self.mode and "collisions" in effects:
            effects["collisions"]["mode"] = self.mode
        time = {"step": step, "steps": steps, "integrator": integrator}
        tables = {"dimension": self.dimension, "time": time, "particles": particles, "effects": effects, **scene}
        self.built.append(Simulation(Scene.from_dict(tables), comm=self.comm))
        return self.built[-1]

    def finish(self, *arguments: Any, **scene: Any) -> tuple[Simulation, Particles]:
        """A simulation that has been run to its end, and all its particles there. Collective."""
        sim = self.simulate(*arguments, **scene)
        sim.run()
        return sim, everyone(sim)

    def point(self, *coordinates: float, rest: float = 0.0) -> list[float]:
        """The point with these first coordinates; all others are `rest`."""
        return [*coordinates, *[rest] * (self.dimension - len(coordinates))][: self.dimension]

    def upright(self, height: float, rest: float = 0.0) -> list[float]:
        """The point at this height, the last coordinate; all others are `rest`."""
        return [rest] * (self.dimension - 1) + [height]

    def cube(self, edge: float, lower: float = 0.0) -> dict[str, Any]:
        """A box of this edge."""
        return {"lower": [lower] * self.dimension, "upper": [lower + edge] * self.dimension}

    def in_passes(self, many: int) -> dict[str, Any]:
        """Options of collisions by which `rewind` gets through a chain of contacts in one step."""
        return {"passes": many} if self.mode == "rewind" else {}

    def digest(self) -> str:
        """A hash of the last states of all simulations: every bit of every field. Collective."""
        text = sha256()
        for p in map(everyone, self.built):
            for name in p.arrays:
                text.update(name.encode() + p[name].tobytes())
        return text.hexdigest()


Finding = tuple[str, bool]  # what was measured, and whether it is what must hold
Measure = Callable[[CaseRun], Finding]


class Case(NamedTuple):
    """One row of the table, or several: a mode and a dimension each. `long`: minutes, not seconds."""

    name: str
    naive: str
    must: str
    measure: Measure
    modes: tuple[str | None, ...] = MODES
    dimensions: tuple[int, ...] = (2, 3)
    long: bool = False


class Outcome(NamedTuple):
    """What a case came to in one mode and dimension."""

    case: Case
    mode: str | None
    dimension: int
    measured: str
    holds: bool
    same_bits: bool


CATALOGUE: list[Case] = []


def case(name: str, naive: str, must: str, **where: Any) -> Callable[[Measure], Measure]:
    """Enters a function into the catalogue; `where`: modes, dimensions, long."""

    def enter(measure: Measure) -> Measure:
        CATALOGUE.append(Case(name, naive, must, measure, **where))
        return measure

    return enter


def catalogue() -> list[Case]:
    """All cases, in the order of the table."""
    for chapter in CHAPTERS:
        import_module(f"particles_mpi.study.hard_cases.{chapter}")
    return CATALOGUE


def settings(cases: list[Case]) -> Iterator[tuple[Case, str | None, int]]:
    """Each case in each of its modes and dimensions."""
    return ((one, mode, dimension) for one in cases for mode in one.modes for dimension in one.dimensions)


def examine(one: Case, mode: str | None, dimension: int, comm: Any = None) -> Outcome:
    """Run a case; on several ranks also on this rank alone, for the bits must be the same. Collective."""
    run, ranks, same_bits = CaseRun(mode, dimension, comm), Communicator(comm), True
    measured, holds = one.measure(run)
    if ranks.size > 1:
        alone = CaseRun(mode, dimension, Communicator.alone().comm)
        one.measure(alone)
        same_bits = bool(ranks.allreduce_min(float(run.digest() == alone.digest()))[0])
    return Outcome(one, mode, dimension, measured, bool(ranks.allreduce_min(float(holds))[0]), same_bits)
