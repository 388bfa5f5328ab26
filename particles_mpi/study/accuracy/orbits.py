"""A: regular orbits. Step against error in energy and in place, for each integrator."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import cos, pi, sin, sqrt
from typing import Any

import numpy as np

from particles_mpi import Simulation
from particles_mpi.measure import snapshot
from particles_mpi.particles import Array
from particles_mpi.study.measuring.experiment import Errors, Experiment, Lab, Setting, slope

E, ORBITS = 0.5, 10
LOOKS = 2000  # moments of a run at which the energy is looked at
ERRORS = {"energy": "largest |dE/E| of the run", "place": "distance at the end from the true place, over the size of the orbit"}
TOLERANCES = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11)  # of `adaptive`
REGIMES = {  # steps an orbit, quick ones
    "leapfrog": ((50, 100, 200, 400, 800, 1600, 3200), (100, 200, 400)),
    "order4": ((25, 50, 100, 200, 400, 800), (50, 100, 200)),
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


def gravity(tables: dict[str, Any], step: float, steps: int, integrator: str, tolerance: float | None = None) -> dict[str, Any]:
    """A scene of bodies that attract one another, with G = 1."""
    time: dict[str, Any] = {"step": step, "steps": steps, "integrator": integrator}
    if tolerance:
        time["tolerance"] = tolerance
    return {"dimension": 2, "G": 1.0, "time": time, "effects": {"mutual_gravity": {}}, **tables}


def settings(
    lab: Lab, tables: dict[str, Any], period: float, periods: int, errors: Callable[[Simulation], Errors]
) -> Iterator[Setting]:
    """Each integrator over a range of steps."""

    def one(curve: str, knob: float, n: int, integrator: str, tolerance: float | None = None) -> Setting:
        scene = gravity(tables, period / n, n * periods, integrator, tolerance)
        return Setting(curve, knob, lambda: lab.simulate(scene), n * periods, errors, integrator == "adaptive")

    for integrator, regimes in REGIMES.items():
        for n in regimes[lab.quick]:
            yield one(integrator, period / n, n, integrator)
    for tolerance in TOLERANCES[:3:2] if lab.quick else TOLERANCES:
        yield one("adaptive", tolerance, 2, "adaptive", tolerance)


def run(sim: Simulation, energy: Callable[[Simulation], float]) -> float:
    """To the end; the largest relative error of the energy on the way."""
    start, worst, every = energy(sim), 0.0, max(1, sim.scene.steps // LOOKS)
    while sim.steps_done < sim.scene.steps:
        sim.step()
        if sim.steps_done % every == 0:
            worst = max(worst, abs(energy(sim) / start - 1.0))
    return worst


def of_planet(sim: Simulation) -> float:
    """Energy of a unit of mass of the planet; on one rank or on all."""
    p = snapshot.gather_all(sim.ranks, sim.particles)
    return 0.5 * float((p.velocity[0] ** 2).sum()) - 1.0 / float(np.sqrt(((p.position[0] - p.position[1]) ** 2).sum()))


def place_on_ellipse(t: float, e: float = E) -> Array:
    """Kepler's equation u - e sin u = t, semi-major axis 1, pericentre on the positive axis at t = 0."""
    u = t = t - 2.0 * pi * round(t / (2.0 * pi))
    for _ in range(50):
        u -= (u - e * sin(u) - t) / (1.0 - e * cos(u))
    return np.array([cos(u) - e, sqrt(1.0 - e * e) * sin(u)])


def kepler(lab: Lab) -> Experiment:
    """A planet without mass on an ellipse of eccentricity 0.5 about a sun that stands still."""
    orbits = 3 if lab.quick else ORBITS

    def errors(sim: Simulation) -> Errors:
        energy = run(sim, of_planet)
        place = snapshot.gather_all(sim.ranks, sim.particles).position[0]
        return {"energy": energy, "place": float(np.sqrt(((place - place_on_ellipse(sim.time)) ** 2).sum()))}

    rows = lab.measure("Kepler", list(settings(lab, {"particles": [PLANET]}, 2.0 * pi, orbits, errors)))
    found = Experiment(
        "A1",
        f"Kepler, e = 0.5, {orbits} orbits",
        "step or tolerance",
        ERRORS,
        "exact: Kepler's equation",
        rows,
        (2.0, 4.0),
        1e-14,
    )
    found.answers = slopes(found)
    return found


def figure_eight(lab: Lab) -> Experiment:
    """Three equal masses on an eight, one period: where they were."""
    start = np.array(EIGHT["position"])

    def errors(sim: Simulation) -> Errors:
        energy = run(sim, lambda s: s.measure()["total_energy"])
        return {"energy": energy, "place": float(np.abs(snapshot.gather_all(sim.ranks, sim.particles).position - start).max())}

    rows = lab.measure("figure eight", list(settings(lab, {"particles": [EIGHT]}, PERIOD, 1, errors)))
    reference = "exact: after one period all are where they were (figures of Chenciner and Montgomery 2000)"
    found = Experiment("A2", "Figure eight, one period", "step or tolerance", ERRORS, reference, rows, (2.0, 4.0), 1e-14)
    found.answers = slopes(found)
    return found


def slopes(found: Experiment) -> list[str]:
    """What orders are seen where neither round-off nor long steps spoil them."""
    told = []
    for curve, floor, coarse in (("leapfrog", 1e-9, 1e-1), ("order4", 1e-12, 1e-3)):
        rows = found.curve(curve)
        for error in found.errors:
            fine = [row for row in rows if floor < row.errors[error] < coarse][-3:]
            if len(fine) > 1:
                told.append(f"{curve}: order {slope(fine, error):.2f} in {error}")
    return told


def measure(lab: Lab) -> list[Experiment]:
    return lab.ranks.run_on_root(lambda: [kepler(lab.alone()), figure_eight(lab.alone())]) or []
