"""What a case is, the catalogue of all cases, and how a case is run.

A case is a function of a `CaseRun`, which builds simulations in one mode and dimension on a communicator. It returns what it
measured, as a text, and whether that is what must hold. `study hard-cases` prints the table, the tests run the same functions.
"""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from particles_mpi import Scene, Simulation
from particles_mpi.errors import SceneError
from particles_mpi.output.files import make_folder, write_text
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Array, Particles
from particles_mpi.run.console import Screen
from particles_mpi.study.experiment import all_particles

CASE_MODULES = ("contacts", "crowds", "resting", "rough", "orbits", "extremes")
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
        """Return a simulation in this mode and dimension; `scene`: further tables of the scene. Collective."""
        effects = {name: dict(options) for name, options in (effects or {}).items()}
        if self.mode and "collisions" in effects:
            effects["collisions"]["mode"] = self.mode
        time = {"step": step, "steps": steps, "integrator": integrator}
        tables = {"dimension": self.dimension, "time": time, "particles": particles, "effects": effects, **scene}
        self.built.append(Simulation(Scene.from_dict(tables), comm=self.comm))
        return self.built[-1]

    def finish(self, *arguments: Any, **scene: Any) -> tuple[Simulation, Particles]:
        """Run a simulation to its end; returns it and all its particles. Collective."""
        sim = self.simulate(*arguments, **scene)
        sim.run()
        return sim, all_particles(sim)

    def point(self, *coordinates: float, rest: float = 0.0) -> list[float]:
        """Return the point with these first coordinates; all others are `rest`."""
        return [*coordinates, *[rest] * (self.dimension - len(coordinates))][: self.dimension]

    def upright(self, height: float, rest: float = 0.0) -> list[float]:
        """Return the point with this last coordinate, the height; all others are `rest`."""
        return [rest] * (self.dimension - 1) + [height]

    def cube(self, edge: float, lower: float = 0.0) -> dict[str, Any]:
        """Return the table of a box with this edge."""
        return {"lower": [lower] * self.dimension, "upper": [lower + edge] * self.dimension}

    def in_passes(self, many: int) -> dict[str, Any]:
        """Return options of collisions with which `rewind` gets through a chain of contacts in one step."""
        return {"passes": many} if self.mode == "rewind" else {}

    def digest(self) -> str:
        """Return a hash of every bit of the final states of all simulations. Collective."""
        text = sha256()
        for p in map(all_particles, self.built):
            for name in p.arrays:
                text.update(name.encode() + p[name].tobytes())
        return text.hexdigest()


Finding = tuple[str, bool]  # what was measured, and whether it is what must hold
CaseFunction = Callable[[CaseRun], Finding]


class Case(NamedTuple):
    """One row of the table, or several: one for each of its modes and dimensions.

    `naive`: what naive programs do; `must`: what must hold here; `modes`: of collisions, None for a case without them;
    `dimensions`: in which it is run; `long`: it takes minutes, not seconds.
    """

    name: str
    naive: str
    must: str
    function: CaseFunction
    modes: tuple[str | None, ...] = MODES
    dimensions: tuple[int, ...] = (2, 3)
    long: bool = False


class Outcome(NamedTuple):
    """The result of a case in one mode and dimension; same_bits: as on one rank? None if there is only one rank."""

    measured: str
    holds: bool
    same_bits: bool | None


CATALOGUE: list[Case] = []


def case(name: str, naive: str, must: str, **where: Any) -> Callable[[CaseFunction], CaseFunction]:
    """Return a decorator that enters a function into the catalogue; `where`: modes, dimensions, long."""

    def enter(function: CaseFunction) -> CaseFunction:
        CATALOGUE.append(Case(name, naive, must, function, **where))
        return function

    return enter


def catalogue() -> list[Case]:
    """Return all cases, in the order of the table."""
    for module in CASE_MODULES:
        import_module(f"particles_mpi.study.hard_cases.{module}")
    return CATALOGUE


def settings(cases: list[Case]) -> Iterator[tuple[Case, str | None, int]]:
    """Return each case with each of its modes and dimensions."""
    return ((one, mode, dimension) for one in cases for mode in one.modes for dimension in one.dimensions)


def examine(one: Case, mode: str | None, dimension: int) -> Outcome:
    """Run a case on all ranks; if there are several, also on this rank alone, to compare the bits. Collective."""
    run, ranks, same_bits = CaseRun(mode, dimension), Communicator(), None
    measured, holds = one.function(run)
    if ranks.size > 1:
        alone = CaseRun(mode, dimension, Communicator.alone().comm)
        one.function(alone)
        same_bits = ranks.all(run.digest() == alone.digest())
    return Outcome(measured, ranks.all(holds), same_bits)


def chosen(only: str | None, full: bool) -> list[Case]:
    """Return the cases whose names contain `only`, or one of several texts divided by |; long ones with `full` or `only`."""
    parts = (only or "").lower().split("|")
    cases = [one for one in catalogue() if any(part in one.name.lower() for part in parts)]
    if not cases:
        raise SceneError(f"--only: no case has {only!r} in its name; the cases are: " + "; ".join(c.name for c in catalogue()))
    return [one for one in cases if full or only is not None or not one.long]


def study_hard_cases(only: str | None, full: bool, into: Path | None) -> bool:
    """Print the table, row by row as cases end, write JSON `into` a file, and return whether all hold. Collective."""
    ranks = Communicator()
    screen, before = Screen(ranks.is_root, False), None
    rows: list[dict[str, Any]] = []
    waiting = list(settings(chosen(only, full)))
    advance = screen.count("cases", len(waiting))
    for one, mode, dimension in waiting:
        if one is not before:
            screen.say(f"\n  naive programs: {one.naive}\n  must hold: {one.must}", head=one.name)
            before = one
        advance(f"{one.name} {where(mode, dimension)}")
        outcome = examine(one, mode, dimension)
        differs = outcome.same_bits is False
        wrong = f", other bits on {ranks.size} ranks" if differs and outcome.holds else ""
        verdict = f"FAIL{wrong}" if differs or not outcome.holds else "pass"
        screen.say(f"  {where(mode, dimension):<10} {verdict}   {outcome.measured}")
        about = {"case": one.name, "naive": one.naive, "must": one.must, "mode": mode, "dimension": dimension}
        rows.append(about | outcome._asdict())
    screen.stop()
    passed = sum(row["holds"] and row["same_bits"] is not False for row in rows)
    bits = (
        f", each with the same bits on {ranks.size} ranks as on one"
        if ranks.size > 1
        else "; bits are compared only under mpirun"
    )
    screen.say(f"{passed} of {len(rows)} hold{bits}")
    if into:
        make_folder(ranks, into.parent)
        write_text(into, ranks, json.dumps(rows, indent=1) + "\n")
    return passed == len(rows)


def energies(sim: Simulation, samples: int, steps: int = 1) -> Array:
    """Return the total energy now and, `samples` times, after `steps` more steps. Collective."""
    found = [sim.measure()["total_energy"]]
    for _ in range(samples):
        sim.steps(steps)
        found.append(sim.measure()["total_energy"])
    return np.array(found)


def largest_rise(energies: Array) -> float:
    """Return the largest rise of an energy above its least value before, relative to the first value."""
    return float((energies - np.minimum.accumulate(energies)).max() / abs(energies[0]))


def where(mode: str | None, dimension: int) -> str:
    """Return a mode of collisions, if there is one, and the dimension as text: `event 3D`."""
    return f"{mode or ''} {dimension}D".strip()
