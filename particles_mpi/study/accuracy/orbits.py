"""A and B: orbits. Step or tolerance against errors in energy and place, by each integrator: regular, and close encounters."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import cos, pi, sin, sqrt
from typing import Any, NamedTuple

import numpy as np

from particles_mpi import Simulation
from particles_mpi.particles import Array
from particles_mpi.study.experiment import Benchmark, Errors, Experiment, Setting, distance, everyone, slope

E, ORBITS = 0.5, 10
LOOKS = 2000  # moments of a run at which the energy is measured
ERRORS = {"energy": "largest |dE/E| of the run", "place": "distance at the end from the true place, over the size of the orbit"}
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
END = 20.0
PLACES = {10.0: (0.778480410138, 0.141392300290), 20.0: (3.004292636696, 0.511925235025)}  # of m = 3, in twelve digits
FLOOR = 1e-12
LATE = "place, t = 20"
ENCOUNTER_ERRORS = {
    "place, t = 10": "distance of m = 3 from where it is at t = 10, after an encounter of 0.01",
    LATE: "the same at t = 20, after one of 0.0004",
    "energy": "|dE/E| at the end",
}


class Ladder(NamedTuple):
    """What is tried on a problem: numbers of steps of the fixed steps in a period, tolerances of `adaptive`."""

    leapfrog: tuple[int, ...]
    order4: tuple[int, ...]
    tolerances: tuple[float, ...]


REGULAR = {
    False: Ladder((50, 100, 200, 400, 800, 1600, 3200), (25, 50, 100, 200, 400, 800), (1e-3, 1e-5, 1e-7, 1e-9, 1e-11)),
    True: Ladder((100, 200, 400), (50, 100, 200), (1e-3, 1e-7)),
}
CLOSE = {
    False: Ladder((4_000, 16_000, 64_000), (2_000, 8_000, 16_000), (1e-3, 1e-5, 1e-7, 1e-9)),
    True: Ladder((4_000, 16_000), (1_000, 4_000), (1e-3, 1e-5)),
}


def gravity(
    population: dict[str, Any], step: float, steps: int, integrator: str = "leapfrog", tolerance: float | None = None,
    dimension: int = 2, **options: Any,
) -> dict[str, Any]:  # fmt: skip
    """A scene of bodies that attract one another, with G = 1; `options`: of mutual gravity."""
    time = {"step": step, "steps": steps, "integrator": integrator} | ({"tolerance": tolerance} if tolerance else {})
    effects = {"mutual_gravity": options}
    return {"dimension": dimension, "G": 1.0, "time": time, "effects": effects, "particles": [population]}


def plummer_sphere(n: int, step: float, **options: Any) -> dict[str, Any]:
    """Plummer's sphere of n particles, of mass and scale length 1, in equilibrium; one step."""
    stars = {"count": n, "position": {"plummer": 1.0}, "velocity": "equilibrium", "mass": 1.0 / n}
    return gravity(stars, step, 1, dimension=3, **options)


def settings(
    benchmark: Benchmark, bodies: dict[str, Any], ladder: Ladder, period: float, periods: int, frames: int, errors: Any
) -> Iterator[Setting]:
    """Each integrator over its ladder; `frames`: steps of `adaptive` in a period, between which it chooses its own."""
    for integrator in ("leapfrog", "order4"):
        for n in getattr(ladder, integrator):
            tables = gravity(bodies, period / n, n * periods, integrator)
            yield benchmark.setting(integrator, period / n, tables, errors)
    for tolerance in ladder.tolerances:
        tables = gravity(bodies, period / frames, frames * periods, "adaptive", tolerance)
        yield benchmark.setting("adaptive", tolerance, tables, errors)


def worst_energy(sim: Simulation, energy: Callable[[Simulation], float]) -> float:
    """Run to the end; the largest relative error of the energy on the way."""
    start, worst, every = energy(sim), 0.0, max(1, sim.scene.steps // LOOKS)
    while sim.steps_done < sim.scene.steps:
        sim.step()
        if sim.steps_done % every == 0:
            worst = max(worst, abs(energy(sim) / start - 1.0))
    return worst


def energy_of_planet(sim: Simulation) -> float:
    """Energy of a unit of mass of the planet. Collective."""
    p = everyone(sim)
    return 0.5 * float((p.velocity[0] ** 2).sum()) - 1.0 / distance(p.position[0], p.position[1])


def place_on_ellipse(t: float, e: float = E) -> Array:
    """Kepler's equation u - e sin u = t, semi-major axis 1, pericentre on the positive axis at t = 0."""
    u = t = t - 2.0 * pi * round(t / (2.0 * pi))
    for _ in range(50):
        u -= (u - e * sin(u) - t) / (1.0 - e * cos(u))
    return np.array([cos(u) - e, sqrt(1.0 - e * e) * sin(u)])


def kepler(benchmark: Benchmark) -> Experiment:
    """A planet without mass on an ellipse of eccentricity 0.5 about a sun that stands still."""
    orbits = 3 if benchmark.quick else ORBITS

    def errors(sim: Simulation) -> Errors:
        energy = worst_energy(sim, energy_of_planet)
        return {"energy": energy, "place": distance(everyone(sim).position[0], place_on_ellipse(sim.time))}

    rows = benchmark.measure("Kepler", list(settings(benchmark, PLANET, REGULAR[benchmark.quick], 2.0 * pi, orbits, 2, errors)))
    title, reference = f"Kepler, e = 0.5, {orbits} orbits", "exact: Kepler's equation"
    return Experiment("A1", title, "step or tolerance", ERRORS, reference, rows, (2.0, 4.0), 1e-14)


def figure_eight(benchmark: Benchmark) -> Experiment:
    """Three equal masses on an eight, for one period: where they were."""

    def errors(sim: Simulation) -> Errors:
        energy = worst_energy(sim, lambda s: s.measure()["total_energy"])
        return {"energy": energy, "place": float(np.abs(everyone(sim).position - np.array(EIGHT["position"])).max())}

    rows = benchmark.measure("figure eight", list(settings(benchmark, EIGHT, REGULAR[benchmark.quick], PERIOD, 1, 2, errors)))
    reference = "exact: after one period all are where they were (figures of Chenciner and Montgomery 2000)"
    return Experiment("A2", "Figure eight, one period", "step or tolerance", ERRORS, reference, rows, (2.0, 4.0), 1e-14)


def regular_orbits(benchmark: Benchmark) -> list[Experiment]:
    """A, with the orders that are seen where neither round-off nor long steps spoil them."""
    all_found = [kepler(benchmark), figure_eight(benchmark)]
    for found in all_found:
        for curve, floor, coarse in (("leapfrog", 1e-9, 1e-1), ("order4", 1e-12, 1e-3)):
            for error in found.errors:
                fine = [row for row in found.curve(curve) if floor < row.errors[error] < coarse][-3:]
                if len(fine) > 1:
                    found.answers.append(f"{curve}: order {slope(fine, error):.2f} in {error}")
    return all_found


def close_encounters(benchmark: Benchmark) -> list[Experiment]:
    """B: the Pythagorean problem, masses of 3, 4 and 5 that fall from rest, by fixed steps and by steps that follow forces."""

    def errors(sim: Simulation) -> Errors:
        start, found = sim.measure()["total_energy"], {}
        for moment, place in PLACES.items():
            while sim.steps_done < round(moment / sim.h):
                sim.step()
            found[f"place, t = {moment:g}"] = distance(everyone(sim).position[0], place)
        return found | {"energy": abs(sim.measure()["total_energy"] / start - 1.0)}

    rows = benchmark.measure("Pythagorean", list(settings(benchmark, PYTHAGOREAN, CLOSE[benchmark.quick], END, 1, 200, errors)))
    title, reference = "Pythagorean problem, t = 20", "published: twelve digits of two places"
    found = Experiment("B", title, "step or tolerance", ENCOUNTER_ERRORS, reference, rows, (2.0, 4.0), FLOOR)
    fixed = [row for row in rows if row.setting.curve != "adaptive"]
    best, chosen = (min(some, key=lambda r: r.errors[LATE]) for some in (fixed, found.curve("adaptive")))
    found.answers = [
        f"fixed steps: {best.setting.curve}, {best.work['forces']} forces, {best.seconds.median:.2g} s, "
        f"wrong by {best.errors[LATE]:.1g} at t = 20; "
        f"adaptive: {chosen.work['forces']} forces, {chosen.seconds.median:.2g} s, {chosen.errors[LATE]:.1g}"
    ]
    return [found]
