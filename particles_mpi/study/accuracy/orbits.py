"""A and B: regular orbits and close encounters: step or tolerance against errors in energy and position, by each integrator."""

from collections.abc import Callable, Iterator
from math import cos, pi, sin, sqrt
from typing import Any

import numpy as np

from particles_mpi import Simulation
from particles_mpi.particles import Array
from particles_mpi.study.experiment import ENDLESS_STEPS, Benchmark, Errors, Experiment, Setting, all_particles, distance, slope

E, ORBITS = 0.5, 100
ENERGY_SAMPLES = 2000  # moments of a run at which the energy is measured
ERRORS = {
    "energy": "largest |dE/E| of the run",
    "place": "distance at the end from the true position, over the size of the orbit",
}
PLANET = {  # at the pericentre, without mass; and a sun
    "position": [[1.0 - E, 0.0], [0.0, 0.0]],
    "velocity": [[0.0, sqrt((1 + E) / (1 - E))], [0.0, 0.0]],
    "mass": [0.0, 1.0],
}
_X, _V, PERIOD = (0.97000435669733434, -0.24308753153583489), (-0.93240737144105230, -0.86473146092100096), 6.3259139829262117
EIGHT: dict[str, Any] = {
    "position": [list(_X), [-_X[0], -_X[1]], [0.0, 0.0]],
    "velocity": [[-_V[0] / 2, -_V[1] / 2], [-_V[0] / 2, -_V[1] / 2], list(_V)],
    "mass": 1.0,
}
PYTHAGOREAN = {"position": [[1.0, 3.0], [-2.0, -1.0], [1.0, -1.0]], "velocity": [0.0, 0.0], "mass": [3.0, 4.0, 5.0]}
LAST_MOMENT = 20.0
TRUE_PLACES = {10.0: (0.778480410138, 0.141392300290), 20.0: (3.004292636696, 0.511925235025)}  # by moment, of m = 3
LATE_PLACE = "place, t = 20"
ENCOUNTER_ERRORS = {
    "place, t = 10": "distance of m = 3 from where it is at t = 10, after an encounter of 0.01",
    LATE_PLACE: "the same at t = 20, after one of 0.0004",
    "energy": "|dE/E| at the end",
}
Ladder = dict[str, tuple[float, ...]]  # numbers of steps in a period, by integrator; tolerances of `adaptive`
REGULAR_LADDER: dict[bool, Ladder] = {  # by `quick`
    False: {
        "leapfrog": (50, 100, 200, 400, 800, 1600, 3200),
        "order4": (25, 50, 100, 200, 400, 800, 1600),
        "adaptive": (1e-3, 1e-5, 1e-7, 1e-9, 1e-11),
    },
    True: {"leapfrog": (100, 200, 400), "order4": (200, 400, 800, 1600), "adaptive": (1e-3, 1e-7)},
}
CLOSE_LADDER: dict[bool, Ladder] = {
    False: {"leapfrog": (4_000, 16_000, 64_000), "order4": (2_000, 8_000, 16_000), "adaptive": (1e-3, 1e-5, 1e-7, 1e-9)},
    True: {"leapfrog": (4_000, 16_000), "order4": (1_000, 4_000), "adaptive": (1e-3, 1e-5)},
}
PLOT: dict[str, Any] = {"parameter": "step or tolerance", "slopes": (2.0, 4.0)}


def gravity(
    population: dict[str, Any], step: float, steps: int, integrator: str = "leapfrog", tolerance: float | None = None,
    dimension: int = 2, **options: Any,
) -> dict[str, Any]:  # fmt: skip
    """Return the tables of a scene with bodies that attract one another, with G = 1; `options`: of mutual gravity."""
    time = {"step": step, "steps": steps, "integrator": integrator} | ({"tolerance": tolerance} if tolerance else {})
    effects = {"mutual_gravity": options}
    return {"dimension": dimension, "G": 1.0, "time": time, "effects": effects, "particles": [population]}


def plummer_sphere(n: int, step: float, **options: Any) -> dict[str, Any]:
    """Return the tables of a Plummer sphere of n particles, with mass and scale length 1, in equilibrium; one step."""
    stars = {"count": n, "position": {"plummer": 1.0}, "velocity": "equilibrium", "mass": 1.0 / n}
    return gravity(stars, step, 1, dimension=3, **options)


def settings(
    benchmark: Benchmark, bodies: dict[str, Any], ladder: Ladder, period: float, periods: int, frames: int, errors: Any
) -> Iterator[Setting]:
    """Yield each integrator over its ladder of steps or tolerances. `frames`: output steps of `adaptive` in a period.

    Steps of constant cost are timed in runs without an end, because a few hundred take less time than a call from Python.
    """
    for integrator, resolutions in ladder.items():
        for resolution in resolutions:
            if integrator == "adaptive":
                tables = gravity(bodies, period / frames, frames * periods, integrator, resolution)
                timed = ENDLESS_STEPS if bodies is not PYTHAGOREAN else frames * periods
                yield benchmark.setting(integrator, resolution, tables, errors, steps=timed)
            else:
                steps = round(resolution) * periods
                tables = gravity(bodies, period / resolution, steps, integrator)
                yield benchmark.setting(integrator, period / resolution, tables, errors, steps=ENDLESS_STEPS, seconds_of=steps)


def worst_energy(sim: Simulation, energy: Callable[[Simulation], float]) -> float:
    """Run to the end, and return the largest relative error of the energy on the way."""
    start, worst, every = energy(sim), 0.0, max(1, sim.scene.steps // ENERGY_SAMPLES)
    for _ in range(sim.scene.steps // every):
        sim.steps(every)
        worst = max(worst, abs(energy(sim) / start - 1.0))
    sim.run()
    return worst


def energy_of_planet(sim: Simulation) -> float:
    """Return the energy per unit mass of the planet. Collective."""
    p = all_particles(sim)
    return 0.5 * float((p.velocity[0] ** 2).sum()) - 1.0 / distance(p.position[0], p.position[1])


def place_on_ellipse(t: float, e: float = E) -> Array:
    """Kepler's equation u - e sin u = t, semi-major axis 1, pericentre on the positive axis at t = 0."""
    u = t = t - 2.0 * pi * round(t / (2.0 * pi))
    for _ in range(50):
        u -= (u - e * sin(u) - t) / (1.0 - e * cos(u))
    return np.array([cos(u) - e, sqrt(1.0 - e * e) * sin(u)])


def regular_orbits(benchmark: Benchmark) -> list[Experiment]:
    """Measure A, with the orders between the two shortest steps that round-off does not spoil.

    A massless planet moves on an ellipse around a fixed sun, and three equal masses on a figure eight for one period.
    """
    orbits = 3 if benchmark.quick else ORBITS

    def of_planet(sim: Simulation) -> Errors:
        energy = worst_energy(sim, energy_of_planet)
        return {"energy": energy, "place": distance(all_particles(sim).position[0], place_on_ellipse(sim.time))}

    def of_eight(sim: Simulation) -> Errors:
        energy = worst_energy(sim, lambda s: s.measure()["total_energy"])
        return {"energy": energy, "place": float(np.abs(all_particles(sim).position - np.array(EIGHT["position"])).max())}

    kepler = settings(benchmark, PLANET, REGULAR_LADDER[benchmark.quick], 2.0 * pi, orbits, 2, of_planet)
    eight = settings(benchmark, EIGHT, REGULAR_LADDER[benchmark.quick], PERIOD, 1, 2, of_eight)
    exact = "exact: after one period all bodies are back at their start (figures of Chenciner and Montgomery 2000)"
    problems = (
        ("A1", f"Kepler, e = 0.5, {orbits} orbits", kepler, ERRORS, "exact: Kepler's equation"),
        ("A2", "Figure eight, one period", eight, ERRORS, exact),
    )
    round_off = {"A1": {"energy": 1e-12, "place": 2e-13 * orbits**2}, "A2": {"energy": 1e-12, "place": 2e-13}}  # at most
    all_found = [benchmark.compare(*problem, floor=1e-14, **PLOT) for problem in problems]
    for found in all_found:
        for curve in ("leapfrog", "order4"):
            for error in found.errors:
                fine = [row for row in found.curve(curve) if row.errors[error] > round_off[found.key][error]][-2:]
                found.answers.append(f"{curve}: order {slope(fine, error):.2f} in {error}")
    return all_found


def close_encounters(benchmark: Benchmark) -> list[Experiment]:
    """Measure B: the Pythagorean problem, masses 3, 4 and 5 that fall from rest, by fixed steps and by adaptive ones."""

    def errors(sim: Simulation) -> Errors:
        start, found = sim.measure()["total_energy"], {}
        for moment, place in TRUE_PLACES.items():
            sim.steps(round(moment / sim.h) - sim.steps_done)
            found[f"place, t = {moment:g}"] = distance(all_particles(sim).position[0], place)
        return found | {"energy": abs(sim.measure()["total_energy"] / start - 1.0)}

    tried = settings(benchmark, PYTHAGOREAN, CLOSE_LADDER[benchmark.quick], LAST_MOMENT, 1, 200, errors)
    title, reference = "Pythagorean problem, t = 20", "published: twelve digits of two positions"
    found = benchmark.compare("B", title, tried, ENCOUNTER_ERRORS, reference, floor=1e-12, **PLOT)
    fixed = [row for row in found.rows if row.setting.curve != "adaptive"]
    best, chosen = (min(some, key=lambda r: r.errors[LATE_PLACE]) for some in (fixed, found.curve("adaptive")))
    found.answers = [
        f"fixed steps: {best.setting.curve}, {best.work['forces']} forces, {best.seconds.median:.2g} s, "
        f"wrong by {best.errors[LATE_PLACE]:.1g} at t = 20; "
        f"adaptive: {chosen.work['forces']} forces, {chosen.seconds.median:.2g} s, {chosen.errors[LATE_PLACE]:.1g}"
    ]
    return [found]
