"""A step that may be undone."""

import numpy as np

from particles_mpi.between_steps.state import State


class Trial:
    """What a step of a simulation changes, kept until it is known whether the step counts.

    Kept are the particles of this rank, what their lasting contacts took, and the counts. Work that was done stays counted.
    """

    def __init__(self, sim: State):
        self.sim = sim
        self.rows = sim.rows.select(np.arange(len(sim.rows)))
        self.totals, self.calls = sim.totals.copy(), sim.calls.copy()
        self.contacts = sim.persistent.remembered() if sim.persistent else None
        self.tc_elastic = sim.near.tc_elastic, sim.near.first_tc_elastic

    def undo(self) -> None:
        """Back to where it began; once."""
        sim = self.sim
        sim.rows.replace(self.rows.arrays)
        sim.totals.update(self.totals)
        sim.calls.clear()
        sim.calls.update(self.calls)
        if sim.persistent:
            sim.persistent.restore(self.contacts)
        sim.near.tc_elastic, sim.near.first_tc_elastic = self.tc_elastic
