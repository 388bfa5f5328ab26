"""The runs of a scene that are compared with one another: all from the same start, and what is kept of each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite, sqrt
from time import perf_counter
from typing import Any

import numpy as np

from particles_mpi import Scene, Simulation
from particles_mpi.errors import StoppedError
from particles_mpi.initial.checks import check_start
from particles_mpi.initial.faults import Faults
from particles_mpi.initial.populate import populate
from particles_mpi.initial.room import room_of
from particles_mpi.initial.start_warnings import endless_falls
from particles_mpi.kernels.geometry import image_shifts
from particles_mpi.parallel.agreement import raising_together, same_on_all
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import RUN_MADE, Array, Particles, default_values
from particles_mpi.scene.active import ActiveEffects, fields_of
from particles_mpi.study.experiment import Benchmark, Errors, all_particles, total_count

DISPLACEMENT = 1e-12  # of the size of a motion: how far a displaced start is from the start
FEW_PARTICLES = 64  # particles that more than one rank would only slow down
# Moments, evenly over the run, at which places are compared; all numbers of steps are multiples of it.
LEAST_SNAPSHOTS, MOST_SNAPSHOTS = 4, 16  # more would allow fewer kinds of long steps; `apart_all_along` sees what is between
MOST_PLACES = 200_000  # of particles, in all snapshots of a run
MOST_MOMENTS, MOST_COMPARED = 1000, 2_000_000  # at which two runs are compared all along, and places of particles there
ROUNDED_UP = 1.02  # times the steps of the scene: more would be another scene
ENERGY_SAMPLES = 32  # moments at which energies are, about
LOOKS, GOLDEN = 48, 0.5 * (5.0**0.5 - 1.0)  # at where the particles are, at moments that no period has
STATISTICS = ("collision rate", "wall hits", "kinetic energy", "height")  # what chaotic motion is judged by

# What `counted_seconds` takes for one laptop's core, in seconds:
CONTACT, INTERACTION = 1.2e-6, 1e-9  # of a contact; of a pair that attracts, or what a tree puts in its place
STEP, FORCE = 1e-4, 2e-5  # of a step, and of a sum of forces, where each is a call from Python
STEP_OF_MANY, FORCE_OF_MANY = 1e-6, 1e-7  # where `ManySteps` computes them
KEEPING = 5e-4  # more of a step where contacts may last
ROW, KEPT, RESTING = 8e-8, 2e-7, 5e-6  # of a particle in a step; more where contacts may last, and of one whose contacts do

Changes = dict[str, dict[str, Any]]  # keys of effects that change, by effect; None for a default


class TooLongError(StoppedError):
    """A run that takes more `counted_seconds` than it was given."""


def counted_seconds(sim: Simulation) -> float:
    """Return the seconds of all that a simulation has done, estimated from its counted work, on any ranks. Collective.

    How much of a scene is measured, and against how good a reference, depends on what that takes. A clock would let it depend on
    the machine and on the hour, and so would the errors that a study tells. These seconds are right within a factor of three in
    the scenes that come with the program.
    """
    work, many = sim.work(), sim.many_steps and not sim.active.pairs
    step = (STEP_OF_MANY if many else STEP) + ROW * sim.total
    if sim.persistent and not many:
        step += KEEPING + KEPT * sim.total + RESTING * sim.ranks.total(np.count_nonzero(sim.rows["supported"]))[0]
    force = FORCE_OF_MANY if many else FORCE
    return sim.steps_done * step + work["forces"] * force + work["interactions"] * INTERACTION + work["events"] * CONTACT


def variant(scene: Scene, time: dict[str, Any], effects: Changes | None = None) -> Scene:
    """Return the scene with other keys of [time] and of effects; None means the default. SceneError if that is refused."""

    def changed(table: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
        return {key: value for key, value in (table | changes).items() if value is not None}

    tables, changes = scene.to_dict(), effects or {}
    tables["time"] = changed(tables["time"], time)
    tables["effects"] = {name: changed(options, changes.get(name, {})) for name, options in tables["effects"].items()}
    return Scene.from_dict(tables, scene.folder)


class Start:
    """All particles of a scene at its start, drawn once, and what kind of scene it is."""

    def __init__(self, benchmark: Benchmark, scene: Scene):
        self.benchmark, self.scene = benchmark, scene
        with raising_together(benchmark.ranks):
            self.particles, _ = populate(scene)
        same_on_all(benchmark.ranks, scene.to_dict(), self.particles.arrays)
        self.total = len(self.particles)
        effects = ActiveEffects(scene, switched_off=True)
        self.contacts = bool(effects.pairs or effects.walls or effects.events)
        self.dissipates = bool(effects.on_velocities or effects.events)
        self.smooth = not self.contacts and not self.dissipates  # forces depend on places alone: all integrators apply
        self.forces = list(effects.forces)
        self.conserves = effects.conserves_energy and not endless_falls(scene, self.particles, Communicator.alone())
        self.duration = scene.steps * scene.time.step
        self.length = scene.periodic_length  # of periodic axes, 0 of others
        self.movable = self.particles.fixed == 0
        active = ActiveEffects(scene)
        self.events = bool(active.events)
        self.drag = self.particles["drag"][self.movable] if active.damping else np.zeros(0)
        uniform = (np.asarray(force.g) for force in active.forces.values() if force.g is not None)
        self.fall = sum(float(np.sqrt((g**2).sum())) for g in uniform)
        self.middle = self.particles.position[self.movable].mean(axis=0) if self.movable.any() else np.zeros(scene.dimension)

    def snapshots(self, part: float) -> int:
        """Return the number of snapshots in a part of the run: the most for which the scene's steps are about a multiple."""
        steps = max(part * self.scene.steps, 1.0)
        numbers = range(min(MOST_SNAPSHOTS, MOST_PLACES // max(self.total, 1)), LEAST_SNAPSHOTS, -1)
        exact = (k for k in numbers if 2 * k >= numbers[0] and steps % k == 0.0) if numbers else ()
        return next(iter(exact), next((k for k in numbers if whole_parts(steps, k) <= ROUNDED_UP * steps), LEAST_SNAPSHOTS))

    def on_few(self, work: Callable[[Start], Any]) -> Any:
        """Return `work(self)`; for few bodies, which more ranks would slow down, on rank 0 alone: None elsewhere. Collective."""
        few = self.total <= FEW_PARTICLES
        return self.benchmark.on_few(few, lambda b: work(self if b is self.benchmark else Start(b, self.scene)))

    def simulate(self, scene: Scene, shifted: int = 0, duration: float = 0.0, amount: float = DISPLACEMENT) -> Simulation:
        """Return the simulation of a variant of the scene. Collective. SceneError if it cannot run.

        `shifted`: the number of a start that is displaced by `amount` of the size of what moves; in a scene with contacts by so
        much of the velocities, so that nothing overlaps; `duration` of what follows tells how fast something at rest is.
        """
        given, d = self.particles.arrays, self.particles.dimension
        arrays = {
            name: given[name].copy() if name in given and name not in RUN_MADE else default_values(name, self.total, d)
            for name in fields_of(scene)
        }
        faults = Faults(Communicator.alone())
        check_start(scene, particles := Particles(d, arrays), room_of(scene), faults)
        faults.stop()
        if shifted:
            self.displace(particles, shifted, duration, amount)
        return Simulation(scene, comm=self.benchmark.comm, start=particles)

    def displace(self, p: Particles, number: int, duration: float, amount: float) -> None:
        """Displace each movable particle a little, or its velocity where there are contacts, at random by `number` and id."""
        shift = np.random.Generator(np.random.Philox(key=number)).uniform(-1.0, 1.0, p.position.shape)
        shift[p.fixed != 0] = 0.0
        x, v = p["position"], p["velocity"]
        size = rms_distance(x, x.mean(axis=0)) or rms_distance(x, np.zeros(p.dimension)) or 1.0
        if self.contacts:
            v += amount * (rms_distance(v, np.zeros(p.dimension)) or size / (duration or 1.0)) * shift
        else:
            x += amount * size * shift

    def late(self, h: float) -> float:
        """Return how far the fastest particle travels in a step of h if there are events, which act up to a step late.

        How late is a matter of chance: of h, h/2, h/4 and so on any number may be late by the same.
        """
        return h * float(np.sqrt((self.particles.velocity**2).sum(axis=1)).max(initial=0.0)) if self.events else 0.0

    def untravelled(self, h: float) -> float:
        """Return how far, at most, a particle travels at the start while drag stops it within a step of h, which steps leave out.

        The exact way of one with the velocity u beyond its final one is u (1 - exp(-k h))/k, that of a step u h exp(-k h/2). It
        is the same for steps of h, h/2 and h/4 as long as k h is large, so that no comparison of these shows it.
        """
        stopped = self.drag * h > 1.0
        if not stopped.any():
            return 0.0
        k, v = self.drag[stopped], self.particles.velocity[self.movable][stopped]
        beyond = np.sqrt((v**2).sum(axis=1)) + self.fall / k
        return float((beyond / k * np.abs(1.0 - np.exp(-k * h) - k * h * np.exp(-0.5 * k * h))).max())

    def apart(self, one: Array, other: Array) -> float:
        """Return the largest distance of any particle between two runs over all snapshots; the shorter way in a periodic box."""
        away = one - other
        away -= image_shifts(away, self.length)
        return float(np.sqrt((away**2).sum(axis=-1)).max(initial=0.0))

    def spread(self, sim: Simulation) -> float:
        """Return the mean square distance of the movable particles from their centre at the start. Collective."""
        p = sim.particles
        away = float(((p.position[p.fixed == 0] - self.middle) ** 2).sum())
        return float(sim.ranks.allreduce_sum(np.array([away]))[0]) / max(int(self.movable.sum()), 1)


@dataclass
class Record:
    """What is kept of a run.

    places: (snapshots, N, d) at the snapshots; energy: (snapshots,) there; energies, kinetic: at more moments, the start too;
    steps: of the run; observables: of all of it, by their names in STATISTICS: rates in a time unit, means; motion: its size, the
    root mean square distance of what moves from the middle of it at the start, at LOOKS moments: for one particle this is how far
    it gets; 1 if nothing moves; seconds: with all snapshots, on the slowest rank; counted: `counted_seconds`, the same each time.
    """

    places: Array
    energy: Array
    energies: Array
    kinetic: Array
    steps: int
    observables: Errors
    motion: float
    seconds: float
    counted: float


def follow(start: Start, sim: Simulation, snapshots: int, patience: float = np.inf) -> Record:
    """Run a simulation to its end, and return its record. Collective; TooLongError after `patience` `counted_seconds`."""
    steps, began = sim.scene.steps, perf_counter()
    snapshot_steps, energy_steps = steps // snapshots, max(1, steps // ENERGY_SAMPLES)
    looks = {max(1, round(steps * (k * GOLDEN % 1.0))) for k in range(LOOKS)}
    places, at_snapshots, energies, spreads = [], [], [total_and_kinetic(sim)], []
    moments = {*looks, *range(energy_steps, steps, energy_steps), *range(snapshot_steps, steps, snapshot_steps), steps}
    for step in sorted(moments):
        sim.steps(step - sim.steps_done)
        if step in looks:
            spreads.append(start.spread(sim))
        if step % energy_steps == 0 or step == steps:
            energies.append(total_and_kinetic(sim))
            if patience < np.inf and step < steps and counted_seconds(sim) > patience:
                raise TooLongError(f"longer than {patience:.3g} s")
        if step % snapshot_steps == 0:
            places.append(all_particles(sim).position)
            at_snapshots.append(total_and_kinetic(sim)[0])
    sim.watch()
    found = np.array(places).reshape(snapshots, start.total, sim.scene.dimension)
    size = float(np.sqrt((sim.g**2).sum()))
    up = -sim.g / size if size > 0.0 else sim.g  # heights are those of the centre of all particles
    sums, kinetic = np.array(energies).T
    rates = (total_count(sim, name) / (steps * sim.h) for name in ("collisions", "wall_hits"))
    height = float((found.mean(axis=1) * up).sum(axis=1).mean()) if start.total else 0.0
    observables = dict(zip(STATISTICS, (*rates, float(kinetic[1:].mean()), height), strict=True))
    motion = sqrt(float(np.mean(spreads))) or 1.0
    cost = sim.ranks.largest(perf_counter() - began)[0], counted_seconds(sim)
    return Record(found, np.array(at_snapshots), sums, kinetic, steps, observables, motion, *cost)


def apart_all_along(start: Start, coarse: Scene, fine: Scene) -> float:
    """Return the largest distance of any particle between one run and another whose steps are so many times shorter.

    Over all steps of the coarse one, or as many of them as MOST_COMPARED allows: snapshots may all lie where nothing moves.
    Collective.
    """
    one, other = start.simulate(coarse), start.simulate(fine)
    ratio, most = fine.steps // coarse.steps, 0.0
    moments = max(1, min(MOST_MOMENTS, MOST_COMPARED // max(start.total, 1)))
    stride = -(-coarse.steps // moments)
    while one.steps_done < coarse.steps:
        number = min(stride, coarse.steps - one.steps_done)
        one.steps(number)
        other.steps(number * ratio)
        most = max(most, start.apart(all_particles(one).position, all_particles(other).position))
    return most


def total_and_kinetic(sim: Simulation) -> tuple[float, float]:
    """Return total and kinetic energy; the kinetic one twice if a force along a periodic axis has no potential."""
    row = sim.measure()
    return row["total_energy"] if isfinite(row["total_energy"]) else row["kinetic"], row["kinetic"]


def whole_parts(steps: float, snapshots: int) -> int:
    """Return the least number of steps, not below this one, that a number of snapshots divides."""
    return snapshots * max(1, int(np.ceil(steps / snapshots * (1.0 - 1e-12))))


def rms_distance(x: Array, center: Array) -> float:
    """Return the root mean square distance from a point."""
    return float(np.sqrt(((x - center) ** 2).sum(axis=-1).mean())) if len(x) else 0.0
