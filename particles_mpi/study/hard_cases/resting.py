"""Lasting contacts, and a ball that never stops."""

from functools import partial
from itertools import product
from typing import Any

import numpy as np

from particles_mpi import Simulation
from particles_mpi.neighbours.candidates import touching
from particles_mpi.study.experiment import all_particles, total_count
from particles_mpi.study.hard_cases.catalogue import MODES, CaseRun, Effects, Finding, case, energies, largest_rise

RESTITUTIONS = (0.0, 0.5, 0.9)


def under_gravity(run: CaseRun, e: float, step: float, upper: list[float], particles: dict[str, Any]) -> Simulation:
    """Return the tables of a box with gravity along the last axis, and restitution e at walls and between particles."""
    fall = {"acceleration": run.upright(-9.81)}
    effects: Effects = {"uniform_gravity": fall, "walls": {"restitution": e}, "collisions": {"restitution": e}}
    return run.simulate([particles], step, effects=effects, box={"lower": run.point(), "upper": upper}, seed=1)


def deepest_overlap(sim: Simulation) -> float:
    """Return the deepest overlap of two spheres, or of a sphere and the box, in mean radii; < 0 if none touch. Collective."""
    p, box = all_particles(sim), sim.scene.box
    assert box
    walls = np.maximum(box.lower - (p.position - p.radius[:, None]), p.position + p.radius[:, None] - box.upper).max()
    a, b = touching(p.position, p.radius, p.inverse_mass, p.id, np.zeros(sim.scene.dimension))
    apart = np.sqrt(((p.position[a] - p.position[b]) ** 2).sum(axis=1))
    return float(max(walls, (p.radius[a] + p.radius[b] - apart).max(initial=-np.inf)) / p.radius.mean())


@case("resting ball, e = 0, 0.5, 0.9", "bounces for ever, sinks, or gains energy", "kinetic energy exactly 0, energy never rises")
def ball(run: CaseRun) -> Finding:
    """A ball falls and comes to rest."""
    left, risen = [], -np.inf
    for e in RESTITUTIONS:
        ball = {"position": [run.upright(0.3, rest=0.5)], "radius": 0.05}
        sim = under_gravity(run, e, 0.005, run.point(rest=1.0), ball)
        risen = max(risen, np.diff(energies(sim, 900)).max())
        left.append(sim.measure()["kinetic"])
    return f"K {max(left):.0f}, E at most {risen:+.0e} a step", bool(max(left) == 0.0 and risen <= 1e-12)


@case(
    "resting columns of 10 and 50, e = 0, 0.5, 0.9", "sink into one another, buckle, or rattle", "K -> 0, overlap <= 1e-3 R, stay"
)
def columns(run: CaseRun) -> Finding:
    """Spheres above one another, a little apart, fall onto one another and stay there."""
    kinetic, deepest, moved = 0.0, -np.inf, 0.0
    for n, e in product((10, 50), RESTITUTIONS):
        column = {"position": [run.upright(0.05 + 0.102 * k, rest=0.5) for k in range(n)], "radius": 0.05}
        sim = under_gravity(run, e, 0.005, run.upright(0.12 * n + 1.0, rest=1.0), column)
        sim.steps(600)
        before = all_particles(sim).position
        sim.steps(100)
        kinetic = max(kinetic, sim.measure()["kinetic"])
        deepest = max(deepest, deepest_overlap(sim))
        moved = max(moved, float(np.abs(all_particles(sim).position - before).max()))
    holds = kinetic < 1e-20 and deepest <= 1e-3 and moved <= 1e-9
    return f"K {kinetic:.0e}, overlap {max(deepest, 0.0):.0e} R, moved {moved:.0e}", holds


def bed(run: CaseRun, count: int, layers: float, e: float, falls: float, lasts: float) -> Finding:
    """Let spheres fall from a loose heap for a time `falls`, and watch them for `lasts`."""
    d, step = run.dimension, 0.005
    side = round((count / layers) ** (1.0 / (d - 1)) * 0.1, 2)
    height = round(0.1 * layers * (3.0 if d == 3 else 2.2), 2)
    spheres = {"count": count, "position": "random", "radius": {"min": 0.045, "max": 0.05}}
    sim = under_gravity(run, e, step, run.upright(height, rest=side), spheres)
    rows, overlaps, heights = [sim.measure()], [], []
    steps = round((falls + lasts) / step)
    for n in range(steps):
        sim.step()
        rows.append(sim.measure())
        if sim.time >= falls and (n % max(steps // 50, 1) == 0 or n == steps - 1):
            overlaps.append(deepest_overlap(sim))
            heights.append(2.0 * float(all_particles(sim).position[:, -1].mean()))
    risen, kinetic = largest_rise(np.array([row["total_energy"] for row in rows])), [row["kinetic"] for row in rows]
    left, deepest, sunk = kinetic[-1] / max(kinetic), max(overlaps), 1.0 - min(heights) / heights[0]
    holds = risen <= 2e-6 and deepest <= 1e-3 and left <= 1e-4 and sunk <= 0.02
    return f"K/K_max {left:.0e}, overlap {max(deepest, 0.0):.0e} R, E rose {risen:.0e}, height {-sunk:+.1%}", holds


NAIVE_BED, STEADY_BED = "sinks, boils, or spheres leave the box", "K -> 0, overlap <= 1e-3 R, inside, height steady, E falls"


@case("beds of 200, e = 0, 0.5, 0.9", NAIVE_BED, STEADY_BED)
def small_beds(run: CaseRun) -> Finding:
    """Beds of six layers."""
    outcomes = [bed(run, 200, 6.0, e, 2.0, 2.0) for e in RESTITUTIONS]
    return "; ".join(measured for measured, _ in outcomes), all(holds for _, holds in outcomes)


for e, (lasts, long) in product(RESTITUTIONS, ((3.0, False), (10.0, True))):  # ten layers of a thousand spheres
    function = partial(bed, count=10000, layers=10.0, e=e, falls=2.0, lasts=lasts)
    case(f"bed of 10 000, {lasts:g} s, e = {e:g}", NAIVE_BED, STEADY_BED, dimensions=(3,), long=long)(function)


@case("1e5 bounces of an elastic ball between walls", "energy drifts", "energy drift <= 1e-9")
def bouncing(run: CaseRun) -> Finding:
    """`event` computes many bounces in a step; the steps of `rewind` are short."""
    place, speeds = [0.41, 0.52, 0.59], [10.0, 0.7 * 10.0, 0.3 * 10.0]
    ball = {"position": [place[: run.dimension]], "velocity": [speeds[: run.dimension]], "radius": 0.4}
    effects: Effects = {"walls": {}, "collisions": run.in_passes(60)}
    sim = run.simulate([ball], 5.0 if run.mode == "event" else 0.06, effects=effects, box=run.cube(1.0))
    before = sim.measure()["kinetic"]
    while (hits := total_count(sim, "wall_hits")) < 100000:
        sim.step()
    drift = abs(sim.measure()["kinetic"] / before - 1.0)
    return f"{drift:.0e} after {hits} bounces", drift <= 1e-9


@case("1e5 bounces under gravity", "energy off by g v h at each", "energy within 1e-9", modes=(None, *MODES), dimensions=(2,))
def bouncing_under_gravity(run: CaseRun) -> Finding:
    """A thousand balls bounce a hundred times each, with steps of a fiftieth of a flight and more."""
    heights = np.linspace(0.5, 1.5, 1000)
    balls = {"position": [[1.0 + k, float(z)] for k, z in enumerate(heights)], "radius": 0.1}
    effects: Effects = {"walls": {}, "uniform_gravity": {"acceleration": [0.0, -9.81]}}
    effects |= {"collisions": {}} if run.mode else {}
    sim = run.simulate([balls], 0.01, effects=effects, box={"lower": [0.0, 0.0], "upper": [1001.0, 10.0]})
    exact, most = 9.81 * heights, 0.0
    while total_count(sim, "wall_hits") < 100000:
        sim.step()
        p = all_particles(sim)
        off = (0.5 * p.velocity[:, 1] ** 2 + 9.81 * p.position[:, 1]) / exact - 1.0
        most = max(most, float(np.abs(off).max()))
    return f"each ball within {most:.0e}", most <= 1e-9
