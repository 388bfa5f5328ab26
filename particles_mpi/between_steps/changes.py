"""What a user changes between two steps: fields of particles, options of effects, who is there. It counts from the next step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from particles_mpi.between_steps.effect_view import RunningEffect, changed_options
from particles_mpi.between_steps.particle_view import ParticleView
from particles_mpi.between_steps.state import State
from particles_mpi.errors import StateError
from particles_mpi.initial.checks import value_limits
from particles_mpi.initial.names import listed
from particles_mpi.initial.populate import add_population
from particles_mpi.measure import snapshot
from particles_mpi.parallel.agreement import raising_together, same_on_all
from particles_mpi.particles import OWN, Array
from particles_mpi.scene.active import fields_of
from particles_mpi.scene.effect import Force


class Changeable(State):
    """A state that its user may change. Going on is then the same, to the bit, as a new simulation of that state."""

    def take_changes(self) -> None:
        """What the user has written into `particles` becomes the state. Called wherever the state is used. Collective."""
        try:
            self.particles.collect()
        except StateError as error:
            raise StateError(f"step {self.steps_done + 1}: {error}") from None
        if self.rest and self.rest.pairs and self.ranks.allreduce_max(float(self.rows.edition != self.taken))[0]:
            self.forget_contacts()
        self.taken = self.rows.edition

    def check_values(self, values: dict[str, Array]) -> None:
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
        if issubclass(options.effect_class(), Force) and options.active and key != "active":
            self.replace_force(name)  # nothing else depends on it
            self.rows.edition += 1
            self.forget_contacts()
        else:
            self.build()

    def replace_force(self, name: str) -> None:
        """Take the force of this name from the scene anew. Collective."""
        raise NotImplementedError

    def add(self, population: Mapping[str, Any]) -> Array:
        """Add particles: the keys of a `[[particles]]` table, or arrays under these names. Returns their ids. Collective.

        All ranks give the same. Ids go on from the largest there ever was. Fields that were attached may be given too,
        and are 0 if not. Raises SceneError, as at the start, for particles that cannot be: overlapping others, outside, ...
        """
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
        self.build()
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
        self.build()

    def attach(self, name: str, values: Array) -> None:
        """Give every particle data of the user's own: `values` (N, ...) in id order, any numeric type. Collective.

        `sim.particles[name]` are this rank's rows from then on; they go where their particles go, to other ranks and into
        checkpoints. Nothing computes with them.
        """
        values = np.asarray(values)
        taken = name in OWN or name in fields_of(self.scene)  # FIELDS also has columns of effects that this scene lacks
        if taken or name in dir(ParticleView) or values.shape[:1] != (self.total,) or values.dtype.kind not in "biuf":
            raise ValueError(f"attach: {name!r} must be a new name, with an array of numbers for {self.total} particles")
        self.take_changes()
        ids = np.sort(np.concatenate(self.ranks.allgather(self.rows.id)))
        self.rows.arrays[name] = values[np.searchsorted(ids, self.rows.id)]
