"""The time loop."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from particles_mpi.between_steps.saved import Saved
from particles_mpi.contacts.drift import Drift, keeper_of_contacts
from particles_mpi.errors import StateError
from particles_mpi.initial.populate import populate
from particles_mpi.integrators.accelerations import Accelerations
from particles_mpi.integrators.choice import integrator_of
from particles_mpi.integrators.step_to_contact import step_to_contact
from particles_mpi.integrators.velocity_flow import Kick
from particles_mpi.measure.diagnostics import measure, observe
from particles_mpi.measure.watchdog import WATCH_EVERY, Watchdog
from particles_mpi.parallel.agreement import raising_together, require_finite, same_on_all
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Array, Particles
from particles_mpi.run.job import Job
from particles_mpi.scene.schema import Scene


class Simulation(Saved):
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
        warnings: list[str] = []
        with raising_together(ranks):
            particles, warnings = populate(scene) if start is None else (start, warnings)
        same_on_all(ranks, scene.to_dict(), particles.arrays)
        with raising_together(ranks):
            self.begin(scene, ranks, particles)
        self.warnings = warnings

    accelerations: Accelerations

    def build(self) -> None:
        """All that follows from the scene's effects and from how many particles there are. Collective."""
        before, scene, p = self.drift, self.scene, self.rows
        interactions = self.accelerations.interactions if before else 0
        context, effects = self.look_around()
        self.active = effects
        walls = effects.walls.planes if effects.walls else None
        none = np.empty((0, scene.dimension))
        planes = (walls.point, walls.normal) if walls else (none, none)
        self.watchdog = Watchdog(self.ranks, p.id, self.ids, planes, self.lower, self.length)
        self.rest = keeper_of_contacts(effects, context, scene.dimension)
        self.drift = Drift(p, context, effects, self.rest, self.sum_forces)
        if before:
            self.drift.continue_counts(before)
        self.accelerations = Accelerations(effects.forces, self.ranks, scene.dimension, self.drift.calls)
        self.accelerations.done_before += interactions
        self.kick = Kick(effects)
        self.integrator = integrator_of(scene, self.ranks, self.kick, self.rest)
        self.taken = p.edition
        self.particles.open()

    def step(self, collisions: bool = True) -> None:
        """Advance by one step; `collisions=False` lets particles pass through one another and through walls. Collective."""
        self.take_changes()
        try:
            self.particles.close()
            self.advance(self._h, collisions)
        except StateError as error:
            raise StateError(f"step {self.steps_done + 1}: {error}") from None
        self.particles.open()
        self.steps_done += 1

    def advance(self, h: float, contacts: bool = True, stop: bool = False) -> None:
        """One step of the integrator over h, with kicks and drifts in its order; `stop` ends its drift at a collision."""
        self.drift.middle = 0.5 * h
        if self.rest:
            self.rest.awake = contacts

        def drift(part: float) -> None:
            rates = self.drift.rates(self.accelerations.g, self.accelerations.total, self.kick.rate(self.rows))
            self.drift.advance(self._h if stop else part, self.time, rates, contacts, stop)

        self.integrator.advance(self.rows, h, self.sum_forces, drift, self.timers)
        for name in self.active.on_velocities:
            self.calls[name] += 2

    def sum_forces(self) -> Array | None:
        """Accelerations (n, d) of this rank's particles at the present positions, or None without forces. Collective."""
        return self.accelerations.sum(self.rows)

    def step_to_collision(self) -> tuple[int, int] | None:
        """Advance to the next collision of two particles, or by one step if there is none before its end. Collective.

        Returns the ids of the two that met, the lower one first, or None; `sim.time` is the moment. It is the end of a whole
        leapfrog step of the length that ends with the contact, found by iteration where forces make that depend on itself.
        Needs collisions in mode event. Collisions at the same moment come one call after the other.
        """
        return step_to_contact(self)

    def run(self, output: str | Path | None = None, quiet: bool = True, **options: Any) -> None:
        """Step to the end of the scene; with `output` (a folder) write everything the scene asks for. Collective."""
        if output is not None:
            Job(self, Path(output), quiet=quiet, **options).run()
            return
        while self.steps_done < self.last_step:
            self.step()
            if self.steps_done % WATCH_EVERY == 0 or self.steps_done == self.last_step:
                self.watch()

    def watch(self) -> None:
        """Raises StateError if a particle is lost, astray or not a number. Collective; cheap."""
        self.take_changes()
        with self.timers("watchdog"):
            self.watchdog.look(self.rows, self.steps_done)

    def measure(self) -> dict[str, float]:
        """Energies, momentum, largest speed of all particles: the same bits on any number of ranks. Collective.

        With `output.observables` also those of `observables`: rates are over the time since the last call.
        """
        self.take_changes()
        p = self.rows
        row = measure(self.ranks, p, self.accelerations.potentials(p))
        if self.scene.output.observables:
            collisions = int(self.ranks.allreduce_sum(self.totals["collisions"])[0])
            volume = float(np.prod(self.upper - self.lower)) if self.scene.box else np.nan
            row |= observe(self.ranks, p, volume, self.time, collisions, self.observed)
        require_finite(self.ranks, p, row["kinetic"], f"step {self.steps_done}")
        return row

    def replace_force(self, name: str) -> None:
        """Take the force of this name from the scene anew. Collective."""
        force = self.scene.effects[name].build(self.scene)
        force.bind(self.drift.context)
        self.accelerations.replace(name, force)
        self.active.all[name] = force

    @property
    def totals(self) -> dict[str, int]:
        """Collisions, wall hits, missed contacts and exchanges on this rank since the start."""
        totals: dict[str, int] = self.drift.totals
        return totals

    @property
    def calls(self) -> Any:
        """How often each effect was asked, by name."""
        return self.drift.calls

    @property
    def forces(self) -> dict[str, Any]:
        """The forces of the scene that are switched on, by name."""
        return self.accelerations.forces

    @property
    def g(self) -> Array:
        """The acceleration (d,) that all particles have in common."""
        return self.accelerations.g

    @property
    def near(self) -> Any:
        """Whoever knows the neighbours of this rank's particles; None without pairs that collide."""
        return self.drift.near

    @property
    def contacts(self) -> Any:
        """The operator that does the contacts of pairs, or None."""
        return self.drift.operator

    def counted(self) -> dict[str, int]:
        """Work of this rank so far: searches for neighbours, ghosts, tests of pairs, interactions, windows of time."""
        return {"interactions": self.accelerations.interactions, **self.drift.work()}

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

    def remarks(self) -> list[str]:
        """What happened that a user should know of, a line each. Collective."""
        return self.drift.remarks()
