"""Nine problems with a known truth, to judge `study recommend` by: does its setting reach the tolerance in truth?

Each is a scene with a careless step, the tolerance for an error, and the true error of a run that has come to its end, found
without the error metric of the study: from formulas, published figures, or what must not change.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi, sqrt
from typing import Any

import numpy as np

from particles_mpi import Scene, Simulation
from particles_mpi.study.accuracy.losses import DRAG, THROW, G
from particles_mpi.study.accuracy.losses import thrown as flight
from particles_mpi.study.accuracy.orbits import EIGHT, PERIOD, PLANET, PYTHAGOREAN, TRUE_PLACES, gravity, place_on_ellipse
from particles_mpi.study.experiment import all_particles, distance, total_count

Z_FLUID = 4.29498  # pV/(NkT) of hard spheres at a density of 0.6 (Kolafa, Labik, Malijevsky 2004)


@dataclass(frozen=True)
class Case:
    """`truth(sim, size)`: the true error at the end, in the units of the study, where `size` is that of the motion."""

    name: str
    scene: Scene
    error: str
    tolerance: float
    truth: Callable[[Simulation, float], float]


def away(sim: Simulation, size: float, row: int, place: Any) -> float:
    """Distance of one particle from its true place, over the size."""
    return distance(all_particles(sim).position[row], place) / size


def kepler(tolerance: float) -> Case:
    """Two orbits of e = 0.5 in steps of a hundredth of one."""
    scene = gravity(PLANET, 2.0 * pi / 100, 200, "leapfrog")
    name = f"Kepler, e = 0.5, two orbits, {tolerance:.0e}"
    return Case(name, Scene.from_dict(scene), "state", tolerance, lambda s, size: away(s, size, 0, place_on_ellipse(s.time)))


def eight() -> Case:
    """One period: all are back."""
    places = EIGHT["position"]
    scene = Scene.from_dict(gravity(EIGHT, PERIOD / 200, 200, "leapfrog"))
    return Case("figure eight", scene, "state", 1e-6, lambda s, size: max(away(s, size, k, places[k]) for k in range(3)))


def pythagorean() -> Case:
    """To t = 10, through the first close encounters."""
    tables = gravity(PYTHAGOREAN, 0.01, 1000, "leapfrog") | {"output": {"every": 1000}}
    scene = Scene.from_dict(tables)
    return Case("Pythagorean, t = 10", scene, "state", 1e-5, lambda s, size: away(s, size, 0, TRUE_PLACES[10.0]))


def thrown() -> Case:
    """Drag k = 0.5 and gravity."""
    effects = {"uniform_gravity": {"acceleration": [0.0, -G]}, "drag": {"rate": DRAG}}
    particles = [{"position": [[0.0, 0.0]], "velocity": list(THROW)}]
    scene = Scene(dimension=2, time={"step": 0.02, "steps": 100}, effects=effects, particles=particles)
    return Case("thrown, drag", scene, "state", 1e-6, lambda s, size: away(s, size, 0, flight(DRAG, s.time)[0]))


def rubbed() -> Case:
    """Friction alpha = m g under gravity, thrown horizontally at v: speed v/(1 + sin b) where the path is inclined by b."""
    g = v = 10.0
    effects = {"uniform_gravity": {"acceleration": [0.0, -g]}, "friction": {"strength": g}}
    particles = [{"position": [[0.0, 0.0]], "velocity": [v, 0.0], "mass": 1.0}]
    scene = Scene(dimension=2, time={"step": 0.05, "steps": 40}, effects=effects, particles=particles)
    return Case("thrown, friction", scene, "state", 1e-4, lambda s, size: away(s, size, 0, rubbed_place(s.time, v, g)))


def rubbed_place(t: float, v: float, g: float) -> tuple[float, float]:
    """Quadratures over the inclination b: dt = u db/(g cos b), dx = u^2 db/g, dy = -u^2 tan b db/g, with u = v/(1 + sin b)."""
    from scipy.integrate import quad
    from scipy.optimize import brentq

    def over(f: Callable[[float], float], b: float) -> float:
        return float(quad(f, 0.0, b, epsabs=1e-11, epsrel=1e-11, limit=200)[0])

    b = brentq(lambda b: over(lambda a: v / (1 + np.sin(a)) / (g * np.cos(a)), b) - t, 0.0, 0.5 * pi - 1e-9, xtol=1e-15)
    return (over(lambda a: (v / (1 + np.sin(a))) ** 2 / g, b), -over(lambda a: (v / (1 + np.sin(a))) ** 2 * np.tan(a) / g, b))


def gas() -> Case:
    """Elastic spheres at a density of 0.6, fifty collisions each: their rate, against that of the fluid."""
    n, edge = 1000, (1000 / 0.6) ** (1 / 3)
    box = {"lower": [0.0] * 3, "upper": [edge] * 3, "periodic": True}
    spheres = {"count": n, "position": "random", "velocity": {"temperature": 1.0}, "radius": 0.5, "mass": 1.0}
    time = {"step": 0.01, "steps": 500}
    scene = Scene(dimension=3, seed=2, box=box, time=time, particles=[spheres], effects={"collisions": {}})
    rate = (Z_FLUID - 1.0) * 6.0 / sqrt(pi)  # of a particle at T = 1
    return Case("hard spheres", scene, "collision rate", 0.02,
                lambda s, size: abs(2.0 * total_count(s, "collisions") / (n * s.time * rate) - 1.0))  # fmt: skip


def cluster() -> Case:
    """A Plummer sphere of a thousand, softened, for one dynamical time: the energy that it began with."""
    stars = {"count": 1000, "position": {"plummer": 1.0}, "velocity": "equilibrium", "mass": 0.001}
    effects = {"mutual_gravity": {"softening": 0.05}}
    scene = Scene(dimension=3, seed=1, G=1.0, time={"step": 0.05, "steps": 60}, particles=[stars], effects=effects)
    begin = bound(Simulation(scene), 0.05)
    return Case("Plummer sphere", scene, "energy", 1e-4, lambda s, size: abs(bound(s, 0.05) / begin - 1.0))


def bound(sim: Simulation, softening: float) -> float:
    """Energy, pair by pair."""
    p = all_particles(sim)
    x, v, m = p.position, p.velocity, p.mass
    r = np.sqrt(((x[:, None] - x[None]) ** 2).sum(axis=-1) + softening**2)
    pairs = (m[:, None] * m[None] / r).sum() - (m * m).sum() / softening
    return float(0.5 * (m * (v**2).sum(axis=1)).sum() - 0.5 * pairs)


CASES: tuple[Callable[[], Case], ...] = (
    lambda: kepler(1e-3),
    lambda: kepler(1e-6),
    lambda: kepler(1e-9),
    eight,
    pythagorean,
    thrown,
    rubbed,
    gas,
    cluster,
)
