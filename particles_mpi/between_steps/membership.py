"""Adding and removing particles between two steps, and attaching data of the user's own to them."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from particles_mpi.between_steps.state import State
from particles_mpi.between_steps.views import ParticleView
from particles_mpi.errors import listed
from particles_mpi.initial.populate import add_population
from particles_mpi.parallel.agreement import raising_together, same_on_all
from particles_mpi.parallel.exact_sum import exact_sums
from particles_mpi.particles import BUILT_IN, Array
from particles_mpi.scene.active import fields_of
from particles_mpi.scene.model import python_values


class Membership(State):
    """A state to which particles, and data of the user's own for them, can be added and removed; all methods are collective."""

    def add(self, population: Mapping[str, Any]) -> Array:
        """Add particles: the keys of a `[[particles]]` table, or arrays, the same on all ranks. Returns their ids.

        New ids follow the largest id that was ever used. Attached fields may be given too, and are 0 if not. Raises SceneError,
        as at the start, for impossible particles: those that overlap others, lie outside, ...
        """
        given = python_values(population)
        same_on_all(self.ranks, {"add": given})
        if not isinstance(given, dict):
            raise TypeError(f"add: takes a dict with the keys of one [[particles]] table, not {population!r:.60}")
        self.take_changes()
        number = len(self.scene.particles) + self.additions
        with raising_together(self.ranks):
            rows, warnings = add_population(self.scene, self.ranks, self.rows, given, self.next_id, number)
        self.warnings += warnings
        added = self.ranks.total(len(rows) - len(self.rows))[0]
        if added:
            self.mark_rates("mixed")
        self.rows.replace(rows.arrays)
        self.particles.close()
        self.next_id += added
        self.additions += 1
        self.build()
        return np.arange(self.next_id - added, self.next_id)

    def remove(self, ids: Any) -> None:
        """Remove the particles whose ids any rank names; raises ValueError, on all ranks, for ids that no particle has."""
        self.take_changes()
        given = [np.asarray(of).reshape(-1) for of in self.ranks.allgather(ids)]
        if not all(of.dtype.kind in "iu" for of in given if len(of)):
            raise ValueError("remove: takes ids, which are integers; for a mask use sim.particles.id[mask]")
        named = np.unique(np.concatenate([of.astype(np.int64) for of in given]))
        here = np.isin(self.rows.id, named)
        if self.ranks.total(np.count_nonzero(here))[0] < len(named):
            found = np.concatenate(self.ranks.allgather(self.rows.id[here]))
            raise ValueError(f"remove: not found: {listed(np.setdiff1d(named, found))}")
        if "virial" in self.rows.arrays:  # from here on only collisions of the remaining particles count
            gone = exact_sums(self.ranks, [self.rows.virial[here]])[0]
            for since in self.output_record.observed.values():
                since.virial -= gone
        if len(named):
            self.mark_rates("mixed")
        self.rows.replace(self.rows.select(np.flatnonzero(~here)).arrays)
        self.particles.close()
        self.build()

    def attach(self, name: str, values: Array) -> None:
        """Attach a field of the user's own, or replace it: `values` (N, ...) in id order, any numeric type. Raises ValueError.

        `sim.particles[name]` then has the rows of this rank. They move with their particles, and are saved in checkpoints.
        """
        values = np.asarray(values)
        same_on_all(self.ranks, {"attach": [name, str(values.dtype), list(values.shape)]})
        taken = name in BUILT_IN or name in fields_of(self.scene)  # FIELDS also has columns of effects that this scene lacks
        if taken or name in dir(ParticleView) or not name.isidentifier() or name.startswith("_"):
            raise ValueError(f"attach: {name!r} must be a new name, of letters, digits and _, that begins with a letter")
        if values.shape[:1] != (self.total,) or values.dtype.kind not in "biuf":
            raise ValueError(f"attach: {name!r} needs an array of numbers with a row for each of {self.total} particles")
        same_on_all(self.ranks, {}, {name: values})
        self.take_changes()
        ids = np.sort(np.concatenate(self.ranks.allgather(self.rows.id)))
        self.rows.arrays[name] = values[np.searchsorted(ids, self.rows.id)]
        self.particles.forget(name)
