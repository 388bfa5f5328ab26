"""F: softening. What it changes of the problem and what it spares, told apart: of an integrator's error, of the noise of few.

For particles that stand for a smooth sphere as W. Dehnen does, MNRAS 324, 273 (2001).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from math import pi, sqrt
from typing import Any

import numpy as np

from particles_mpi import Simulation
from particles_mpi.gravity.direct import attract
from particles_mpi.initial.plummer import MOST, plummer_places
from particles_mpi.measure import snapshot
from particles_mpi.particles import Array
from particles_mpi.study.accuracy.orbits import place_on_ellipse
from particles_mpi.study.measuring.experiment import Errors, Experiment, Lab, Row, Setting, slope

E, CLOSE = 0.9, 0.99  # eccentricities
SOFT, STEPS = (0.0, 1e-3, 1e-2), (500, 2000, 8000)  # softening, of the semi-major axis; steps an orbit
SOFTEST = 0.1  # for the closer encounter
TOLERANCES = 1e-11, 1e-6  # of the converged softened orbit, and of one to see that it is converged
ORBIT = {
    "total": "distance at the end from the place of the planet without softening, in semi-major axes",
    "model": "that of the softened orbit, without an error of the integrator",
    "numerical": "distance of leapfrog from that softened orbit",
}

N, SPHERES, PLACES = 4000, 30, 64  # particles of a sphere, how many are drawn, places where forces are looked at
SHELLS = 4000  # of the smooth sphere
WIDTHS = (0.01, 0.03, 0.1, 0.3)  # softening, of the scale length
FIELD = {
    "total": "root mean square of the force's error over that of the force of the smooth sphere",
    "model": "bias: that of the smooth sphere, softened",
    "numerical": "noise: what differs from one drawn sphere to another",
}


def orbit(lab: Lab, eps: float, n: int, e: float = E, **time: Any) -> Simulation:
    """A planet without mass about a sun that stands still, one orbit from the apocentre in n steps."""
    fall = {
        "position": [[-1.0 - e, 0.0], [0.0, 0.0]],
        "velocity": [[0.0, -sqrt((1.0 - e) / (1.0 + e))], [0.0, 0.0]],
        "mass": [0.0, 1.0],
    }
    time = {"step": 2.0 * pi / n, "steps": n, **time}
    effects = {"mutual_gravity": {"softening": eps}}
    return lab.simulate({"dimension": 2, "G": 1.0, "time": time, "particles": [fall], "effects": effects})


def end(sim: Simulation) -> Array:
    """Where the planet is at the end."""
    sim.run()
    return snapshot.gather_all(sim.ranks, sim.particles).position[0]


def away(a: Array, b: Array) -> float:
    return float(np.sqrt(((a - b) ** 2).sum()))


def kepler(lab: Lab) -> Experiment:
    """Each softening over the same steps: the numerical error shrinks along a curve, that of the model stays."""
    exact = place_on_ellipse(3.0 * pi, E)  # at the apocentre, after one orbit
    softened, unsure = {}, 0.0
    for eps in SOFT:
        softened[eps], rough = (end(orbit(lab, eps, 2, integrator="adaptive", tolerance=t)) for t in TOLERANCES)
        unsure = max(unsure, away(softened[eps], rough))
    unsure = max(unsure, away(softened[0.0], exact))

    def one(eps: float, n: int) -> Setting:
        def errors(sim: Simulation) -> Errors:
            place = end(sim)
            return {"total": away(place, exact), "model": away(softened[eps], exact), "numerical": away(place, softened[eps])}

        told = {"softening": eps, "steps": n}
        return Setting(f"softening {eps:g}", 2.0 * pi / n, lambda: orbit(lab, eps, n), n, errors, more=told)

    steps = STEPS[:2] if lab.quick else STEPS
    rows = lab.measure("softened orbit", [one(eps, n) for eps in SOFT for n in steps])
    reference = (
        f"exact: Kepler's equation; softened: adaptive at a tolerance of {TOLERANCES[0]:.0e}, within {unsure:.1e} of that at"
        f" {TOLERANCES[1]:.0e} and, without softening, of the exact place"
    )
    title = f"Softened Kepler orbit, e = {E:g}, one orbit by leapfrog"
    found = Experiment("F1", title, "step", ORBIT, reference, rows, (2.0,), unsure)
    found.answers = [*best_for_each_step(found), thrown_out(lab)]
    return found


def best_for_each_step(found: Experiment) -> Iterator[str]:
    """The softening with the least total error, and how both parts grow."""
    for n in dict.fromkeys(row.setting.more["steps"] for row in found.rows):
        rows = sorted((row for row in found.rows if row.setting.more["steps"] == n), key=lambda row: row.errors["total"])
        best, worst = rows[0], rows[-1]
        yield (
            f"{n} steps an orbit: the total error is least, {best.errors['total']:.1e}, with {best.setting.curve}"
            f" (model {best.errors['model']:.1e}, numerical {best.errors['numerical']:.1e});"
            f" with {worst.setting.curve} it is {worst.errors['total']:.1e}"
        )
    orders = ", ".join(f"{slope(found.curve(curve)[-2:], 'numerical'):.2f}" for curve in found.curves)
    yield f"the model error grows as softening^{power(found.rows, 'model'):.2f} at first; orders of the numerical one: {orders}"


def power(rows: Sequence[Row], error: str) -> float:
    """Of the softening in an error, from the two smallest that are not 0."""
    known = {row.setting.more["softening"]: row.errors[error] for row in rows if row.setting.more["softening"] > 0.0}
    x, y = sorted(known)[:2]
    a, b = known[x], known[y]
    return float(np.log(b / a) / np.log(y / x))


def thrown_out(lab: Lab) -> str:
    """What softening is for: an encounter that the step cannot follow."""
    n, exact = STEPS[0], place_on_ellipse(3.0 * pi, CLOSE)
    point, soft = (away(end(orbit(lab, eps, n, CLOSE)), exact) for eps in (0.0, SOFTEST))
    return (
        f"a closer encounter, e = {CLOSE:g}, in {n} steps: without softening the planet is thrown out and {point:.2g} away at the"
        f" end; with {SOFTEST:g} it is {soft:.2g} away, on an orbit, but on another one"
    )


def places(random: np.random.Generator, n: int) -> Array:
    """Of n particles of the sphere."""
    return plummer_places(random, 1.0, np.full(n, 1.0 / n))


def smooth_field(r: Array, eps: float) -> Array:
    """Inward force at radii r of the smooth sphere, of mass 1, each part of which attracts with softening.

    A shell of radius R has the potential -(|r + R| - |r - R|)/(2 r R), with |x| = (x^2 + eps^2)^(1/2). SHELLS of them
    hold the mass between cubes of equal steps, so that radii begin evenly.
    """
    u = (np.arange(SHELLS) + 0.5) / SHELLS
    shell, r = 1.0 / np.sqrt((MOST * u**3) ** (-2.0 / 3.0) - 1.0), r[:, None]
    outer, inner = np.sqrt((r + shell) ** 2 + eps**2), np.sqrt((r - shell) ** 2 + eps**2)
    steepness = (r + shell) / outer - (r - shell) / inner
    return ((outer - inner) / (2.0 * r * r * shell) - steepness / (2.0 * r * shell)) @ (3.0 * u * u / SHELLS)


@cache
def fields(n: int) -> dict[float, Errors]:
    """Errors of the field of n particles against that of the smooth sphere from which they are drawn, by softening.

    At places that are drawn like particles, so that all are weighted by mass.
    """
    random, mass = np.random.default_rng(1), np.full(n, 1.0 / n)
    at = places(random, PLACES)
    r = np.sqrt((at**2).sum(axis=1))
    exact = r * (r * r + 1.0) ** -1.5 / MOST  # the sphere is cut where the drawn ones end
    drawn = [places(random, n) for _ in range(SPHERES)]
    found = {}
    for eps in WIDTHS:
        seen = np.zeros((SPHERES, PLACES, 3))
        for x, field in zip(drawn, seen, strict=True):
            attract((0,) * 3, at, x, mass, eps * eps, field)
        bias, noise = ((smooth_field(r, eps) - exact) ** 2).mean(), seen.var(axis=0, ddof=1).sum(axis=1).mean()
        squares = zip(FIELD, (bias + noise, bias, noise), strict=True)
        found[eps] = {name: float(np.sqrt(square / (exact**2).mean())) for name, square in squares}
    return found


def plummer(lab: Lab) -> Experiment:
    """Softening of N particles that stand for a smooth sphere."""

    def one(eps: float) -> Setting:
        tables = {
            "dimension": 3,
            "G": 1.0,
            "time": {"step": 1e-6, "steps": 1},  # each with an evaluation of all forces
            "particles": [{"count": N, "position": {"plummer": 1.0}, "velocity": "equilibrium", "mass": 1.0 / N}],
            "effects": {"mutual_gravity": {"softening": eps}},
        }

        def errors(sim: Simulation) -> Errors:
            sim.sum_forces()
            return fields(N)[eps]

        return Setting("direct sum", eps, cache(lambda: lab.simulate(tables)), 1, errors, more={"softening": eps})

    rows = lab.measure("softened sphere", [one(eps) for eps in WIDTHS])
    title = f"Softened forces of {N} particles that stand for a smooth sphere"
    reference = f"exact: Plummer's formula, at {PLACES} places; noise over {SPHERES} spheres"
    found = Experiment("F2", title, "softening", FIELD, reference, rows)
    best = min(rows, key=lambda row: row.errors["total"])
    known = 0.98 * N**-0.26  # E. Athanassoula et al., MNRAS 314, 475 (2000), for Plummer spheres
    found.answers = [
        f"the error is least, {best.errors['total']:.2g}, with a softening of {best.setting.knob:g} scale lengths"
        f" (bias {best.errors['model']:.2g}, noise {best.errors['numerical']:.2g}); Athanassoula et al. (2000): {known:.2g}",
        f"at first the bias grows as softening^{power(rows, 'model'):.2f}, the noise falls as"
        f" softening^{power(rows, 'numerical'):.2f}; a force takes the same time with any",
    ]
    return found


def measure(lab: Lab) -> list[Experiment]:
    return lab.ranks.run_on_root(lambda: [kepler(lab.alone()), plummer(lab.alone())]) or []
