"""Seconds of a simulation by the work that it has counted, as if every machine were the same, on any number of ranks.

How much of a scene is measured, and against how good a reference, depends on what that takes. A clock would let it depend on the
machine and on the hour, and so would the errors that a study tells. The seconds here are those of one laptop's core, within a
factor of three in the scenes that come with the program.
"""

import numpy as np

from particles_mpi import Simulation

EVENT, INTERACTION = 1.2e-6, 1e-9  # of a contact; of a pair that attracts, or what a tree puts in its place
STEP, FORCE = 1e-4, 2e-5  # of a step, and of a sum of forces, where each is a call from Python
STEP_OF_MANY, FORCE_OF_MANY = 1e-6, 1e-7  # where `ManySteps` computes them
KEEPING = 5e-4  # more of a step where contacts may last
ROW, KEPT, RESTING = 8e-8, 2e-7, 5e-6  # of a particle in a step; more where contacts may last, and of one whose contacts do


def counted_seconds(sim: Simulation) -> float:
    """The counted seconds of all that a simulation has done so far, on all ranks. Collective."""
    work, many = sim.work(), sim.many_steps and not sim.active.pairs
    step = (STEP_OF_MANY if many else STEP) + ROW * sim.total
    if sim.persistent and not many:
        step += KEEPING + KEPT * sim.total + RESTING * sim.ranks.total(np.count_nonzero(sim.rows["supported"]))[0]
    force = FORCE_OF_MANY if many else FORCE
    return sim.steps_done * step + work["forces"] * force + work["interactions"] * INTERACTION + work["events"] * EVENT
