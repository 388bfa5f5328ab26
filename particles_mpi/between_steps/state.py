"""The state of a simulation: its particles, its clock, its counts, and the scene that it goes by."""

from __future__ import annotations

from typing import Any

import numpy as np

from particles_mpi.between_steps.particle_view import ParticleView
from particles_mpi.contacts.drift import COUNTS
from particles_mpi.parallel.agreement import same_on_all
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import IdRange, id_range
from particles_mpi.particles import Array, Particles, default_values
from particles_mpi.scene.active import ActiveEffects, fields_of
from particles_mpi.scene.effect import Context
from particles_mpi.scene.schema import Scene, periodic_length
from particles_mpi.timers import Timers


class State:
    """What a simulation is at a moment between two steps. `Simulation` adds how it goes on.

    scene: what it goes by; ranks; rows: this rank's particles (`particles` is what a user sees of them); ids: where the ids of
    all lie; total: how many there are on all ranks; steps_done; warnings: of the start; next_id: of a particle that is added;
    reported, written: counts and steps at the last row of diagnostics and the last frame; observed: time, collisions and virial
    when the observables were last looked at.
    """

    scene: Scene
    ranks: Communicator
    rows: Particles
    ids: IdRange
    total: int
    rest: Any
    drift: Any

    def begin(self, scene: Scene, ranks: Communicator, everyone: Particles, next_id: int = 0) -> None:
        """Set all of it from all particles (in id order on every rank), of which this rank keeps its share. Collective.

        `next_id`: the id of the next particle that is added, if it is larger than those that are there tell.
        """
        if digests := scene.digests():
            same_on_all(ranks, {"contents of files of effects": digests})
        self.scene, self.ranks, self.timers = scene.running(), ranks, Timers()
        self.warnings: list[str] = []
        self.steps_done, self._h = 0, scene.time.step
        self.moment = 0.0, 0  # (time, steps done) that the clock counts from
        self.reported = [0] * len(COUNTS)
        self.written: dict[str, int] = {}
        self.observed = [0.0, 0.0, 0.0]
        self.additions = 0  # populations added while it ran
        self.rest = self.drift = None
        first, last = (len(everyone) * (ranks.rank + k) // ranks.size for k in (0, 1))
        self.rows = everyone.select(np.arange(first, last))
        self.rows.velocity[self.rows.fixed != 0] = 0.0
        self.particles_shown = ParticleView(self.rows, self.check_values)
        self.next_id = max(next_id, int(everyone.id.max(initial=-1)) + 1)
        d, box = scene.dimension, scene.box
        self.lower = np.array(box.lower, float) if box else np.zeros(d)
        self.upper = np.array(box.upper, float) if box else np.zeros(d)
        self.length = periodic_length(scene)
        self.build()

    def build(self) -> None:
        """All that follows from the scene's effects and from how many particles there are. Collective."""
        raise NotImplementedError

    def check_values(self, values: dict[str, Array]) -> None:
        """Raises StateError for values that no particle can have."""
        raise NotImplementedError

    def look_around(self) -> tuple[Context, ActiveEffects]:
        """What is there now: ids, columns and effects, told of one another. Collective."""
        p = self.rows
        p.version, p.edition = p.version + 1, p.edition + 1  # nothing that was known of the rows holds any longer
        self.ids = id_range(self.ranks, p.id)
        self.total = self.ids.total
        for name in fields_of(self.scene):
            if name not in p.arrays:
                p.arrays[name] = default_values(name, len(p), self.scene.dimension)
        context = Context(self.ranks, self.ids, self.timers, self.lower, self.upper, self.length)
        effects = ActiveEffects(self.scene)
        effects.bind(context)
        return context, effects

    @property
    def particles(self) -> ParticleView:
        """The particles of this rank, to be read and changed between two steps."""
        return self.particles_shown

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
        self.forget_contacts()

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
        self.forget_contacts()

    @property
    def last_step(self) -> int:
        """The number of the step with which the run ends: after `time.steps`, or nearest to `time.end`."""
        since, steps = self.moment
        end = self.scene.time.end
        return self.scene.steps if end is None else steps + max(0, round((end - since) / self._h))

    def forget_contacts(self) -> None:
        """What contacts carried belongs to a state that is no more. Collective."""
        if self.rest:
            self.rest.forget()
        self.taken = self.rows.edition  # changes up to here are known everywhere
