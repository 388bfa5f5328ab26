"""Valid scenes at random: any effects, integrators and modes together, in one to four dimensions.

The tests elsewhere take scenes that somebody thought of; these are the combinations that nobody did.
"""

from itertools import pairwise

import numpy as np

from particles_mpi import Scene, SceneError, Simulation, StoppedError


def whole_run(sim):
    """All steps of a simulation at once."""
    sim.steps(sim.scene.steps)


def random_scenes(seed, count, axes=3, mode=None, run=whole_run):
    """(name, tables, simulation after `run(sim)`) of `count` scenes in at most `axes` dimensions that are valid and not stopped.

    `mode`: only scenes with collisions, in this mode. The kernels of more than three axes are compiled when they are needed,
    which takes longer than all else.
    """
    rng, found = np.random.default_rng(seed), 0
    while found < count:
        tables = random_tables(rng)
        collisions = tables["effects"].get("collisions")
        if tables["dimension"] > axes or (mode and collisions is None):
            continue
        if mode:
            collisions["mode"] = mode
        try:
            sim = Simulation(Scene.from_dict(tables))
            run(sim)
        except (SceneError, StoppedError):
            continue
        yield f"{seed}-{found}", tables, sim
        found += 1


def random_tables(rng):
    """A scene of a few dozen particles; most are valid."""

    def chance(share):
        return rng.random() < share

    def one_of(*values):
        return values[rng.integers(len(values))]

    def vector(size):
        return (size * rng.standard_normal(d)).round(3).tolist()

    def surface():
        """Losses of a kind of contact, or none."""
        table = one_of({}, {"restitution": one_of(0.0, 0.3, 0.9)}, {"damping": one_of(0.05, 0.5)})
        if d in (2, 3) and integrator == "leapfrog" and "damping" not in table and chance(0.4):
            table = table | {"friction": one_of(0.1, 0.5)} | one_of({}, {"tangential_restitution": one_of(-0.5, 0.0, 0.6)})
        return table

    d = int(one_of(1, 2, 2, 2, 3, 3, 3, 4))
    integrator = one_of(*["leapfrog"] * 9, "order4", "taylor", "adaptive")
    hard = integrator in ("leapfrog", "taylor")
    boxed, count = chance(0.75), int(rng.integers(1, 60))
    periodic = [bool(flag) for flag in rng.random(d) < one_of(0.0, 0.5, 1.0)]
    effects = {}
    if chance(0.5):
        effects["uniform_gravity"] = {"acceleration": vector(5.0)}
    if chance(0.4) and not (boxed and any(periodic)):
        method = one_of("direct", "tree", "auto")
        effects["mutual_gravity"] = {"G": one_of(0.01, 0.3), "softening": one_of(0.05, 0.3), "method": method}
        if integrator == "adaptive":  # it would take minutes for close encounters
            effects["mutual_gravity"] |= {"G": 0.01, "softening": 0.3}
    if chance(0.3):
        effects["user_acceleration"] = {}
    if hard and chance(0.25):
        effects["drag"] = {"rate": one_of(0.1, 1.0)}
    if integrator == "leapfrog" and chance(0.25):
        effects["friction"] = {"strength": one_of(0.05, 0.5)}
    if hard and chance(0.8):
        effects["collisions"] = {"mode": one_of("rewind", "event")} | surface()
        if chance(0.2):
            few = {"passes": 1 + int(rng.integers(3))}
            effects["collisions"] |= (
                few if effects["collisions"]["mode"] == "rewind" else {"contact_duration": one_of(0.0, 0.1, 5.0)}
            )
    if hard and boxed and not all(periodic) and chance(0.8):
        effects["walls"] = surface()
    elif hard and not boxed and chance(0.5):
        effects["walls"] = {"planes": [{"point": [-2.0] * d, "normal": (np.abs(vector(1.0)) + 0.1).tolist()} | surface()]}
    rough = any("friction" in effects.get(name, {}) for name in ("collisions", "walls"))
    if chance(0.3) and rough:
        effects["rolling"] = {"resistance": 0.01}

    # Places: a grid, shaken, whose spheres touch one another or nearly so, or are far apart; some are one or two spheres wide.
    largest, gap = 0.2, one_of(0.0, 0.01, 0.2, 1.0)
    across = np.full(d, int(np.ceil(count ** (1.0 / d))))
    if d > 1 and chance(0.2):
        across[1:] = one_of(1, 2)
        across[0] = np.ceil(count / across[1:].prod())
    upper = across * (2.0 * largest + gap)
    places = np.stack(np.unravel_index(rng.permutation(across.prod())[:count], across), axis=1) + 0.5
    places = places * (2.0 * largest + gap) + 0.5 * gap * (rng.random((count, d)) - 0.5)
    cuts = sorted({0, count, *rng.integers(0, count + 1, one_of(0, 1, 2)).tolist()})
    populations = []
    for begin, end in pairwise(cuts):
        population = {
            "position": places[begin:end].tolist(),
            "velocity": one_of({"speed": one_of(0.5, 3.0)}, {"temperature": 1.0}, vector(1.0), [0.0] * d),
            "radius": one_of(largest, 0.1, {"min": 0.02, "max": largest}, 0.0),
            "mass": one_of(1.0, {"min": 0.1, "max": 5.0}, 1e3),
        }
        if chance(0.2):
            population["fixed"] = True if chance(0.5) else (rng.random(end - begin) < 0.5).tolist()
            population["velocity"] = [0.0] * d
        if "drag" in effects and chance(0.5):
            population["drag"] = 2.0
        if "user_acceleration" in effects and chance(0.7):
            population["acceleration"] = vector(3.0)
        if rough and chance(0.5) and "fixed" not in population:
            population["spin"] = one_of(-5.0, 10.0) if d == 2 else rng.standard_normal(3).round(2).tolist()
        if rough and chance(0.3):
            population["moment_of_inertia"] = 0.01
        populations.append(population)
    tables = {
        "dimension": d,
        "seed": int(rng.integers(1000)),
        "time": {"step": one_of(0.003, 0.01, 0.03, 0.1), "steps": int(rng.integers(10, 50)), "integrator": integrator},
        "particles": populations,
        "effects": effects,
    }
    if boxed:
        tables["box"] = {"lower": [0.0] * d, "upper": upper.tolist(), "periodic": periodic}
    if chance(0.2):
        tables["output"] = {"observables": True}
    return tables
