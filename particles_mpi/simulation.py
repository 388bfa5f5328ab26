"""The time loop: the only module that sees everything."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from particles_mpi.between_steps.effect_view import RunningEffect, changed_options
from particles_mpi.between_steps.particle_view import ParticleView
from particles_mpi.contacts.law import Loss
from particles_mpi.contacts.velocity_flow import Rates
from particles_mpi.errors import SceneError, StateError
from particles_mpi.initial.checks import listed, periodic_length, value_limits
from particles_mpi.initial.populate import effect_class, fields_of, keeps_contacts, populate
from particles_mpi.integrators.integrator import Integrator
from particles_mpi.integrators.leapfrog import Leapfrog
from particles_mpi.integrators.order4 import Order4
from particles_mpi.integrators.taylor import Taylor
from particles_mpi.kernels.geometry import Box, wrap
from particles_mpi.kernels.motion import free_drift
from particles_mpi.measure import snapshot
from particles_mpi.measure.diagnostics import COUNTS, measure
from particles_mpi.measure.snapshot import METADATA
from particles_mpi.measure.watchdog import WATCH_EVERY, Watchdog
from particles_mpi.parallel.agreement import raising_together, require_finite, same_on_all
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import id_range
from particles_mpi.particles import FIELDS, Array, Particles, default_values, places_of
from particles_mpi.scene.schema import Scene
from particles_mpi.timers import Timers

CLOSE = 1e-14  # of a step: how well a step that ends with a contact must know its own length
MOST_TRIES = 60


def next_length(tried: list[tuple[float, float]], longest: float) -> float:
    """The secant's guess of the step length h that ends with its contact, where (h, lateness) were tried."""
    (h, late) = tried[-1]
    guess = h + 0.5 * late
    if len(tried) > 1 and late != tried[-2][1]:
        guess = h - late * (h - tried[-2][0]) / (late - tried[-2][1])
    return guess if 0.0 <= guess < longest else h + 0.5 * late


class Simulation:
    """A scene in motion on the ranks of a communicator.

    `sim.step()` advances by `sim.h`, `sim.run()` to the end. `sim.time` and `sim.steps_done` say where it stands, `sim.totals`
    counts what happened on this rank since the start.

    Between two steps the state belongs to the user, and what is changed counts from the next step on: the fields of
    `sim.particles` (this rank's rows, see `ParticleView`), `sim.time`, `sim.h`, the options of `sim.effects[name]`; `sim.add`
    and `sim.remove` change who is there. Going on is then the same, to the bit, as a new simulation of that state.
    Raises SceneError for a scene that cannot be run and StoppedError when a state has lost its meaning, on all ranks.
    """

    def __init__(self, scene: Scene, comm: Any = None, start: Particles | None = None):
        """`start`: all particles in id order on every rank, with the fields that the scene needs, instead of its own."""
        ranks = Communicator(comm)
        with raising_together(ranks):
            particles, self.warnings = populate(scene) if start is None else (start, [])
        same_on_all(ranks, scene.to_dict(), particles.arrays)
        with raising_together(ranks):
            self._assemble(scene, ranks, particles)

    def _assemble(self, scene: Scene, ranks: Communicator, everyone: Particles, next_id: int = 0) -> None:
        """Build the run around all particles (in id order on every rank), of which this rank keeps its share.

        `next_id`: the id of the next particle that is added, if it is larger than those that are there tell.
        """
        self.scene, self.ranks, self.timers = scene.running(), ranks, Timers()
        self.steps_done, self._h = 0, scene.time.step
        self.moment = 0.0, 0  # (time, steps done) that the clock counts from
        self.totals = dict.fromkeys(COUNTS, 0)
        self.reported = [0] * len(COUNTS)  # sums over ranks at the last row of diagnostics
        self.written: dict[str, int] = {}  # steps of the last row of diagnostics and of the last frame
        self.observed = [0.0, 0.0, 0.0]  # time, collisions and virial when the observables were last looked at
        self.calls: dict[str, int] = {}
        self.past: dict[str, int] = {}  # work of operators that are no longer there
        self.past_remarks: list[str] = []
        self.additions = 0  # populations added while it ran
        self.forces: dict[str, Any] = {}
        self.near: Any = None
        self.contacts: Any = None
        first, last = (len(everyone) * (ranks.rank + k) // ranks.size for k in (0, 1))
        self.rows = everyone.select(np.arange(first, last))
        self.rows.velocity[self.rows.fixed != 0] = 0.0
        self._particles = ParticleView(self.rows, self._check_values)
        self.next_id = max(next_id, int(everyone.id.max(initial=-1)) + 1)

        d, box = scene.dimension, scene.box
        self.lower = np.array(box.lower, float) if box else np.zeros(d)
        self.upper = np.array(box.upper, float) if box else np.zeros(d)
        self.length = periodic_length(scene)
        self._build()

    def _build(self) -> None:
        """All that follows from the scene's effects and from how many particles there are. Collective."""
        scene, ranks, p, d = self.scene, self.ranks, self.rows, self.scene.dimension
        self.past, self.past_remarks = self.counted(), self.remarks()
        p.version, p.edition = p.version + 1, p.edition + 1  # nothing that was known of the rows holds any longer
        self.ids = id_range(ranks, p.id)
        self.total = self.ids.total
        for name in fields_of(scene):
            if name not in p.arrays:
                p.arrays[name] = default_values(name, len(p), d)
        effects = {name: effect_class(name)(options, scene) for name, options in scene.active.items()}
        self.keeps_contacts = keeps_contacts(scene, scene.active)
        self.forces = {name: e for name, e in effects.items() if e.role == "force"}
        self.walls, self.collisions = effects.get("walls"), effects.get("collisions")
        drag, friction = effects.get("drag"), effects.get("friction")
        self.friction = float(friction.strength) if friction else 0.0
        self.dissipation = [name for name in ("drag", "friction") if name in effects]
        steady = [force.g for force in self.forces.values() if getattr(force, "uniform", False)]
        self.g: Array = sum(steady, np.zeros(d))
        held = self.walls.planes if self.walls else None
        planes = (held.point, held.normal) if held else (np.empty((0, d)), np.empty((0, d)))
        self.watchdog = Watchdog(ranks, p.id, self.ids, planes, self.lower, self.length)
        self.rest = self._rest()
        self.integrator = self._integrator(drag, friction)
        for force in self.forces.values():
            if hasattr(force, "enter"):
                force.enter(ranks, self.ids)
        self.accelerations: Array | None = None
        self.known: tuple[int, ...] = ()  # version, edition and fingerprint of the rows that the accelerations belong to
        self.near = self.contacts = None
        if self.collisions:
            self._enter_collisions(self.collisions)
        self.taken = p.edition  # changes up to here are known everywhere
        self.particles.open()

    def _integrator(self, drag: Any, friction: Any) -> Integrator:
        """The one that the scene names."""
        name = self.scene.time.integrator
        if name == "order4":
            return Order4()
        if name == "adaptive":
            from particles_mpi.integrators.gauss_radau import TOLERANCE, Adaptive

            return Adaptive(self.ranks, self.scene.time.tolerance or TOLERANCE)
        return Taylor(drag) if name == "taylor" else Leapfrog(drag, friction, self.rest)

    def _rest(self) -> Any:
        """Who keeps contacts that last, where forces and losses can make one last."""
        if not self.keeps_contacts:
            return None
        from particles_mpi.contacts.persistent.operator import Rest
        from particles_mpi.contacts.walls import no_planes

        pairs = self.collisions is not None and self.collisions.lossy
        planes = self.walls.planes if self.walls else no_planes(self.scene.dimension)
        uniform = all(getattr(force, "uniform", False) for force in self.forces.values())
        return Rest(self.ranks, self.ids.end, self.length, pairs, planes, uniform, self.timers)

    def _enter_collisions(self, c: Any) -> None:
        """Only a scene with pairs loads a collision operator, the one it names, and its search for neighbours."""
        planes = self.walls.planes if self.walls else None
        box, loss = Box(self.lower, self.upper, self.length), Loss(c.restitution, c.keep)
        exact: Any = None
        if c.options.mode == "event" or self.keeps_contacts:
            from particles_mpi.contacts.event_driven.operator import Event

            exact = Event(self.rows, self.ranks, box, loss, c.options.contact_duration, planes, self.timers)
            if self.rest and self.rest.pairs:
                exact.hold = lambda h: self.rest.hold(self.rows, self.sum_forces(), h)
        if c.options.mode == "event":
            self.near = self.contacts = exact
            return
        from particles_mpi.contacts.time_stepped.operator import Rewind
        from particles_mpi.contacts.walls import no_planes
        from particles_mpi.neighbours.neighbour_list import Neighbourhood

        walls = planes or no_planes(self.scene.dimension)
        kicked = bool(self.forces or self.dissipation)
        self.near = Neighbourhood(self.rows, self.ranks, box, (walls.point, walls.normal), kicked, self.timers)
        self.contacts = Rewind(self.near, loss, c.options.passes, planes, self.timers, exact)

    @property
    def particles(self) -> ParticleView:
        """The particles of this rank, to be read and changed between two steps."""
        return self._particles

    @property
    def time(self) -> float:
        """The moment the state belongs to. To set it changes nothing but the clock; all ranks set the same."""
        since, steps = self.moment
        return since + (self.steps_done - steps) * self._h

    @time.setter
    def time(self, value: float) -> None:
        if not np.isfinite(value):
            raise ValueError(f"time: {value} is not finite")
        same_on_all(self.ranks, {"time": value})
        self.observed[0] += value - self.time
        self.moment = float(value), self.steps_done
        self._forget_contacts()

    @property
    def h(self) -> float:
        """The length of a step, from the next one on; all ranks set the same."""
        return self._h

    @h.setter
    def h(self, value: float) -> None:
        if not 0.0 < value < np.inf:
            raise ValueError(f"h: {value} is no length of a step, which is above 0")
        same_on_all(self.ranks, {"h": value})
        self.moment = self.time, self.steps_done
        self._h = float(value)
        self._forget_contacts()

    @property
    def last_step(self) -> int:
        """The number of the step with which the run ends: after `time.steps`, or nearest to `time.end`."""
        since, steps = self.moment
        end = self.scene.time.end
        return self.scene.steps if end is None else steps + max(0, round((end - since) / self._h))

    @property
    def effects(self) -> dict[str, RunningEffect]:
        """The effects of the scene by name; setting an option of one changes the run. See `RunningEffect`."""
        return {name: RunningEffect(self, name) for name in self.scene.effects}

    def change_effect(self, name: str, key: str, value: Any) -> None:
        """Give an option of an effect another value, from the next step on; checked as in a scene file. Collective."""
        options = changed_options(self.scene, name, key, value)
        same_on_all(self.ranks, {"effects": {name: options.model_dump(mode="json")}})
        self.take_changes()
        self.scene = self.scene.model_copy(update={"effects": {**self.scene.effects, name: options.running()}})
        if name in self.forces and key != "active":  # it is asked anew; nothing else depends on it
            done = getattr(getattr(self.forces[name], "sum", None), "interactions", 0)
            self.past["interactions"] = self.past.get("interactions", 0) + done
            self.forces[name] = effect_class(name)(options, self.scene)
            if hasattr(self.forces[name], "enter"):
                self.forces[name].enter(self.ranks, self.ids)
            self.g[:] = sum((f.g for f in self.forces.values() if getattr(f, "uniform", False)), np.zeros_like(self.g))
            self.rows.edition += 1
            self._forget_contacts()
        else:
            self._build()

    def take_changes(self) -> None:
        """What the user has written into `particles` becomes the state. Called wherever the state is used. Collective."""
        try:
            self.particles.collect()
        except StateError as error:
            raise StateError(f"step {self.steps_done + 1}: {error}") from None
        if self.rest and self.rest.pairs and self.ranks.allreduce_max(float(self.rows.edition != self.taken))[0]:
            self._forget_contacts()
        self.taken = self.rows.edition

    def _forget_contacts(self) -> None:
        """What contacts carried belongs to a state that is no more. Collective."""
        if self.rest:
            self.rest.forget()
        self.taken = self.rows.edition

    def _check_values(self, values: dict[str, Array]) -> None:
        """Raises StateError for values that no particle can have, naming the first that has one."""
        p = self.rows
        for name, allowed in value_limits(self.scene, p, values).items():
            wrong = np.flatnonzero(~allowed)
            if len(wrong):
                row = wrong[p.id[wrong].argmin()]
                raise StateError(
                    f"particles.{name}: particle {p.id[row]} on rank {self.ranks.rank} was given {values[name][row]:g},"
                    " which it cannot have"
                )

    def step(self, collisions: bool = True) -> None:
        """Advance by one step; `collisions=False` lets particles pass through one another and through walls. Collective."""
        self.take_changes()
        try:
            self.particles.close()
            self.advance(self._h, lambda h: self.drift(h, collisions), collisions)
        except StateError as error:
            raise StateError(f"step {self.steps_done + 1}: {error}") from None
        self.particles.open()
        self.steps_done += 1

    def advance(self, h: float, drift: Callable[[float], None], contacts: bool = True) -> None:
        """One step of the integrator over h."""
        self.middle = 0.5 * h
        if self.rest:
            self.rest.awake = contacts
        self.integrator.advance(self.rows, h, self.sum_forces, drift, self.timers)
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
        self.take_changes()
        self.particles.close()
        h, met, free = self._h, self.near.stop, not (self.forces or self.dissipation)
        tried: list[tuple[float, float]] = []  # (length that was kicked for, how much later the contact came)
        for _ in range(MOST_TRIES):
            totals, calls = self.totals.copy(), self.calls.copy()
            before = None if free else self.rows.select(np.arange(len(self.rows)))
            self.advance(h, lambda _: self.drift(self._h, True, stop=True))
            reached, met_none = float(self.near.stopped[0]), met[1] < 0
            if met_none and h == self._h:
                self.particles.open()
                self.steps_done += 1
                return None
            tried.append((h, reached - h))
            if before is None or (not met_none and abs(reached - h) <= CLOSE * self._h):
                break
            self.rows.replace(before.arrays)
            self.totals, self.calls = totals, calls
            h = next_length(tried, self._h)
        self.moment = self.time + reached, self.steps_done
        self.particles.open()
        return int(met[1]), int(met[2])

    def drift(self, h: float, contacts: bool, stop: bool = False) -> None:
        """Positions over h, with whatever they meet on the way; with `stop` to the first collision only."""
        p = self.rows
        if contacts and self.collisions:
            migrated = self.near.migrated
            stopping = {"stop": True} if stop else {}
            found = self.contacts.drift(h, self.time, self.rates(), **stopping)
            happened = [*found, self.near.migrated - migrated]
            self.count("collisions")
            if self.walls:
                self.count("walls")
        elif contacts and self.walls:
            with self.timers("walls"):
                happened = [0, self.walls.drift(p, h, self.rates().of(p.arrays)), 0, 0]
            self.count("walls")
        else:
            with self.timers("drift"):
                free_drift(p.position, p.velocity, h)
            happened = [0, 0, 0, 0]
            p.version += self.collisions is not None  # what is known of neighbours does not hold any longer
        for name, number in zip(COUNTS, happened, strict=True):
            self.totals[name] += int(number)
        if self.length.any() and not (contacts and self.collisions):  # those wrap ghosts too
            with self.timers("drift"):
                wrap(p.position, self.lower, self.upper, self.length)

    def rates(self) -> Rates:
        """How velocities change between the contacts of this step, for whom forces differ in the particles' fields."""
        p, none = self.rows, np.empty((0, self.rows.dimension))
        if "total_acceleration" in p.arrays:
            p["total_acceleration"][:] = 0.0 if self.accelerations is None else self.accelerations
        if self.rest:  # contacts that last push too: what lies on something does not fall
            rows, given = self.rest.given
            p["total_acceleration"][rows] += given.reshape(len(rows), p.dimension) / self.middle
        a = self.g[None, :] if self.forces or self.dissipation else none
        return Rates(a, np.zeros(int("drag" in self.dissipation)), self.friction, self.middle)

    def sum_forces(self) -> Array | None:
        """Accelerations (n, d) at the present positions, or None without forces; summed anew if anyone moved. Collective."""
        if not self.forces:
            return None
        p = self.rows
        known = (p.version, p.edition) if all(f.constant for f in self.forces.values()) else places_of(p)
        same = known == self.known
        if any(hasattr(f, "enter") for f in self.forces.values()):  # what one rank does not know, none does
            same = bool(self.ranks.allreduce_min(float(same))[0])
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

    def counted(self) -> dict[str, int]:
        """Work of this rank so far: searches for neighbours, ghosts, tests of pairs, interactions, windows of time."""
        near, past = self.near, self.past
        windows = getattr(near, "windows_redone", None) or (0, 0)
        now = {
            "interactions": sum(getattr(getattr(f, "sum", None), "interactions", 0) for f in self.forces.values()),
            "pair_tests": getattr(near, "pair_tests", 0),
            "pair_searches": near.searches if near else 0,
            "ghost_rows": near.ghost_rows if near else 0,
            "windows": windows[0],
            "windows_redone": windows[1],
        }
        return {name: number + past.get(name, 0) for name, number in now.items()}

    def work(self) -> dict[str, int]:
        """What has been computed so far, over all ranks, in units that no machine changes. Collective.

        forces: evaluations of all accelerations; interactions: of pairs, or of what a tree puts in their place; pair_tests:
        contact times of two spheres in mode rewind; events: contacts with spheres and walls.
        """
        counted = self.counted()
        events = self.totals["collisions"] + self.totals["wall_hits"]
        sums = self.ranks.allreduce_sum(np.array([counted["interactions"], counted["pair_tests"], events], np.int64)).tolist()
        forces = max((self.calls.get(name, 0) for name in self.forces), default=0)
        return {"forces": forces, "interactions": sums[0], "pair_tests": sums[1], "events": sums[2]}

    def measure(self) -> dict[str, float]:
        """Energies, momentum, largest speed of all particles: the same bits on any number of ranks. Collective.

        With `output.observables` also those of `observables`: rates are over the time since the last call.
        """
        self.take_changes()
        p = self.rows
        potentials = {name: f.potential(p) for name, f in self.forces.items() if hasattr(f, "potential")}
        row = measure(self.ranks, p, potentials)
        if self.scene.output.observables:
            from particles_mpi.measure.observables import observe

            collisions = int(self.ranks.allreduce_sum(self.totals["collisions"])[0])
            volume = float(np.prod(self.upper - self.lower)) if self.scene.box else np.nan
            row |= observe(self.ranks, p, volume, self.time, collisions, self.observed)
        require_finite(self.ranks, p, row["kinetic"], f"step {self.steps_done}")
        return row

    def remarks(self) -> list[str]:
        """What happened that a user should know of, a line each. Collective."""
        return [*self.past_remarks, *(self.contacts.remarks() if hasattr(self.contacts, "remarks") else [])]

    def watch(self) -> None:
        """Raises StateError if a particle is lost, astray or not a number. Collective; cheap."""
        self.take_changes()
        with self.timers("watchdog"):
            self.watchdog.look(self.rows, self.steps_done)

    def run(self, output: str | Path | None = None, quiet: bool = True, **options: Any) -> None:
        """Step to the end of the scene; with `output` (a folder) write everything the scene asks for. Collective."""
        if output is None:
            while self.steps_done < self.last_step:
                self.step()
                if self.steps_done % WATCH_EVERY == 0 or self.steps_done == self.last_step:
                    self.watch()
            return
        from particles_mpi.run.job import Job

        Job(self, Path(output), quiet=quiet, **options).run()

    @classmethod
    def resume(cls, path: str | Path, comm: Any = None) -> Simulation:
        """The run that wrote the checkpoint, where it stood, on any number of ranks; the same bits from there on."""
        from particles_mpi.output.checkpoint import load

        ranks = Communicator(comm)
        with raising_together(ranks):
            arrays, saved = load(Path(path))
            metadata = {name: json.loads(str(saved[name])) for name in METADATA}
        sim = cls._read(ranks, arrays, metadata)
        sim.reported, sim.written = json.loads(saved["reported"]), json.loads(saved["written"])
        return sim

    def add(self, population: Mapping[str, Any]) -> Array:
        """Add particles: the keys of a `[[particles]]` table, or arrays under these names. Returns their ids. Collective.

        All ranks give the same. Ids go on from the largest there ever was. Fields that were attached may be given too,
        and are 0 if not. Raises SceneError, as at the start, for particles that cannot be: overlapping others, outside, ...
        """
        from particles_mpi.initial.populate import add_population

        self.take_changes()
        everyone = snapshot.gather_all(self.ranks, self.rows)
        number = len(self.scene.particles) + self.additions
        with raising_together(self.ranks):
            all_, warnings = add_population(self.scene, everyone, population, self.next_id, number)
        same_on_all(self.ranks, {}, all_.arrays)
        new = all_.select(np.arange(len(everyone), len(all_)))
        self.warnings += warnings
        mine = np.isin(all_.id, self.rows.id)  # the same as before, in another place if they were pushed apart
        first, last = (len(new) * (self.ranks.rank + k) // self.ranks.size for k in (0, 1))
        mine[len(everyone) + first : len(everyone) + last] = True
        self.rows.replace(all_.select(np.flatnonzero(mine)).arrays)
        self.particles.close()
        self.next_id += len(new)
        self.additions += 1
        self._build()
        return new.id

    def remove(self, ids: Any) -> None:
        """Take particles away, by their ids. Collective: a rank may name any, and they go if one rank names them.

        Raises ValueError, on all ranks, for ids that no particle has.
        """
        self.take_changes()
        named = np.unique(np.concatenate([np.asarray(of, np.int64).reshape(-1) for of in self.ranks.allgather(ids)]))
        here = np.isin(self.rows.id, named)
        if self.ranks.allreduce_sum(np.count_nonzero(here))[0] < len(named):
            known = np.concatenate(self.ranks.allgather(self.rows.id[here]))
            raise ValueError(f"remove: no {listed(np.setdiff1d(named, known))}")
        self.rows.replace(self.rows.select(np.flatnonzero(~here)).arrays)
        self.particles.close()
        self._build()

    def attach(self, name: str, values: Array) -> None:
        """Give every particle data of the user's own: `values` (N, ...) in id order, any numeric type. Collective.

        `sim.particles[name]` are this rank's rows from then on; they go where their particles go, to other ranks and into
        checkpoints. Nothing computes with them.
        """
        values = np.asarray(values)
        if name in FIELDS or name in dir(ParticleView) or values.shape[:1] != (self.total,) or values.dtype.kind not in "biuf":
            raise ValueError(f"attach: {name!r} must be a new name, with an array of numbers for {self.total} particles")
        self.take_changes()
        ids = np.sort(np.concatenate(self.ranks.allgather(self.rows.id)))
        self.rows.arrays[name] = values[np.searchsorted(ids, self.rows.id)]

    def metadata(self) -> dict[str, Any]:
        """Clock, counts over all ranks, and scene, as plain data: what a state is besides its particles. Collective."""
        self.take_changes()
        totals = self.ranks.allreduce_sum(np.array([self.totals[name] for name in COUNTS])).tolist()
        clock = {"step": self.steps_done, "moment": self.moment, "h": self._h, "observed": self.observed}
        kept = [column.tolist() for column in self.rest.memory] if self.rest else []
        counts = {"totals": totals, "next_id": self.next_id, "additions": self.additions}
        return {**clock, **counts, "kept": kept, "scene": self.scene.to_dict()}

    @classmethod
    def _restored(cls, scene: Scene, ranks: Communicator, everyone: Particles, metadata: dict[str, Any]) -> Simulation:
        sim = cls.__new__(cls)
        sim.warnings = []
        sim._assemble(scene, ranks, everyone, metadata["next_id"])
        sim.steps_done, sim._h, sim.additions = metadata["step"], metadata["h"], metadata["additions"]
        sim.moment = metadata["moment"][0], metadata["moment"][1]
        sim.observed = list(metadata["observed"])
        if sim.rest and metadata["kept"]:
            sim.rest.memory = np.array(metadata["kept"][0], np.int64), np.array(metadata["kept"][1], float)
        if ranks.is_root:  # counts are sums over ranks: one rank carries those from before
            sim.totals.update(zip(COUNTS, metadata["totals"], strict=True))
        return sim

    def copy(self) -> Simulation:
        """Another simulation in the same state. Collective."""
        metadata = self.metadata()
        return self._restored(self.scene, self.ranks, snapshot.gather_all(self.ranks, self.rows), metadata)

    def to_json(self, path: str | Path, indent: int | None = None) -> None:
        """Save scene and state, exact to the bit; compact, or readable with `indent`. Collective."""
        metadata = self.metadata()
        snapshot.save_json(Path(path), self.ranks, self.rows, metadata, indent)

    @classmethod
    def from_json(cls, path: str | Path, comm: Any = None) -> Simulation:
        """What `to_json` saved, on any number of ranks."""
        ranks = Communicator(comm)
        with raising_together(ranks):
            arrays, metadata = snapshot.load_json(Path(path))
        return cls._read(ranks, arrays, metadata)

    @classmethod
    def _read(cls, ranks: Communicator, arrays: dict[str, Array], metadata: dict[str, Any]) -> Simulation:
        """The simulation of a state that every rank has read from a file: it must be the same on all."""
        same_on_all(ranks, metadata, arrays)
        with raising_together(ranks):
            scene = Scene.from_dict(metadata["scene"])
            return cls._restored(scene, ranks, Particles(scene.dimension, arrays), metadata)

    def __eq__(self, other: object) -> bool:
        """The same scene, time, step length and particles, to the bit. Collective."""
        if not isinstance(other, Simulation):
            return NotImplemented
        for sim in (self, other):
            sim.take_changes()
        mine, theirs = (snapshot.gather_all(sim.ranks, sim.rows) for sim in (self, other))
        clocks = [(sim.time, sim.h, sim.next_id) for sim in (self, other)]
        return self.scene == other.scene and clocks[0] == clocks[1] and snapshot.same(mine, theirs)

    __hash__ = None  # type: ignore[assignment]

    def __str__(self) -> str:
        self.particles.collect()
        return f"{self!r}\n{snapshot.table(self.rows)}"

    def __repr__(self) -> str:
        return f"Simulation({self.scene.title!r}: {self.total} particles, step {self.steps_done}, time {self.time:g})"
