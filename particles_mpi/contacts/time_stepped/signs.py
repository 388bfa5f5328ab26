"""Signs that a step is too long for the passes of mode `rewind`: the drift is done exactly, or a remark follows at the end."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from particles_mpi.contacts.notes import ContactNotes
from particles_mpi.contacts.time_stepped.contact_search import NOTICEABLE, deepest_overlap
from particles_mpi.neighbours.candidates import Hits
from particles_mpi.neighbours.neighbour_list import Neighbourhood
from particles_mpi.neighbours.trajectories import fastest
from particles_mpi.particles import row_dot

if TYPE_CHECKING:
    from particles_mpi.contacts.event_driven.operator import EventDriven

DEEP = 0.5e-3  # of a radius: an overlap at the end of a drift that may not remain
SPEEDS_EVERY = 10  # drifts between two looks at the speeds, until one is too fast


class Signs:
    """Looks for overlaps in a drift, and counts, on this rank, what goes wrong without being counted as missed.

    Counted are late contacts, steps with more contacts than the passes put in order, and spheres that are too fast for the step.
    """

    def __init__(self, near: Neighbourhood):
        self.near = near
        self.drifts = SPEEDS_EVERY - 1  # the first drift is looked at: this may be made anew more often than every ten
        self.dense_steps, self.too_fast = 0, False
        self.collisions, self.late_collisions = 0, 0

    def look_at_speeds(self, h: float, drifts: int = 1) -> None:
        """Does a sphere cross more than its diameter in a drift over h? `drifts`: how many there were. A start with such a sphere
        is refused, but forces make spheres faster.
        """
        self.drifts += drifts
        if self.too_fast or self.drifts % SPEEDS_EVERY >= drifts:
            return
        p = self.near.particles
        if h * fastest(p.position, p.velocity) > 2.0 * p.radius.min(initial=np.inf, where=p.radius > 0.0):
            far = h * np.sqrt(row_dot(p.velocity, p.velocity)) > 2.0 * p.radius
            self.too_fast |= bool((far & (p.radius > 0.0)).any())

    def late(self, hits: Hits) -> bool:
        """Do spheres meet that already overlap? A pass may do a contact of one pair before an earlier one of another pair."""
        near, pairs = self.near, hits.second >= 0
        first, second, time = (column[pairs] for column in hits)
        return float(deepest_overlap(near.rows[0], near.spheres.radius, first, second, time, near.length)) > NOTICEABLE

    def overlapping(self, h: float) -> bool:
        """Does a supported particle overlap another one at the end, because a contact came late? Collective.

        In a pile such overlaps would add up; elsewhere spheres soon move apart.
        """
        if "supported" not in self.near.particles.arrays:
            return False
        near, (first, second, _, _) = self.near, self.near.candidates.pairs
        supported = np.zeros(len(near.x), bool)
        supported[: near.spheres.owned] = near.particles["supported"]
        pairs = supported[first] | supported[second]
        first, second, at_end = first[pairs], second[pairs], np.full(np.count_nonzero(pairs), h)
        most = deepest_overlap(near.rows[0], near.spheres.radius, first, second, at_end, near.length)
        return near.ranks.largest(most)[0] > DEEP

    def count(self, collisions: int, late: int = 0) -> None:
        """Add the counts of one drift."""
        self.collisions += collisions
        self.late_collisions += late

    def notes(self, exact: "Callable[[], EventDriven]") -> ContactNotes:
        """Return what may be wrong with the contacts so far; `exact`: returns the operator of the dense steps. Collective."""
        late, found, too_fast = self.near.ranks.total(self.late_collisions, self.collisions, self.too_fast)
        notes = ContactNotes(self.dense_steps, late=int(late), found=int(found), too_fast=int(too_fast))
        return notes + exact().notes() if self.dense_steps else notes
