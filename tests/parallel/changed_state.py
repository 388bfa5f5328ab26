"""Change a simulation between two steps in every way that a user can, and compare it with new simulations of the same state.

changed_state.py CASES.json FOLDER: each case is {"tables": scene, "before": steps, "changes": [[kind, seed], ...],
"after": steps, "divided": whether to divide space}, and has a number. Prints a line for each difference, and saves the final
states for comparison between numbers of ranks.
"""

import json
import sys
from pathlib import Path

import numpy as np

from particles_mpi import Scene, SceneError, Simulation, StoppedError
from particles_mpi.errors import StateError
from particles_mpi.measure import snapshot
from particles_mpi.parallel.exchange import in_id_order

BOX = {"lower": [0, 0], "upper": [6, 6]}
DISCS = {"count": 24, "position": "random", "radius": {"min": 0.1, "max": 0.3}, "velocity": {"speed": 2.0}}
CHANGING = {"mass": {"min": 0.5, "max": 2.0}}
G = {"uniform_gravity": {"acceleration": [0.5, -3.0]}}
LOSSY = {"collisions": {"restitution": 0.6}, "walls": {"restitution": 0.6}}


ROUGH, ROLLING = {"friction": 0.4, "tangential_restitution": 0.3}, {"resistance": 0.005}


def scene(effects, **more):
    tables = {"dimension": 2, "seed": 3, "box": BOX, "time": {"step": 0.02, "steps": 1000}, "particles": [{**DISCS, **CHANGING}]}
    return tables | {"effects": effects} | more


def event(effects):
    return effects | {"collisions": effects["collisions"] | {"mode": "event"}}


def with_time(**time):
    return {"step": 0.02, "steps": 1000, **time}


ELASTIC = {"collisions": {}, "walls": {}}
DRIVEN = LOSSY | {"user_acceleration": {}, "drag": {"rate": 0.1}, "friction": {"strength": 0.05}}
ATTRACTED = {"mutual_gravity": {"G": 1.0, "softening": 0.05}}
SCENES = {
    "elastic": scene(ELASTIC),
    "periodic": scene({"collisions": {}}, box=BOX | {"periodic": True}),
    "heap": scene(LOSSY | G),
    "driven": scene(DRIVEN),
    "attracted": scene(LOSSY | ATTRACTED),
    "tree": scene({"mutual_gravity": {"G": 1.0, "method": "tree"}, "walls": {"restitution": 0.5}} | G),
    "walls alone": scene({"walls": {"restitution": 0.5}} | G),
    "no contacts": scene({"user_acceleration": {}, "drag": {"rate": 0.1}, "friction": {"strength": 0.05}} | G),
    "rough heap": scene({"collisions": LOSSY["collisions"] | ROUGH, "walls": LOSSY["walls"] | ROUGH, "rolling": ROLLING} | G),
    "rough walls alone": scene({"walls": LOSSY["walls"] | ROUGH} | G),
    "order4": scene(ATTRACTED | {"user_acceleration": {}}, time=with_time(integrator="order4")),
    "adaptive": scene(ATTRACTED | {"user_acceleration": {}}, time=with_time(integrator="adaptive", tolerance=1e-5)),
    "taylor": scene(ELASTIC | G | {"drag": {"rate": 0.1}}, time=with_time(integrator="taylor")),
}
SCENES |= {f"{name}, event": s | {"effects": event(s["effects"])} for name, s in SCENES.items() if "collisions" in s["effects"]}
# Of every particle the last contact is remembered, and what contacts gave it.
LASTING = {"collisions": {"restitution": 0.6, "mode": "event", "contact_duration": 10.0}, "walls": {"restitution": 0.6}}
FAST = [{**DISCS, **CHANGING, "velocity": {"speed": 20.0}}]
SCENES["remembered contacts, event"] = scene(LASTING, particles=FAST, output={"observables": True})


def change(sim, kind, seed):
    """One change, the same on any ranks. False if it does not concern the scene."""
    p, random, effects = sim.particles, np.random.default_rng(seed), sim.effects
    d = p.dimension
    of_all = random.random((sim.next_id, max(2, d)))
    mine, some = of_all[p.id][:, :d], of_all[p.id][:, 0] < 0.3
    if kind == "position":
        p.position += 1e-3 * (mine - 0.5)
    elif kind == "reversed":
        p.velocity *= -1
    elif kind == "swapped":
        p.velocity[:] = p.velocity[:, ::-1]
    elif kind == "velocity":
        p.velocity[some] = 3.0 * (mine[some] - 0.5)
    elif kind == "radius":
        p.radius[some] *= 1.2
    elif kind == "mass":
        p.mass[some] *= 10.0
    elif kind == "fixed":
        p.fixed[some] = True
    elif kind == "loose":
        p.fixed = some
    elif kind in ("drag", "acceleration"):
        if kind not in p.arrays:
            return False
        p[kind][some] = 0.5 if kind == "drag" else mine[some] - 0.5
    elif kind == "spin":
        if kind not in p.arrays:
            return False
        p.spin[some] = 9.0 * (mine[some, :1] - 0.5)
        p.moment_of_inertia[~some] *= 1.5
    elif kind == "met":  # when it had its last contact, and what contacts gave it
        if "contacted" not in p.arrays:
            return False
        p.contacted[some] = -np.inf
        if "virial" in p.arrays:
            p.virial[some] = 0.25
    elif kind == "friction":
        if "walls" not in effects:
            return False
        effects["walls"].friction = float(random.choice([0.0, 0.2]))
    elif kind == "time":
        sim.time = 12.5
    elif kind == "h":
        sim.h = 0.7 * sim.h
    elif kind == "g":
        if "uniform_gravity" not in effects:
            return False
        effects["uniform_gravity"].acceleration = np.resize([2.0, 1.0], d).tolist()
    elif kind == "G":
        if "mutual_gravity" not in effects:
            return False
        effects["mutual_gravity"].G = 2.5
    elif kind == "restitution":
        if "collisions" not in effects:
            return False
        effects["collisions"].restitution = float(random.choice([0.3, 1.0]))
    elif kind in ("off", "on"):
        if not effects:
            return False
        effects[list(effects)[seed % len(effects)]].active = kind == "on"
    elif kind == "add":
        sim.add({"count": 3, "position": "random", "radius": 0.05, "velocity": {"speed": 1.0}, "mass": 0.7})
    elif kind == "remove":
        sim.remove(np.flatnonzero(of_all[:, 0] < 0.2)[np.isin(np.flatnonzero(of_all[:, 0] < 0.2), all_ids(sim))])
    return True


KINDS = (
    "position", "reversed", "swapped", "velocity", "radius", "mass", "fixed", "loose", "drag", "acceleration", "spin", "met",
    "friction", "time", "h", "g", "G", "restitution", "off", "on", "add", "remove",
)  # fmt: skip


def all_ids(sim):
    return np.concatenate(sim.ranks.allgather(sim.particles.id))


def same(one, other, fields):
    a, b = (snapshot.gather_all(sim.ranks, sim.particles) for sim in (one, other))
    return [name for name in fields if a[name].tobytes() != b[name].tobytes()]


def differences(tables, before, changes, after, divided=False):
    """The simulation after all, and a text for each thing in which it differs from new ones of the same state."""
    sim = Simulation(Scene.from_dict(tables))
    divide(sim, divided)
    for _ in range(before):
        sim.step()
    sim.attach("charge", np.arange(sim.total, dtype=float))
    found = []
    old, clock = snapshot.gather_all(sim.ranks, sim.particles), (sim.scene, sim.time, sim.h)
    for kind, seed in changes:
        change(sim, kind, seed)
    if snapshot.same(old, snapshot.gather_all(sim.ranks, sim.particles)) and clock == (sim.scene, sim.time, sim.h):
        sim.h = sim.h  # a change too: what contacts carried is forgotten, which a fresh start does not know
    divide(sim, divided)
    twin = sim.copy()
    state = snapshot.gather_all(sim.ranks, sim.particles)
    fresh = Simulation(sim.scene, start=snapshot.gather_all(sim.ranks, sim.particles))
    fresh.time, fresh.h = sim.time, sim.h
    if "contacted" in state.arrays:  # times of the same clock; to set that has moved them
        fresh.particles.contacted[:] = state["contacted"][np.searchsorted(state["id"], fresh.particles.id)]
    for _ in range(after):
        for one in (sim, twin, fresh):
            one.step()
    found += [f"copy: {name}" for name in same(sim, twin, sim.particles.arrays)]
    found += [f"fresh: {name}" for name in same(sim, fresh, [n for n in sim.particles.arrays if n != "contacted"])]
    return sim, found


def divide(sim, divided):
    """Divide space between the ranks however few particles there are, in mode event."""
    if divided and sim.ranks.size > 1 and hasattr(sim.near, "windows"):
        sim.near.divided = sim.near.windows.always = True


def main():
    folder = Path(sys.argv[2])
    for number, case in json.loads(Path(sys.argv[1]).read_text()).items():
        try:
            sim, found = differences(**case)
        except (SceneError, StoppedError, StateError):  # a change that is refused, on all ranks
            continue
        rows = in_id_order(sim.ranks, dict(sim.particles.arrays), sim.ids, 1)
        if sim.ranks.is_root:
            for text in found:
                print(f"case {number}: {text}")
            np.savez(folder / f"{number}.{sim.ranks.size}.npz", time=sim.time, **rows)


if __name__ == "__main__":
    main()
