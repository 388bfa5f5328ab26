"""J: rough spheres: a ball that slides and then rolls, for several steps; how far a bed of rough spheres creeps down a slope."""

from functools import cache
from math import cos, pi, sin
from typing import Any

import numpy as np

from particles_mpi import Simulation
from particles_mpi.kernels.geometry import image_shifts
from particles_mpi.study.accuracy.resting import G, R, bed
from particles_mpi.study.experiment import Benchmark, Errors, Experiment, all_particles, slope

MU, FLOOR = 0.2, [{"point": [0.0] * 3, "normal": [0.0, 0.0, 1.0]}]
BALLS, ROLL_TIME = 200, 0.6  # number of balls; seconds
SPEEDS = np.linspace(0.8, 1.2, BALLS)  # so many that the balls begin to roll anywhere in a step
ROLLING_STEPS = (0.02, 0.01, 0.005, 0.0025)
N, QUICK_N = 500, 150  # spheres of the bed
SLOPE = 10.0 * pi / 180.0  # slope of the bed: less than what a heap has
SETTLING_TIME, MEASURED_TIME, QUICK_MEASURED_TIME = 2.0, 2.0, 0.2  # seconds in which it settles, and those that are measured
STEP, TOLERANCE = 0.005, 1e-4
STEPS, TOLERANCES = (0.01, 0.005, 0.0025), (1e-2, 1e-3, 1e-4, 1e-5)
ROLLING = {
    "place": f"distance from the true position at t = {ROLL_TIME:g}, root mean square",
    "speed": "the same of the velocity",
}
LOOSE_WAY = 0.1  # radii: more than contacts give way
CREEP = {
    "creep": "median of how far the spheres still move, in radii per second",
    "loose": f"part of the spheres that move by more than {LOOSE_WAY:g} R in all",
    "energy": "how fast the energy changes, in the weight of the bed times R per second",
}


def sliding_balls(mode: str, step: float) -> dict[str, Any]:
    """Return the tables of balls side by side on a floor, thrown along it without spin."""
    balls = {"position": [[0.0, 1.5 * k, 0.5] for k in range(BALLS)], "velocity": [[v, 0.0, 0.0] for v in SPEEDS], "radius": 0.5}
    law = {"restitution": 0.5, "friction": MU}
    effects: dict[str, Any] = {"uniform_gravity": {"acceleration": [0.0, 0.0, -G]}, "walls": {"planes": FLOOR, **law}}
    effects |= {"collisions": {"mode": mode, **law}} if mode != "walls alone" else {}
    return {"dimension": 3, "time": {"step": step, "end": ROLL_TIME}, "particles": [balls], "effects": effects}


def rolling(benchmark: Benchmark) -> list[Experiment]:
    """Measure J1: a ball slides until t = 2 v/(7 mu g), then it rolls at 5/7 v. Collective."""

    def errors(sim: Simulation) -> Errors:
        sim.run()
        p, final = all_particles(sim), SPEEDS / 1.4
        begins = (SPEEDS - final) / (MU * G)
        true = 0.5 * (SPEEDS + final) * begins + final * (ROLL_TIME - begins)
        off = {"place": p.position[:, 0] - true, "speed": p.velocity[:, 0] - final}
        return {name: float(np.sqrt((wrong**2).mean())) for name, wrong in off.items()}

    tried = []
    for mode in ("walls alone", "rewind", "event"):
        for step in ROLLING_STEPS:
            tried.append(benchmark.setting(mode, step, sliding_balls(mode, step), errors, steps=round(ROLL_TIME / step)))
    found = benchmark.compare("J1", f"{BALLS} balls slide, then roll", tried, ROLLING, "exact", slopes=(1.0, 2.0), floor=1e-12)
    orders = ", ".join(f"{curve} {slope(found.curve(curve), 'place'):.2f}" for curve in found.curves)
    most = max(row.errors["speed"] for row in found.rows)
    found.answers = [f"order in place: {orders}", f"once they roll, the speed is right with any step: within {most:.0e}"]
    return [found]


def rough_bed(n: int, step: float, time: float, tolerance: float, particles: dict[str, Any] | None = None) -> dict[str, Any]:
    """Return the tables of about six layers on a rough, tilted floor; periodic along the slope and across it."""
    tables = bed(n, 6.0, step, round(time / step), tolerance, particles)
    box, effects = tables["box"], tables["effects"]
    box["upper"][2], box["periodic"] = 40.0 * R, [True, True, False]
    effects["uniform_gravity"]["acceleration"] = [G * sin(SLOPE), 0.0, -G * cos(SLOPE)]
    effects["walls"] |= {"friction": 0.5, "planes": FLOOR}
    effects["collisions"]["friction"] = 0.5
    effects["rolling"] = {"resistance": 0.05 * R}
    return tables


def creeping(benchmark: Benchmark) -> list[Experiment]:
    """Measure J2 and J3: continue a settled bed with several steps, and with several tolerances. Collective."""
    n, watched = (QUICK_N, QUICK_MEASURED_TIME) if benchmark.quick else (N, MEASURED_TIME)

    @cache
    def settled(step: float) -> dict[str, Any]:
        return benchmark.at_end(rough_bed(n, step, SETTLING_TIME, TOLERANCE), "position", "radius")

    def errors(sim: Simulation) -> Errors:
        before = all_particles(sim)
        sim.run()
        after = all_particles(sim)
        way = after.position - before.position
        way -= image_shifts(way, sim.scene.periodic_length)
        moved, speeds2 = np.sqrt((way**2).sum(axis=1)), (after.velocity**2).sum(axis=1)
        won = 0.5 * speeds2.mean() - G * (sin(SLOPE) * way[:, 0] - cos(SLOPE) * way[:, 2]).mean()
        return {
            "creep": float(np.median(moved)) / R / watched,
            "loose": float(np.mean(moved > LOOSE_WAY * R)),
            "energy": abs(float(won)) / G / R / watched,
        }

    def experiment(key: str, parameter: str, settings: list[tuple[float, float]]) -> Experiment:
        tried = []
        for step, tolerance in settings:
            value = step if parameter == "step" else tolerance
            tried.append(benchmark.setting("event", value, rough_bed(n, step, watched, tolerance, settled(step)), errors))
        title = f"A bed of {n} rough spheres on a slope, settled with the same step, {watched:g} s more, by {parameter}"
        found = benchmark.compare(key, title, tried, CREEP, "rest", parameter)
        creep, longer = [row.errors["creep"] for row in found.rows], found.rows[-1].seconds.median / found.rows[0].seconds.median
        found.answers = [
            f"it creeps by {min(creep):.1e} to {max(creep):.1e} R a second; {longer:.1f} times the seconds, first to last"
        ]
        return found

    return [
        experiment("J2", "step", [(step, TOLERANCE) for step in STEPS]),
        experiment("J3", "contact_tolerance", [(STEP, tolerance) for tolerance in TOLERANCES]),
    ]
