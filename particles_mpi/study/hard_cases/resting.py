"""Contacts that last, and a ball that never stops."""

from typing import Any

import numpy as np

from particles_mpi import Simulation
from particles_mpi.neighbours.candidates import touching
from particles_mpi.study.hard_cases import MODES, Bench, case, everyone

RESTITUTIONS = (0.0, 0.5, 0.9)


def under_gravity(bench: Bench, e: float, step: float, box: list[float], particles: list[dict[str, Any]]) -> Simulation:
    """Particles in a box with gravity along the last axis; e at walls and between particles."""
    d = bench.dimension
    return bench.simulate(
        seed=1,
        box={"lower": [0.0] * d, "upper": box},
        time={"step": step, "steps": 1},
        particles=particles,
        effects={
            "uniform_gravity": {"acceleration": [0.0] * (d - 1) + [-9.81]},
            "walls": {"restitution": e},
            "collisions": {"restitution": e},
        },
    )


def deepest_overlap(sim: Simulation) -> float:
    """Of two spheres, or a sphere and the box, in mean radii; negative if nothing touches. Collective."""
    p, box = everyone(sim), sim.scene.box
    assert box
    walls = np.maximum(box.lower - (p.position - p.radius[:, None]), p.position + p.radius[:, None] - box.upper).max()
    a, b = touching(p.position, p.radius, p.inverse_mass, p.id, np.zeros(sim.scene.dimension))
    apart = np.sqrt(((p.position[a] - p.position[b]) ** 2).sum(axis=1))
    return float(max(walls, (p.radius[a] + p.radius[b] - apart).max(initial=-np.inf)) / p.radius.mean())


@case("resting ball, e = 0, 0.5, 0.9", "bounces for ever, sinks, or gets warm", "kinetic energy exactly 0, energy never rises")
def ball(bench: Bench) -> tuple[str, bool]:
    d, energies, risen = bench.dimension, [], -np.inf
    for e in RESTITUTIONS:
        ball = [{"position": [[0.5] * (d - 1) + [0.3]], "radius": 0.05}]
        sim = under_gravity(bench, e, 0.005, [1.0] * d, ball)
        before = sim.measure()["total_energy"]
        for _ in range(900):
            sim.step()
            now = sim.measure()["total_energy"]
            risen, before = max(risen, now - before), now
        energies.append(sim.measure()["kinetic"])
    return f"K {max(energies):.0f}, E at most {risen:+.0e} a step", max(energies) == 0.0 and risen <= 1e-12


@case(
    "resting columns of 10 and 50, e = 0, 0.5, 0.9", "sink into one another, buckle, or rattle", "K -> 0, overlap <= 1e-3 R, stay"
)
def columns(bench: Bench) -> tuple[str, bool]:
    d, kinetic, deepest, moved = bench.dimension, 0.0, -np.inf, 0.0
    for n in (10, 50):
        for e in RESTITUTIONS:
            places = [[0.5] * (d - 1) + [0.05 + 0.102 * k] for k in range(n)]
            sim = under_gravity(bench, e, 0.005, [1.0] * (d - 1) + [0.12 * n + 1.0], [{"position": places, "radius": 0.05}])
            for _ in range(600):
                sim.step()
            before = everyone(sim).position
            for _ in range(100):
                sim.step()
            kinetic = max(kinetic, sim.measure()["kinetic"])
            deepest = max(deepest, deepest_overlap(sim))
            moved = max(moved, float(np.abs(everyone(sim).position - before).max()))
    holds = kinetic < 1e-20 and deepest <= 1e-3 and moved <= 1e-9
    return f"K {kinetic:.0e}, overlap {max(deepest, 0.0):.0e} R, moved {moved:.0e}", holds


def bed(bench: Bench, count: int, layers: float, e: float, step: float, falls: float, lasts: float) -> tuple[str, bool]:
    """Spheres fall from a loose heap for a time `falls`, and are watched for `lasts`."""
    d = bench.dimension
    side = round((count / layers) ** (1.0 / (d - 1)) * 0.1, 2)
    height = round(0.1 * layers * (3.0 if d == 3 else 2.2), 2)
    spheres = {"count": count, "position": "random", "radius": {"min": 0.045, "max": 0.05}}
    sim = under_gravity(bench, e, step, [side] * (d - 1) + [height], [spheres])
    start = lowest = sim.measure()["total_energy"]
    risen, deepest, highest = 0.0, -np.inf, 0.0
    heights: list[float] = []
    steps = round((falls + lasts) / step)
    for n in range(steps):
        sim.step()
        row = sim.measure()
        risen, lowest = max(risen, (row["total_energy"] - lowest) / start), min(lowest, row["total_energy"])
        highest = max(highest, row["kinetic"])
        if sim.time >= falls and (n % max(steps // 50, 1) == 0 or n == steps - 1):
            deepest = max(deepest, deepest_overlap(sim))
            heights.append(2.0 * float(everyone(sim).position[:, -1].mean()))
    left, sunk = row["kinetic"] / highest, 1.0 - min(heights) / heights[0]
    holds = risen <= 1e-6 and deepest <= 1e-3 and left <= 1e-4 and sunk <= 0.02
    return f"K/K_max {left:.0e}, overlap {max(deepest, 0.0):.0e} R, E rose {risen:.0e}, height {-sunk:+.1%}", holds


NAIVE_BED, STEADY_BED = "sinks, boils, or spheres leave the box", "K -> 0, overlap <= 1e-3 R, inside, height steady, E falls"


@case("beds of 200, e = 0, 0.5, 0.9", NAIVE_BED, STEADY_BED)
def small_beds(bench: Bench) -> tuple[str, bool]:
    outcomes = [bed(bench, 200, 6.0, e, 0.005, 1.5, 1.5) for e in RESTITUTIONS]
    return "; ".join(told for told, _ in outcomes), all(holds for _, holds in outcomes)


@case("bed of 10 000, 10 s, e = 0", NAIVE_BED, STEADY_BED, dimensions=(3,), long=True)
def dead_bed(bench: Bench) -> tuple[str, bool]:
    return bed(bench, 10000, 10.0, 0.0, 0.005, 2.0, 10.0)


@case("bed of 10 000, 10 s, e = 0.5", NAIVE_BED, STEADY_BED, dimensions=(3,), long=True)
def large_bed(bench: Bench) -> tuple[str, bool]:
    return bed(bench, 10000, 10.0, 0.5, 0.005, 2.0, 10.0)


@case("bed of 10 000, 10 s, e = 0.9", NAIVE_BED, STEADY_BED, dimensions=(3,), long=True)
def lively_bed(bench: Bench) -> tuple[str, bool]:
    return bed(bench, 10000, 10.0, 0.9, 0.005, 2.0, 10.0)


@case("1e5 bounces of an elastic ball between walls", "energy drifts", "energy drift <= 1e-9")
def bouncing(bench: Bench) -> tuple[str, bool]:
    """Many bounces in a step by `event`, which needs no small ones; rewind's steps are short."""
    d, speed = bench.dimension, 10.0
    step = 5.0 if bench.mode == "event" else 0.06
    sim = bench.simulate(
        box={"lower": [0.0] * d, "upper": [1.0] * d},
        time={"step": step, "steps": 1},
        particles=[{"position": [[0.41, 0.52, 0.59][:d]], "velocity": [[speed, 0.7 * speed, 0.3 * speed][:d]], "radius": 0.4}],
        effects={"walls": {}, "collisions": {"passes": 60} if bench.mode == "rewind" else {}},
    )
    before, hits = sim.measure()["kinetic"], 0
    while hits < 100000:
        sim.step()
        hits = int(sim.ranks.allreduce_sum(sim.totals["wall_hits"])[0])
    drift = abs(sim.measure()["kinetic"] / before - 1.0)
    return f"{drift:.0e} after {hits} bounces", drift <= 1e-9


@case("1e5 bounces under gravity", "energy off by g v h at each", "energy within 1e-9", modes=(None, *MODES), dimensions=(2,))
def bouncing_under_gravity(bench: Bench) -> tuple[str, bool]:
    """A thousand balls, a hundred bounces each, with steps of a fiftieth of a flight and more."""
    heights = np.linspace(0.5, 1.5, 1000)
    sim = bench.simulate(
        box={"lower": [0.0, 0.0], "upper": [1001.0, 10.0]},
        time={"step": 0.01, "steps": 1},
        particles=[{"position": [[1.0 + k, float(z)] for k, z in enumerate(heights)], "radius": 0.1}],
        effects={"walls": {}, "uniform_gravity": {"acceleration": [0.0, -9.81]}, **({"collisions": {}} if bench.mode else {})},
    )
    exact, hits, most = 9.81 * heights, 0, 0.0
    while hits < 100000:
        sim.step()
        hits = int(sim.ranks.allreduce_sum(sim.totals["wall_hits"])[0])
        p = everyone(sim)
        off = (0.5 * p.velocity[:, 1] ** 2 + 9.81 * p.position[:, 1]) / exact - 1.0
        most = max(most, float(np.abs(off).max()))
    return f"each ball within {most:.0e}", most <= 1e-9
