"""One valid scene for a number, its particles one by one, and its states after each step: for tests of what must not matter."""

import copy

import numpy as np
from random_scenes import random_tables

from particles_mpi import Scene, SceneError, Simulation, StoppedError

MOST_STEPS = 20
COUNTS = ("collisions", "wall_hits", "missed")
CROWD = 100  # contacts in all: more follow one another so soon that they take no energy at last
CHAOS = 1e-7  # where round-off has grown to that, nothing is compared any more


def any_scene(seed, fits=lambda tables: True, change=lambda tables: tables):
    """The tables of a valid scene of at most three axes and MOST_STEPS steps, changed, that `fits`; particles one by one.

    Contacts that last are all solved in it, and none is missed: what else comes to pass depends on ids, and is told of.
    """
    rng = np.random.default_rng(seed)
    while True:
        tables = random_tables(rng)
        tables["time"]["steps"] = min(tables["time"]["steps"], MOST_STEPS)
        if tables["dimension"] > 3 or tables["time"]["integrator"] == "adaptive" or not fits(tables):
            continue
        try:
            tables = listed(change(tables))
            sim = Simulation(Scene.from_dict(tables))
            while sim.steps_done < tables["time"]["steps"] and not told(sim):
                sim.step()
        except (SceneError, StoppedError):
            continue
        if not (told(sim) or points_stick(tables)):
            return tables, rng


def told(sim):
    """Were there contacts that were missed, or not solved?"""
    return sim.totals["missed"] + sim.totals["unconverged"] > 0


def points_stick(tables):
    """Do points on a line lose energy? Of those at one place nothing but round-off tells who is on the right."""
    collisions = tables["effects"].get("collisions", {})
    return tables["dimension"] == 1 and 0.0 in tables["particles"][0]["radius"] and collisions.get("restitution", 1.0) < 1.0


def keeps_contacts(tables):
    """Are there forces and losses, with which contacts can last? They may within a step, and not be told of at its end."""
    return Simulation(Scene.from_dict(copy.deepcopy(tables))).persistent is not None


def listed(tables):
    """The same scene with all its particles in one population, each with numbers of its own."""
    tables = copy.deepcopy(tables)
    particles = columns(Simulation(Scene.from_dict(tables)))
    names = ["position", "velocity", "radius", "mass"]
    names += [name for name, effect in (("drag", "drag"), ("acceleration", "user_acceleration")) if effect in tables["effects"]]
    names += [name for name in ("spin", "moment_of_inertia") if name in particles]
    population = {name: particles[name].tolist() for name in names} | {"fixed": (particles["fixed"] != 0).tolist()}
    if tables["dimension"] == 2 and "spin" in population:
        population["spin"] = particles["spin"][:, 0].tolist()
    return tables | {"particles": [population]}


def columns(sim):
    """All fields in id order."""
    order = np.argsort(sim.particles.id)
    return {name: np.array(column[order]) for name, column in sim.particles.arrays.items()}


def states_of(tables, shaken=None):
    """[(fields in id order, counts)] at the start and after each step. `shaken`: by a bit of round-off, from this seed."""
    sim = Simulation(Scene.from_dict(copy.deepcopy(tables)))
    if shaken is not None:
        rng, p = np.random.default_rng(shaken), sim.particles
        size = 1e-14 * max(1.0, np.abs(p.position).max(initial=0.0))
        for name in ("position", "velocity"):
            p[name] = p[name] + size * (2.0 * rng.random(p[name].shape) - 1.0) * (p.fixed == 0)[:, None]
    states = [(columns(sim), [sim.totals[name] for name in COUNTS])]
    for _ in range(tables["time"]["steps"]):
        sim.step()
        states.append((columns(sim), [sim.totals[name] for name in COUNTS]))
    return states


def assert_same_bits(tables, other, fields=("position", "velocity", "spin"), back=None, first=None):
    """The states of two scenes, of the `first` particles, after each step; `back[name]` leads from those of the other one."""
    for k, ((here, counts), (there, others)) in enumerate(zip(states_of(tables), states_of(other), strict=True)):
        for name in fields:
            if name in here:
                values = back[name](there[name], k) if back else there[name]
                assert np.array_equal(here[name][:first], values[:first]), (tables, other, k, name)
        assert counts == others, (tables, other, k)


def assert_same_physics(tables, other, back):
    """As long as round-off has not grown, and contacts are few: 1e4 times what a shake by 1e-14 does, and 1e-9.

    Nothing is compared where contacts can last: they are solved to a tolerance, keep a gap that depends on the forces, and what
    presses each of a pile is not unique. Nor is a scene that is refused, or stopped, for all is too fast in it for the step, or
    spheres that touch overlap by round-off.
    """
    try:
        if keeps_contacts(tables) or keeps_contacts(other):
            return
        there_states = states_of(other)
    except (SceneError, StoppedError):
        return
    shaken = [states_of(tables, seed) for seed in range(2)]
    length = np.subtract(tables["box"]["upper"], tables["box"]["lower"]) if "box" in tables else np.ones(tables["dimension"])
    periodic = tables["box"]["periodic"] if "box" in tables else False

    def apart(name, one, two):
        distance = one[name] - two
        if name == "position":
            distance -= np.where(periodic, length * np.round(distance / length), 0.0)
        return np.abs(distance).max(initial=0.0)

    for k, ((here, counts), (there, others)) in enumerate(zip(states_of(tables), there_states, strict=True)):
        for name in {"position", "velocity", "spin"} & here.keys():
            grown = max(apart(name, here, states[k][0][name]) for states in shaken)
            if grown > CHAOS or max(counts) > CROWD or any(states[k][1] != counts for states in shaken):
                return
            size = max(1.0, np.abs(here[name]).max(initial=0.0), np.abs(there[name]).max(initial=0.0))
            assert apart(name, here, back[name](there[name], k)) <= 1e4 * grown + 1e-9 * size, (tables, other, k, name)
        soft = [tables["effects"].get(name, {}).get("restitution", 1.0) == 0.0 for name in ("collisions", "walls")]
        assert counts == others or any(soft), (tables, other, k)
