"""until_nobody_is_left.py SEED COUNT FILE: scenes at random from which particles are removed until none is left, then one comes.

Half of those who are there go, the lower or the higher ids, or all but those of one corner, which are then on one rank. Rank 0
writes what every number of ranks must come to, after each three steps, into FILE.
"""

import json
import sys
from hashlib import sha256

import numpy as np
from any_scene import COUNTS
from random_scenes import random_tables

from particles_mpi import Scene, SceneError, Simulation, StoppedError
from particles_mpi.errors import StateError
from particles_mpi.parallel.exchange import in_id_order


def state(sim):
    """Counts, energies, and a digest of all fields."""
    rows = in_id_order(sim.ranks, dict(sim.particles.arrays), sim.ids, 1)
    counts = sim.ranks.allreduce_sum(np.array([sim.totals[name] for name in COUNTS])).tolist()
    digest = sha256(b"".join(rows[name].tobytes() for name in sorted(rows))).hexdigest() if sim.ranks.is_root else ""
    return [sim.total, counts, {name: str(value) for name, value in sim.measure().items()}, digest]


def leaving(sim, rng):
    """The ids of those who go."""
    ids = np.concatenate(sim.ranks.allgather(sim.particles.id))
    places = np.concatenate(sim.ranks.allgather(sim.particles.position))[np.argsort(ids), 0]
    ids, half, how = np.sort(ids), (len(ids) + 1) // 2, rng.integers(3)
    if how == 2 and len(ids) > 2:
        return ids[places > np.sort(places)[len(ids) // 3]]
    return ids[:half] if how == 0 else ids[-half:]


def states(tables, rng, divided):
    sim = Simulation(Scene.from_dict(tables))
    if divided and sim.ranks.size > 1 and hasattr(sim.near, "windows"):
        sim.near.divided = sim.near.windows.always = True
    sim.steps(3)
    found = [state(sim)]
    while sim.total:
        sim.remove(leaving(sim, rng))
        sim.steps(3)
        sim.watch()
        found.append(state(sim))
    sim.copy().step()
    sim.add({"position": [[0.5] * tables["dimension"]], "radius": 0.1, "mass": 1.0})
    sim.steps(3)
    return [*found, state(sim)]


def main():
    seed, count, path = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
    rng, found = np.random.default_rng(seed), []
    while len(found) < count:
        tables = random_tables(rng)
        if tables["dimension"] > 3 or tables["time"]["integrator"] == "adaptive":
            continue
        try:
            found.append(states(tables, np.random.default_rng(len(found)), len(found) % 3 == 0))
        except (SceneError, StoppedError, StateError) as error:
            found.append(f"{type(error).__name__}: {error}".split(" on rank ")[0])
    if not Simulation(Scene(dimension=1, time={"step": 1.0, "steps": 1}, particles=[{"position": [[0.0]]}])).ranks.rank:
        with open(path, "w") as file:
            json.dump(found, file)


if __name__ == "__main__":
    main()
