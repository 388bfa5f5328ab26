"""The time loop: the only module that sees everything."""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from particles_mpi import state
from particles_mpi.diagnostics import measure
from particles_mpi.errors import SceneError, StateError
from particles_mpi.integrators import Integrator, Leapfrog, Order4, Taylor, free_drift, places_of, wrap
from particles_mpi.parallel.agreement import alike, same_on_all
from particles_mpi.parallel.ranks import Ranks
from particles_mpi.particles import FIELDS, Array, Particles
from particles_mpi.populate import populate
from particles_mpi.scene import Scene
from particles_mpi.timers import Timers
from particles_mpi.watchdog import Watchdog, not_finite

CLOSE = 1e-14  # of a step: how well a step that ends with a contact must know its own length
MOST_TRIES = 60
WATCH_EVERY = 10  # steps
COUNTS = ("collisions", "wall_hits", "missed", "exchanges")


def next_length(tried: list[tuple[float, float]], longest: float) -> float:
    """The secant's guess of the step length h that ends with its contact, where (h, lateness) were tried."""
    (h, late) = tried[-1]
    guess = h + 0.5 * late
    if len(tried) > 1 and late != tried[-2][1]:
        guess = h - late * (h - tried[-2][0]) / (late - tried[-2][1])
    return guess if 0.0 <= guess < longest else h + 0.5 * late


class Simulation:
    """A scene in motion on the ranks of a communicator.

    `sim.step()` advances by `scene.time.step`, `sim.run()` to the end. `sim.particles` are this rank's rows,
    `sim.time` and `sim.steps_done` say where it stands, `sim.totals` counts what happened on this rank since the start.
    Raises SceneError for a scene that cannot be run and StoppedError when a state has lost its meaning, on all ranks.
    """

    def __init__(self, scene: Scene, comm: Any = None, start: Particles | None = None):
        """`start`: all particles in id order on every rank, with the fields that the scene needs, instead of its own."""
        ranks = Ranks(comm)
        with alike(ranks):
            particles, self.warnings = populate(scene) if start is None else (start, [])
        same_on_all(ranks, scene.to_dict(), particles.arrays)
        with alike(ranks):
            self._assemble(scene, ranks, particles)

    def _assemble(self, scene: Scene, ranks: Ranks, everyone: Particles) -> None:
        """Build the run around all particles (in id order on every rank), of which this rank keeps its share."""
        self.scene, self.ranks, self.total = scene, ranks, len(everyone)
        self.timers = Timers()
        self.steps_done, self.h = 0, scene.time.step
        self.moment = 0.0, 0  # (time, steps done) that the clock counts from
        self.totals = dict.fromkeys(COUNTS, 0)
        self.reported = [0] * len(COUNTS)  # sums over ranks at the last row of diagnostics
        self.written: dict[str, int] = {}  # steps of the last row of diagnostics and of the last frame
        self.observed = [0.0, 0.0, 0.0]  # time, collisions and virial when the observables were last looked at
        self.calls: dict[str, int] = {}
        first, last = (len(everyone) * (ranks.rank + k) // ranks.size for k in (0, 1))
        self.particles = everyone.select(np.arange(first, last))

        d, box = scene.dimension, scene.box
        self.lower = np.array(box.lower, float) if box else np.zeros(d)
        self.upper = np.array(box.upper, float) if box else np.zeros(d)
        self.length = np.where(scene.periodic, self.upper - self.lower, 0.0)

        effects = {
            name: import_module(f"particles_mpi.effects.{name}").Effect(options, scene) for name, options in scene.effects.items()
        }
        self.forces = {name: e for name, e in effects.items() if e.role == "force"}
        self.walls, self.collisions = effects.get("walls"), effects.get("collisions")
        drag, friction = effects.get("drag"), effects.get("friction")
        self.dissipation = [name for name in ("drag", "friction") if name in effects]
        steady = [force.g for force in self.forces.values() if getattr(force, "uniform", False)]
        self.g: Array = sum(steady, np.zeros(d))
        held = self.walls.planes if self.walls else None
        planes = (held.point, held.normal) if held else (np.empty((0, d)), np.empty((0, d)))
        self.watchdog = Watchdog(ranks, self.total, planes, self.lower, self.length)
        self.rest = self._rest()
        self.integrator = self._integrator(drag, friction)
        for force in self.forces.values():
            if hasattr(force, "enter"):
                force.enter(ranks, self.total)
        self.accelerations: Array | None = None
        self.known = -1, 0  # version and fingerprint of the rows that the accelerations belong to
        self.near: Any = None
        self.contacts: Any = None
        if self.collisions:
            self._enter_collisions(self.collisions)

    def _integrator(self, drag: Any, friction: Any) -> Integrator:
        """The one that the scene names."""
        name = self.scene.time.integrator
        if name == "order4":
            return Order4()
        if name == "adaptive":
            from particles_mpi.adaptive import TOLERANCE, Adaptive

            return Adaptive(self.ranks, self.scene.time.tolerance or TOLERANCE)
        return Taylor(drag) if name == "taylor" else Leapfrog(drag, friction, self.rest)

    def _rest(self) -> Any:
        """Who keeps contacts that last, where forces and losses can make one last."""
        if "supported" not in self.particles.arrays:
            return None
        from particles_mpi.collide.planes import no_planes
        from particles_mpi.collide.rest import Rest

        pairs = self.collisions is not None and self.collisions.lossy
        planes = self.walls.planes if self.walls else no_planes(self.scene.dimension)
        uniform = all(getattr(force, "uniform", False) for force in self.forces.values())
        return Rest(self.ranks, self.total, self.length, pairs, planes, uniform, self.timers)

    def _enter_collisions(self, c: Any) -> None:
        """Only a scene with pairs loads a collision operator, the one it names, and its search for neighbours."""
        planes = self.walls.planes if self.walls else None
        box, loss = (self.lower, self.upper, self.length), (c.restitution, c.keep)
        exact: Any = None
        if "contacted" in self.particles.arrays:
            from particles_mpi.collide.event import Event

            exact = Event(self.particles, self.ranks, box, loss, c.soft, planes, self.g, self.timers)
            if self.rest and self.rest.pairs:
                exact.hold = lambda h: self.rest.hold(self.particles, self.sum_forces(), h)
        if c.options.mode == "event":
            self.near = self.contacts = exact
            return
        from particles_mpi.collide.planes import no_planes
        from particles_mpi.collide.rewind import Rewind
        from particles_mpi.neighbours.pairs import Neighbourhood

        walls = planes or no_planes(self.scene.dimension)
        kicked = bool(self.forces or self.dissipation)
        self.near = Neighbourhood(self.particles, self.ranks, box, (walls.point, walls.normal), kicked, self.timers)
        self.contacts = Rewind(self.near, loss, c.options.passes, planes, self.g, self.timers, exact)

    @property
    def time(self) -> float:
        """The moment the state belongs to."""
        since, steps = self.moment
        return since + (self.steps_done - steps) * self.h

    def step(self, collisions: bool = True) -> None:
        """Advance by one step; `collisions=False` lets particles pass through one another and through walls. Collective."""
        try:
            self.advance(self.h, lambda h: self.drift(h, collisions), collisions)
        except StateError as error:
            raise StateError(f"step {self.steps_done + 1}: {error}") from None
        self.steps_done += 1

    def advance(self, h: float, drift: Callable[[float], None], contacts: bool = True) -> None:
        """One step of the integrator over h."""
        self.middle = 0.5 * h
        if self.rest:
            self.rest.awake = contacts
        self.integrator.advance(self.particles, h, self.sum_forces, drift, self.timers)
        for name in self.dissipation:
            self.count(name, 2)

    def step_to_collision(self) -> tuple[int, int] | None:
        """Advance to the next collision of two particles, or by one step if there is none before its end. Collective.

        Returns the ids of the two that met, the lower one first, or None; `sim.time` is the moment. It is the end of a whole
        leapfrog step of the length that ends with the contact, found by iteration where forces make that depend on itself.
        Needs collisions in mode event. Collisions at the same moment come one call after the other.
        """
        if not self.collisions or self.collisions.options.mode != "event":
            raise SceneError('effects.collisions.mode: step_to_collision needs "event"')
        h, met, free = self.h, self.near.stop, not (self.forces or self.dissipation)
        tried: list[tuple[float, float]] = []  # (length that was kicked for, how much later the contact came)
        for _ in range(MOST_TRIES):
            totals, calls = self.totals.copy(), self.calls.copy()
            before = None if free else self.particles.select(np.arange(len(self.particles)))
            self.advance(h, lambda _: self.drift(self.h, True, stop=True))
            reached, met_none = float(self.near.stopped[0]), met[1] < 0
            if met_none and h == self.h:
                self.steps_done += 1
                return None
            tried.append((h, reached - h))
            if before is None or (not met_none and abs(reached - h) <= CLOSE * self.h):
                break
            self.particles.replace(before.arrays)
            self.totals, self.calls = totals, calls
            h = next_length(tried, self.h)
        self.moment = self.time + reached, self.steps_done
        return int(met[1]), int(met[2])

    def drift(self, h: float, contacts: bool, stop: bool = False) -> None:
        """Positions over h, with whatever they meet on the way; with `stop` to the first collision only."""
        p = self.particles
        if contacts and self.collisions:
            migrated = self.near.migrated
            stopping = {"stop": True} if stop else {}
            found = self.contacts.drift(h, self.time, self.middle, **stopping)
            happened = [*found, self.near.migrated - migrated]
            self.count("collisions")
            if self.walls:
                self.count("walls")
        elif contacts and self.walls:
            with self.timers("walls"):
                happened = [0, self.walls.drift(p, h, self.g, self.middle), 0, 0]
            self.count("walls")
        else:
            with self.timers("drift"):
                free_drift(p.position, p.velocity, h)
            happened = [0, 0, 0, 0]
        for name, number in zip(COUNTS, happened, strict=True):
            self.totals[name] += int(number)
        if self.length.any() and not (contacts and self.collisions):  # those wrap ghosts too
            with self.timers("drift"):
                wrap(p.position, self.lower, self.upper, self.length)

    def sum_forces(self) -> Array | None:
        """Accelerations (n, d) at the present positions, or None without forces; summed anew if anyone moved. Collective."""
        if not self.forces:
            return None
        p = self.particles
        known = (p.version, 0) if all(f.constant for f in self.forces.values()) else places_of(p)
        same = known == self.known
        if any(hasattr(f, "enter") for f in self.forces.values()):  # what one rank does not know, none does
            same = bool(self.ranks.smallest(float(same))[0])
        if same:
            return self.accelerations
        a = np.zeros_like(p.velocity)
        for name, force in self.forces.items():
            force.add(p, a)
            self.count(name)
        a[p.fixed != 0] = 0.0
        self.accelerations, self.known = a, known
        return a

    def count(self, effect: str, calls: int = 1) -> None:
        """Calls of each effect, for `run.json`."""
        self.calls[effect] = self.calls.get(effect, 0) + calls

    def work(self) -> dict[str, int]:
        """What has been computed so far, over all ranks, in units that no machine changes. Collective.

        forces: evaluations of all accelerations; interactions: of pairs, or of what a tree puts in their place; pair_tests:
        contact times of two spheres in mode rewind; events: contacts with spheres and walls.
        """
        mine = [getattr(getattr(force, "sum", None), "interactions", 0) for force in self.forces.values()]
        tests = getattr(self.near, "pair_tests", 0)
        events = self.totals["collisions"] + self.totals["wall_hits"]
        interactions, tests, events = self.ranks.total(np.array([sum(mine), tests, events], np.int64)).tolist()
        forces = max((self.calls.get(name, 0) for name in self.forces), default=0)
        return {"forces": forces, "interactions": interactions, "pair_tests": tests, "events": events}

    def measure(self) -> dict[str, float]:
        """Energies, momentum, largest speed of all particles: the same bits on any number of ranks. Collective.

        With `output.observables` also those of `observables`: rates are over the time since the last call.
        """
        potentials = {name: f.potential(self.particles) for name, f in self.forces.items() if hasattr(f, "potential")}
        row = measure(self.ranks, self.particles, potentials)
        if self.scene.output.observables:
            from particles_mpi.observables import observe

            collisions = int(self.ranks.total(self.totals["collisions"])[0])
            volume = float(np.prod(self.upper - self.lower)) if self.scene.box else np.nan
            row |= observe(self.ranks, self.particles, volume, self.time, collisions, self.observed)
        if not np.isfinite(row["kinetic"]):
            raise StateError(not_finite(self.ranks, self.particles, f"step {self.steps_done}"))
        return row

    def remarks(self) -> list[str]:
        """What happened that a user should know of, a line each. Collective."""
        return self.contacts.remarks() if hasattr(self.contacts, "remarks") else []

    def watch(self) -> None:
        """Raises StateError if a particle is lost, astray or not a number. Collective; cheap."""
        with self.timers("watchdog"):
            self.watchdog.look(self.particles, self.steps_done)

    def run(self, output: str | Path | None = None, quiet: bool = True, **options: Any) -> None:
        """Step to the end of the scene; with `output` (a folder) write everything the scene asks for. Collective."""
        if output is None:
            while self.steps_done < self.scene.steps:
                self.step()
                if self.steps_done % WATCH_EVERY == 0 or self.steps_done == self.scene.steps:
                    self.watch()
            return
        from particles_mpi.job import Job

        Job(self, Path(output), quiet=quiet, **options).run()

    @classmethod
    def resume(cls, path: str | Path, comm: Any = None) -> Simulation:
        """The run that wrote the checkpoint, where it stood, on any number of ranks; the same bits from there on."""
        from particles_mpi.output.checkpoint import load

        ranks = Ranks(comm)
        with alike(ranks):
            arrays, saved = load(Path(path))
            about = {name: json.loads(saved[name]) for name in ("moment", "observed", "totals", "kept", "scene")}
            about["step"] = int(saved["step"])
        sim = cls._read(ranks, arrays, about)
        sim.reported, sim.written = json.loads(saved["reported"]), json.loads(saved["written"])
        return sim

    def attach(self, name: str, values: Array) -> None:
        """Give every particle data of the user's own: `values` (N, ...) in id order, any numeric type. Collective.

        `sim.particles[name]` are this rank's rows from then on; they go where their particles go, to other ranks and into
        checkpoints. Nothing computes with them.
        """
        values = np.asarray(values)
        if name in FIELDS or values.shape[:1] != (self.total,) or values.dtype.kind not in "biuf":
            raise ValueError(f"attach: {name!r} must be a new name, with an array of numbers for {self.total} particles")
        self.particles.arrays[name] = values[self.particles.id]

    def about(self) -> dict[str, Any]:
        """Clock, counts over all ranks, and scene, as plain data: what a state is besides its particles. Collective."""
        totals = self.ranks.total(np.array([self.totals[name] for name in COUNTS])).tolist()
        clock = {"step": self.steps_done, "moment": self.moment, "observed": self.observed}
        kept = [column.tolist() for column in self.rest.memory] if self.rest else []
        return {**clock, "totals": totals, "kept": kept, "scene": self.scene.to_dict()}

    @classmethod
    def _restored(cls, scene: Scene, ranks: Ranks, everyone: Particles, about: dict[str, Any]) -> Simulation:
        sim = cls.__new__(cls)
        sim.warnings = []
        sim._assemble(scene, ranks, everyone)
        sim.steps_done = about["step"]
        sim.moment = about["moment"][0], about["moment"][1]
        sim.observed = list(about["observed"])
        if sim.rest:
            sim.rest.memory = np.array(about["kept"][0], np.int64), np.array(about["kept"][1], float)
        if ranks.is_root:  # counts are sums over ranks: one rank carries those from before
            sim.totals.update(zip(COUNTS, about["totals"], strict=True))
        return sim

    def copy(self) -> Simulation:
        """Another simulation in the same state. Collective."""
        return self._restored(self.scene, self.ranks, state.everyone(self.ranks, self.particles), self.about())

    def to_json(self, path: str | Path, indent: int | None = None) -> None:
        """Save scene and state, exact to the bit; compact, or readable with `indent`. Collective."""
        state.save_json(Path(path), self.ranks, self.particles, self.about(), indent)

    @classmethod
    def from_json(cls, path: str | Path, comm: Any = None) -> Simulation:
        """What `to_json` saved, on any number of ranks."""
        ranks = Ranks(comm)
        with alike(ranks):
            arrays, about = state.load_json(Path(path))
        return cls._read(ranks, arrays, about)

    @classmethod
    def _read(cls, ranks: Ranks, arrays: dict[str, Array], about: dict[str, Any]) -> Simulation:
        """The simulation of a state that every rank has read from a file: it must be the same on all."""
        same_on_all(ranks, about, arrays)
        with alike(ranks):
            scene = Scene.from_dict(about["scene"])
            return cls._restored(scene, ranks, Particles(scene.dimension, arrays), about)

    def __eq__(self, other: object) -> bool:
        """The same scene, time and particles, to the bit. Collective."""
        if not isinstance(other, Simulation):
            return NotImplemented
        mine, theirs = (state.everyone(sim.ranks, sim.particles) for sim in (self, other))
        return self.scene == other.scene and self.time == other.time and state.same(mine, theirs)

    __hash__ = None  # type: ignore[assignment]

    def __str__(self) -> str:
        return f"{self!r}\n{state.table(self.particles)}"

    def __repr__(self) -> str:
        return f"Simulation({self.scene.title!r}: {self.total} particles, step {self.steps_done}, time {self.time:g})"
