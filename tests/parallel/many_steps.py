"""Scenes by steps in one compiled loop and one by one: every field, count and frame must be the same.

Prints "the same" for each scene. `mpirun -n P python many_steps.py SCENES.json`.
"""

import json
import sys
from pathlib import Path
from zlib import crc32

import numpy as np

from particles_mpi import Scene, Simulation
from particles_mpi.contacts.drift import WORK
from particles_mpi.parallel.exchange import allgather_rows

STEPS = (1, 7, 2, 30)  # at once; together all of a scene


def state(sim):
    """All that a run may show of it."""
    every = allgather_rows(sim.ranks, sim.rows.arrays)  # which rank has which row may differ where particles collide
    order = np.argsort(every["id"])
    arrays = {name: crc32(np.ascontiguousarray(array[order])) for name, array in every.items()}
    counts = sim.work(), sim.calls, sim.totals
    if sim.active.pairs:  # a search for neighbours, of which there are fewer, has forces summed again
        searching = {*WORK, "exchanges", "forces", "interactions", *sim.forces}
        counts = tuple({name: number for name, number in of.items() if name not in searching} for of in counts)
    return arrays, repr(sim.measure()), *counts


for name, tables in json.loads(Path(sys.argv[1]).read_text()).items():
    compiled, single = (Simulation(Scene.from_dict(tables)) for _ in range(2))
    assert compiled.many_steps, f"{name}: not many steps at once"
    single.many_steps = None
    for number in STEPS:
        compiled.steps(number)
        for _ in range(number):
            single.step()
        ranks = compiled.ranks
        totals = [ranks.allreduce_sum(np.array(list(sim.totals.values()))) for sim in (compiled, single)]
        for sim in (compiled, single):
            sim.totals.update(zip(sim.totals, totals[sim is single].tolist(), strict=True))
        one, other = state(compiled), state(single)
        for part, (a, b) in enumerate(zip(one, other, strict=True)):
            assert a == b, f"{name}, {compiled.steps_done} steps, part {part}: {a} and {b}"
        for sim in (compiled, single):
            sim.totals.update(dict.fromkeys(sim.totals, 0))
    if ranks.is_root:
        print(f"{name}: the same")
