"""A step that may be undone."""

from particles_mpi.between_steps.saved import Saved


class Trial:
    """What a step of a simulation changes, kept until it is known whether the step counts.

    Kept are the particles of this rank, what their lasting contacts took, the counts of what happened, and the evaluations of
    forces. Interactions and pair tests that were done stay counted.
    """

    def __init__(self, sim: Saved):
        self.sim = sim
        self.rows, self.contacts = sim.rows.copy(), sim.lasting_contacts()
        self.totals, self.calls, self.tc_elastic = sim.totals.copy(), sim.calls.copy(), sim.near.tc_elastic

    def undo(self) -> None:
        """Back to where it began. Only once: the kept arrays are handed over."""
        sim = self.sim
        sim.rows.replace(self.rows.arrays)
        sim.totals.update(self.totals)
        sim.calls.clear()
        sim.calls.update(self.calls)
        if sim.persistent:
            sim.persistent.history.restore(self.contacts)
        sim.near.tc_elastic = self.tc_elastic
