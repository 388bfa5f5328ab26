"""I: lasting contacts: what the tolerance of their solution costs in a bed of spheres, and what it changes."""

from typing import Any

import numpy as np

from particles_mpi import Simulation
from particles_mpi.particles import Array
from particles_mpi.study.experiment import Benchmark, Errors, Experiment, all_particles, slope
from particles_mpi.study.hard_cases.resting import deepest_overlap

TOLERANCES, EXACT_TOLERANCE = (1e-2, 1e-3, 1e-4, 1e-5), 1e-8
N, QUICK_N, STEP, SETTLING_STEPS = 2000, 600, 0.005, 400  # spheres; steps in which they fall and settle
STEPS, QUICK_STEPS = 400, 60  # that are measured
R, G, LAYERS = 0.05, 9.81, 8.0
ERRORS = {
    "height": "change of the mean height of the spheres at the end, in radii",
    "speed": "root mean square of the speeds at the end, in units of the speed that gravity gives in a step",
    "overlap": "deepest overlap, in radii",
    "energy": "largest rise of the total energy from one row to the next, in the weight of the bed times R",
}


def bed(
    n: int, layers: float, step: float, steps: int, tolerance: float, particles: dict[str, Any] | None = None
) -> dict[str, Any]:
    """Return the tables of n spheres in a box with gravity, e = 0.5, mode event; in the air, or as given by `particles`."""
    side, loose = 2.0 * R * (n / layers) ** 0.5, {"count": n, "position": "random", "radius": {"min": 0.9 * R, "max": R}}
    return {
        "dimension": 3,
        "seed": 1,
        "box": {"lower": [0.0] * 3, "upper": [side, side, 50.0 * R]},
        "time": {"step": step, "steps": steps},
        "particles": [{"mass": 1.0, **(particles or loose)}],
        "effects": {
            "uniform_gravity": {"acceleration": [0.0, 0.0, -G]},
            "walls": {"restitution": 0.5},
            "collisions": {"mode": "event", "restitution": 0.5, "contact_tolerance": tolerance},
        },
    }


def experiments(benchmark: Benchmark) -> list[Experiment]:
    """Measure I: continue a settled bed with each tolerance. Collective."""
    n, steps = (QUICK_N, QUICK_STEPS) if benchmark.quick else (N, STEPS)
    settled = benchmark.at_end(bed(n, LAYERS, STEP, SETTLING_STEPS, TOLERANCES[2]), "position", "radius")

    def heights(sim: Simulation) -> tuple[Array, float]:
        """Return (heights of all spheres at the end of the run, largest rise of the energy)."""
        before, rise = np.inf, 0.0
        for _ in range(10):
            sim.steps(steps // 10)
            energy = sim.measure()["total_energy"]
            rise, before = max(rise, energy - before), energy
        return all_particles(sim).position[:, 2], rise

    exact = heights(benchmark.simulate(bed(n, LAYERS, STEP, steps, EXACT_TOLERANCE, settled)))[0].mean()

    def errors(sim: Simulation) -> Errors:
        z, rise = heights(sim)
        speed = (all_particles(sim).velocity ** 2).sum(axis=1).mean() ** 0.5
        return {
            "height": abs(float(z.mean() - exact)) / R,
            "speed": float(speed) / (G * STEP),
            "overlap": max(deepest_overlap(sim), 0.0),
            "energy": rise / (n * G * R),
        }

    beds = {tolerance: bed(n, LAYERS, STEP, steps, tolerance, settled) for tolerance in TOLERANCES}
    settings = [benchmark.setting("event", tolerance, tables, errors) for tolerance, tables in beds.items()]
    title = f"A bed of {n} spheres that has settled, {steps * STEP:g} s more"
    reference = f"a solution at a tolerance of {EXACT_TOLERANCE:g}"
    found = benchmark.compare("I", title, settings, ERRORS, reference, "contact_tolerance")
    first, default, last = found.rows[0], found.rows[2], found.rows[-1]
    longer = (last.seconds.median / first.seconds.median) ** (1.0 / (len(found.rows) - 1))
    found.answers = [
        f"a tenth of the tolerance takes {longer:.1f} times as long; heights go as tolerance^{slope(found.rows, 'height'):.1f}",
        f"the default, {TOLERANCES[2]:g}: height within {default.errors['height']:.1e} R",
    ]
    return [found]
