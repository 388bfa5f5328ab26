"""The state of a simulation, which a user may change: its particles, its clock, its counts, and the scene that it computes."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from numbers import Real
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from particles_mpi.between_steps.options import RunningEffect, RunningEffects
from particles_mpi.between_steps.views import ParticleView
from particles_mpi.contacts.drift import COUNTS, Drift
from particles_mpi.errors import StateError, StoppedError
from particles_mpi.initial.checks import value_limits
from particles_mpi.integrators.kicks_and_drifts import Accelerations, Kick, integrator_of
from particles_mpi.integrators.many_steps import ManySteps
from particles_mpi.kernels.validity import find_invalid
from particles_mpi.measure.diagnostics import Since
from particles_mpi.measure.energy_change import Energies
from particles_mpi.measure.watchdog import Watchdog
from particles_mpi.parallel.agreement import describe_unexpected, same_on_all
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import id_range
from particles_mpi.parallel.signals import HeldInterrupt
from particles_mpi.particles import Array, Particles, default_values, moment_of_sphere
from particles_mpi.scene.active import ActiveEffects, fields_of
from particles_mpi.scene.effect import Context
from particles_mpi.scene.schema import Scene
from particles_mpi.timers import Timers


def is_number(value: Any) -> bool:
    """Is it one real number, of Python's or of numpy's?"""
    return isinstance(value, Real)


class OutputRecord:
    """How far the output of a simulation has come."""

    def __init__(self) -> None:
        self.reported = [0] * len(COUNTS)  # at the last row of diagnostics
        self.written: dict[str, int] = {}  # the steps of the last row and frame
        self.observed = {"row": Since(), "call": Since()}  # the last row with observables, and the last call of `measure`
        self.energies = Energies()  # of the rows of the run so far; of a script, of its last call of `run`
        self.energy_remarks: list[str] = []  # of the last run into a folder
        self.saved: tuple[Path, int, Any] | None = None  # folder, step and `identity_of` its last checkpoint

    def mark_rates(self, mark: str, moment: tuple[int, float] | None) -> None:
        """Remember what concerns the rates of an interval, `mixed` or `changed`: a step, or a change between two of them.

        moment: (steps done, time) of a change, which does not concern an interval that begins there; None for a step.
        """
        for since in self.observed.values():
            if moment != (since.step, since.time):  # of both: `step_to_collision` may end within a step
                setattr(since, mark, True)


class State:
    """What a simulation is between two steps. After a user has changed it, it goes on as a new simulation with that state would.

    A user sets: scene; time; h, the length of a step; particles; effects.

    Kept: ranks; rows, the particles of this rank, of which `particles` is the user's view; ids, the range of the ids on all
    ranks; total, how many particles there are on all ranks; next_id, that of the next particle to be added; additions, how often
    some were added; steps_done; clock_start, the time and the number of steps from which the clock counts. Counts of this rank
    since the start: totals, what happened, by the names in COUNTS; calls, how often each effect was called.

    For output: warnings, those of the start; output_record; views, which show the particles in a notebook.

    `build` makes from all this: context, active, watchdog, persistent, drift, near (the search for neighbours, or None),
    accelerations, forces (those that are switched on, by name), g (d,) (the acceleration that all particles have in common),
    kick, integrator, many_steps.
    """

    complete = False  # does it have every attribute that it ever has?
    broken = ""  # why the state cannot be used any more
    persistent: Any = None
    drift: Any = None
    accelerations: Any = None
    active: Any = None

    def __setattr__(self, name: str, value: Any) -> None:
        """Raise AttributeError for a name without a meaning here, such as `dt`: otherwise such a mistake would go unnoticed.

        A user's class that is derived from `Simulation` may have any attributes.
        """
        known = name in vars(self) or not self.complete or hasattr(type(self), name)
        if not known and type(self).__module__.startswith("particles_mpi."):
            raise AttributeError(
                f"sim.{name}: no such attribute; a script may set sim.h, sim.time, fields of"
                " sim.particles and options of sim.effects[name]"
            )
        super().__setattr__(name, value)

    def begin(self, scene: Scene, ranks: Communicator, rows: Particles, next_id: int = 0) -> None:
        """Set up the state with the particles of this rank. `next_id`: the least id of a particle that is added. Collective."""
        if digests := scene.digests():
            same_on_all(ranks, {"contents of effect files": digests})
        self.scene, self.ranks, self.timers = scene.running(), ranks, Timers()
        self.warnings: list[str] = []
        self.steps_done, self._h = 0, scene.time.step
        self.clock_start = 0.0, 0  # (time, steps done) that the clock counts from
        self.output_record = OutputRecord()
        self.views: list[Any] = []  # in a notebook
        self.additions = 0  # populations added while it ran
        self.rows = rows
        self.rows.hold_fixed()
        self._particles = ParticleView(self.rows, self.check_values)
        self.next_id = max(next_id, int(ranks.allreduce_max(rows.id.max(initial=-1))[0]) + 1)
        (self.lower, self.upper), self.length = scene.corners, scene.periodic_length
        self.build()
        self.complete = True

    def build(self) -> None:
        """Make everything that depends on the effects of the scene and on which particles there are. Collective."""
        p, scene, ranks = self.rows, self.scene, self.ranks
        old_drift, old_accelerations, had = self.drift, self.accelerations, self.active
        p.version, p.edition = p.version + 1, p.edition + 1  # nothing that was known of the rows holds any longer
        self.ids = id_range(ranks, p.id)
        self.total = self.ids.total
        for name in fields_of(scene):
            if name not in p.arrays:
                p.arrays[name] = default_values(name, len(p), scene.dimension)
                if name == "moment_of_inertia":
                    p.arrays[name] = moment_of_sphere(p.mass, p.radius, scene.dimension)
        self.context = Context(ranks, self.ids, self.timers, self.lower, self.upper, self.length)
        self.active = effects = ActiveEffects(scene)
        effects.bind(self.context)
        self.watchdog = Watchdog(ranks, p.id, self.ids, effects.planes, self.lower, self.length)
        self.persistent = None
        if effects.keeps_contacts:
            from particles_mpi.contacts.persistent.operator import PersistentContacts

            self.persistent = PersistentContacts(self.context, effects, p)
        self.drift = Drift(p, self.context, effects, self.persistent, self.sum_forces)
        if old_drift:
            self.drift.continue_counts(old_drift)
            if bool(had.pairs) != bool(effects.pairs):
                self.mark_rates("mixed")
            if had.elastic != effects.elastic:
                self.mark_rates("changed")
        self.totals, self.calls = self.drift.totals, self.drift.calls
        self.near = self.drift.near
        done = old_accelerations.interactions if old_accelerations else 0
        self.accelerations = Accelerations(effects.forces, ranks, scene.dimension, self.calls, done)
        self.forces, self.g = self.accelerations.forces, self.accelerations.g
        self.kick = Kick(effects, self.sum_forces, self.timers)
        self.integrator = integrator_of(scene, ranks, self.kick, self.persistent, self.drift.closing)
        self.look_for_many_steps()
        self.known_edition = p.edition
        self.particles.open()

    @contextmanager
    def stepping(self) -> Iterator[None]:
        """The context of a step: Ctrl-C waits for its end. If the step ends halfway, the state cannot be used any more."""
        step = self.steps_done + 1
        with HeldInterrupt():
            try:
                self.particles.close()
                self.broken = (
                    f"step {step} ended halfway: its particles are not all at one time;"
                    " continue from an earlier copy or a checkpoint"
                )
                yield
                self.broken = ""
            except StateError as error:
                raise StateError(f"step {step}: {error}") from None
            except SystemExit as error:  # of an effect: in a user's script other ranks would wait for this one
                raise StoppedError(describe_unexpected(error)) from error

    def look_for_many_steps(self) -> None:
        """Can many steps be computed at once, with these effects?"""
        parts = self.rows, self.context, self.active, self.accelerations, self.drift, self.integrator, self.persistent
        self.many_steps = ManySteps(*parts) if ManySteps.suit(self.active, self.total, self.persistent) else None

    def sum_forces(self) -> Array | None:
        """Accelerations (n, d) of this rank's particles at the present positions, or None without forces. Collective."""
        return self.accelerations.sum(self.rows)

    def take_changes(self) -> None:
        """Take over what the user has written into `particles`. To be called before the state is used. Collective."""
        if self.broken:
            raise StateError(self.broken)
        try:
            self.particles.collect()
        except StateError as error:
            raise StateError(f"step {self.steps_done + 1}: {error}") from None
        if self.persistent and self.persistent.needs_memory and self.ranks.any(self.rows.edition != self.known_edition):
            self.forget_contacts()
        self.known_edition = self.rows.edition

    def forget_contacts(self) -> None:
        """Forget the impulses of lasting contacts: they belong to the state before a change. Collective."""
        if self.persistent:
            self.persistent.history.forget()
        self.known_edition = self.rows.edition  # changes up to here are known everywhere

    def check_values(self, values: dict[str, Array]) -> None:
        """Raise StateError for values that no particle can have; it names the lowest id that was given one."""
        p = self.rows
        for name, allowed in value_limits(self.scene, p, values, self.h).items():
            wrong = np.flatnonzero(~allowed)
            if len(wrong):
                row = wrong[p.id[wrong].argmin()]
                given = ", ".join(f"{value:g}" for value in np.ravel(values[name][row]))
                raise StateError(
                    f"particles.{name}: particle {p.id[row]} on rank {self.ranks.rank} was given {given}, which is not possible"
                )
        if "position" in values and self.active.walls:
            fixed, planes, nowhere = values.get("fixed", p.fixed), tuple(self.active.walls.planes), np.zeros(p.dimension)
            _, row, wall = find_invalid((0,) * p.dimension, values["position"], p.velocity, fixed, planes, nowhere, nowhere)
            if row >= 0:
                raise StateError(f"particles.position: particle {p.id[row]} on rank {self.ranks.rank} was put beyond wall {wall}")
        if "fixed" in values:
            self.mark_rates("mixed")
        if "mass" in values or "radius" in values:
            self.mark_rates("changed")

    def mark_rates(self, mark: str) -> None:
        """Remember that something was changed now, for the rates of an interval that began before."""
        self.output_record.mark_rates(mark, (self.steps_done, self.time))

    @property
    def particles(self) -> ParticleView:
        """The particles of this rank, to be read and changed between two steps."""
        return self._particles

    @property
    def time(self) -> float:
        """The time of the state. Setting it moves the clock, and with it the times of last contacts; the same on all ranks."""
        since, steps = self.clock_start
        return since + (self.steps_done - steps) * self._h

    @time.setter
    def time(self, value: float) -> None:
        same_on_all(self.ranks, {"time": value})
        if not (is_number(value) and np.isfinite(value)):
            raise ValueError(f"time: {value!r} is not a finite number")
        value = float(value)  # not in the precision of what a script gives
        for since in self.output_record.observed.values():
            since.time = value - (self.time - since.time)  # exactly `value` if it was now
        if "contacted" in self.rows.arrays:  # times of the last contacts, by the same clock
            self.take_changes()
            self.rows.change({"contacted": self.rows["contacted"] + (value - self.time)})
            self.particles.show()
        self.clock_start = value, self.steps_done
        self.forget_contacts()

    @property
    def h(self) -> float:
        """The length of a step, from the next step on; all ranks must set the same value."""
        return self._h

    @h.setter
    def h(self, value: float) -> None:
        same_on_all(self.ranks, {"h": value})
        if not (is_number(value) and 0.0 < value < np.inf):
            raise ValueError(f"h: {value!r} is not a step length, which is a number above 0")
        self.clock_start = self.time, self.steps_done
        self._h = float(value)
        self.forget_contacts()

    @property
    def last_step(self) -> int:
        """The number of the step with which the run ends: after `time.steps`, or nearest to `time.end`."""
        since, steps = self.clock_start
        end = self.scene.time.end
        return self.scene.steps if end is None else steps + max(0, round((end - since) / self._h))

    @property
    def effects(self) -> Mapping[str, RunningEffect]:
        """The effects of the scene by name; setting an option of one changes the run. See `RunningEffect`."""
        return MappingProxyType(RunningEffects({name: RunningEffect(self, name) for name in self.scene.effects}))
