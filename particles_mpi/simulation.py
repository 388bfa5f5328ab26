"""The class `Simulation`: a scene, its particles on all ranks, and the loop over time steps."""

from pathlib import Path
from typing import Any

import numpy as np

from particles_mpi.between_steps.saved import Saved, StepTrial
from particles_mpi.errors import SceneError, whole_number
from particles_mpi.initial.populate import populate
from particles_mpi.integrators.length_search import LengthSearch
from particles_mpi.kernels.validity import WATCH_EVERY
from particles_mpi.measure.diagnostics import Since, energies_and_momenta, observe
from particles_mpi.parallel.agreement import raising_together, require_finite, same_on_all
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Particles
from particles_mpi.results.notebook import LiveView
from particles_mpi.run.files import without_large_vtk
from particles_mpi.run.job import Job
from particles_mpi.scene.schema import Scene

RUN_OPTIONS = "quiet", "overwrite", "resumed", "steps", "wall_time"  # of `run`


class Simulation(Saved):
    """A scene in motion on the ranks of a communicator: `sim.step()` advances it by `sim.h`, `sim.run()` to the end of the scene.

    Between two steps a user may change the state: the fields of `sim.particles` (the rows of this rank, see `ParticleView`),
    `sim.time`, `sim.h` and the options of `sim.effects[name]`; `sim.add` and `sim.remove` add and remove particles. A change
    counts from the next step on. The simulation then goes on with the same bits as a new one that begins with that state
    (`State`).

    Raises SceneError for a scene that cannot be run, and StoppedError if the state is no longer valid, both on all ranks. If a
    script writes an impossible value into `particles`, StateError is raised on the rank where it did so; if it is not caught, all
    ranks end.
    """

    def __init__(self, scene: Scene, comm: Any = None, start: Particles | None = None):
        """`start`: all particles in id order, the same on every rank, in place of those that the scene describes."""
        if not isinstance(scene, Scene):
            raise TypeError(f"Simulation: {scene!r:.60} is not a Scene; use Scene.load(path) or Scene.from_dict(tables)")
        ranks = Communicator(comm)
        with raising_together(ranks):
            scene = scene.checked()
        same_on_all(ranks, scene.to_dict(), start.arrays if start else {})
        with raising_together(ranks):
            if start is None:
                rows, warnings = populate(scene, Communicator(ranks.comm))  # a copy: its messages are not counted
            else:
                rows, warnings = start.typed().select(np.arange(*ranks.share(len(start)))), []
        with raising_together(ranks):
            self.begin(scene, ranks, rows)
        self.warnings = warnings + without_large_vtk(self.scene.output, self.total)

    def step(self, *, collisions: bool = True) -> None:
        """Advance by one step; `collisions=False` lets particles pass through one another and through walls. Collective."""
        self.steps_at_once(1, collisions)

    def steps(self, number: int) -> None:
        """Advance by `number` steps: much faster than by `step` where `ManySteps` computes them. Collective."""
        last = self.steps_done + whole_number("steps", number)
        while self.steps_done < last:
            self.step_towards(last)

    def step_towards(self, last: int) -> None:
        """Advance by one step, or by several where `ManySteps` computes them at once, but not beyond step `last`. Collective."""
        if self.many_steps and "step" not in vars(self):  # else a user's own `step` is called each time
            self.steps_at_once(min([last, *(view.due(self.steps_done) for view in self.views)]) - self.steps_done)
        else:
            self.step()

    def steps_at_once(self, most: int, collisions: bool = True) -> None:
        """Advance by up to `most` steps where `ManySteps` computes them at once, otherwise by one. Collective."""
        self.take_changes()
        if not collisions:
            self.output_record.mark_rates("mixed", None)
        with self.stepping():
            done = self.many_steps.advance(self._h, self.steps_done, most) if self.many_steps and collisions else 0
            if not done:
                self.advance(self._h, collisions)
                done = 1
            self.particles.open()
            self.steps_done += done
        for view in self.views:
            view.after_step(self)

    def advance(self, h: float, contacts: bool = True, stop: bool = False) -> None:
        """Make one step of the integrator over a time h: its kicks and drifts, in order.

        `contacts`: if False, particles pass through one another and through walls. `stop`: the drift ends at the first collision.
        """
        if self.persistent:
            self.persistent.awake = contacts

        def drift(part: float) -> None:
            rates = self.drift.rates(self.g, self.accelerations.total, 0.5 * h)
            length = self._h if stop else part  # with `stop` h is a guess: the collision may be later
            self.drift.advance(length, self.time, rates, contacts, stop)

        self.integrator.advance(self.rows, h, drift)
        for name in self.active.on_velocities:
            self.calls[name] += 2

    def step_to_collision(self) -> tuple[int, int] | None:
        """Advance to the next collision of two particles, or by one step if there is none within it. Collective.

        Returns the ids of the two particles, the lower one first, or None. `sim.time` is then the time of the collision. The
        state is that at the end of a whole step of the length with which it ends at the contact. Under forces the time of the
        contact depends on that length, which is found by iteration. If there is no such length, because a contact begins to last
        within the step, the call makes a shorter step that ends there, and returns None (`LengthSearch`). Collisions at the same
        time are returned one by one, by further calls. In mode `rewind`, too, this drift follows the exact order of time. A call
        takes as long as a step, with forces as several, and every rank computes all of it: where there are many collisions, use
        `step`. Raises SceneError without collisions.
        """
        if self.active.pairs is None:
            raise SceneError("effects.collisions: step_to_collision needs it")
        self.take_changes()
        before = self.steps_done
        with self.stepping():
            met = self.advance_to_collision()
        for view in self.views if self.steps_done > before else ():
            view.after_step(self)
        return met

    def advance_to_collision(self) -> tuple[int, int] | None:
        """Do what `step_to_collision` describes, after `take_changes`, within `stepping`; returns the two ids, or None."""
        exact, free = self.drift.exact, not (self.active.forces or self.active.on_velocities)
        search = LengthSearch(self.h)
        while True:
            h, before = search.h, None if free else StepTrial(self)
            self.advance(h, stop=True)
            reached, met = exact.reached, exact.met
            if not met and h == self.h:
                self.particles.open()
                self.steps_done += 1
                return None
            if before is None or search.ends_with(reached - h, met is not None):
                break
            before.undo()
            if search.jump:
                self.advance(search.h)
                reached, met = search.h, None
                break
        self.clock_start = self.time + reached, self.steps_done
        self.particles.open()
        return met

    def run(self, output: str | Path | None = None, quiet: bool = True, **options: Any) -> None:
        """Step to the end of the scene; with `output` (a folder) write everything that the scene asks for. Collective.

        `quiet=False` prints the plan, the progress and the phase table. Further options, only with a folder: `overwrite=True`
        deletes what an earlier run left there; `resumed=True` continues the run in that folder, of which this is the state;
        `steps` is the number of the last step; after `wall_time` seconds the run writes a checkpoint and stops.
        """
        if unknown := options.keys() - RUN_OPTIONS:
            raise TypeError(f"run: {', '.join(sorted(unknown))}: not one of its options, {', '.join(RUN_OPTIONS)}")
        if output is not None:
            Job(self, Path(output), quiet=quiet, **options).run()
        elif options:
            raise TypeError(f"run: {', '.join(options)}: only with a folder for output")
        else:
            while self.steps_done < self.last_step:
                self.step_towards(self.last_step)
                if self.steps_done % WATCH_EVERY == 0 or self.steps_done == self.last_step:
                    self.watch()
        for view in self.views:
            view.finish()

    def view(self, every: int | None = None) -> None:
        """Show the particles in a notebook, now and every `every` steps (or `output.every` of the scene). Collective."""
        every = self.scene.output.every if every is None else whole_number("view: every", every, 1)
        self.views.append(LiveView(self, every))

    def watch(self) -> None:
        """Raise StateError if a particle is lost, outside, or not finite. Collective; cheap."""
        self.take_changes()
        with self.timers("watchdog"):
            self.watchdog.check(self.rows, self.steps_done)

    def measure(self, row: bool = False) -> dict[str, float]:
        """Return energies, momentum and largest speed of all particles, and observables if the scene has them. Collective.

        Rates of observables are those since the last call; for a `row` of diagnostics.csv, those since the row before.
        """
        self.take_changes()
        p = self.rows
        with np.errstate(over="ignore", invalid="ignore"):  # an error below if it is not finite
            gravity = "mutual_gravity" in self.scene.effects
            measured = energies_and_momenta(self.ranks, p, self.accelerations.potentials(p), gravity)
            if self.scene.output.observables:
                collisions = self.ranks.total(self.totals["collisions"])[0]
                volume = float(np.prod(self.upper - self.lower)) if self.scene.box else np.nan
                now, since = Since(self.time, self.steps_done, collisions), self.output_record.observed["row" if row else "call"]
                measured |= observe(self.ranks, p, volume, now, since, self.active.elastic)
        require_finite(self.ranks, p, measured["kinetic"], f"step {self.steps_done}")
        return measured

    def counted(self) -> dict[str, int]:
        """Return the work of this rank so far: searches for neighbours, ghosts, tests of pairs, interactions, windows of time."""
        return {"interactions": self.accelerations.interactions, **self.drift.work()}

    def work(self) -> dict[str, int]:
        """Return the work of all ranks so far, in units that are the same on every machine. Collective.

        forces: evaluations of all accelerations; interactions: pairs, or tree interactions in their place, that forces have
        computed; pair_tests: contact times of two spheres, in mode `rewind`; events: contacts with spheres and walls.
        """
        counted = self.counted()
        events = self.totals["collisions"] + self.totals["wall_hits"]
        interactions, pair_tests, events = self.ranks.total(counted["interactions"], counted["pair_tests"], events)
        forces = max((self.calls.get(name, 0) for name in self.forces), default=0)
        return {"forces": forces, "interactions": interactions, "pair_tests": pair_tests, "events": events}

    def remarks(self) -> list[str]:
        """Return what happened that a user should know, one line for each remark. Collective.

        Of the energy it tells only after a `run` into a folder, whose rows of diagnostics have it.
        """
        return self.drift.remarks() + self.output_record.energy_remarks
