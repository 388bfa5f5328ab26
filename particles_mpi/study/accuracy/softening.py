"""F: softening: the error that it adds, because it changes the problem, beside the error that it removes.

For an orbit the latter is the error of the integrator; for particles that stand for a smooth sphere it is the noise of their
finite number, as in W. Dehnen, MNRAS 324, 273 (2001).
"""

from functools import cache
from math import log, pi, sqrt
from typing import Any

import numpy as np

from particles_mpi import Simulation
from particles_mpi.gravity.direct import Attraction
from particles_mpi.initial.plummer import MASS_SHARE, plummer_places
from particles_mpi.particles import Array
from particles_mpi.study.accuracy.orbits import gravity, place_on_ellipse, plummer_sphere
from particles_mpi.study.experiment import Benchmark, Errors, Experiment, Setting, all_particles, distance, slope

E, LARGER_E = 0.9, 0.99  # eccentricities
SOFTENINGS, ORBIT_STEPS = (0.0, 1e-3, 1e-2), (500, 2000, 8000)  # softening, of the semi-major axis; steps an orbit
ENCOUNTER_SOFTENING = 0.1  # for the closer encounter
TOLERANCES = 1e-11, 1e-6  # of the converged softened orbit, and of one to see that it is converged
ORBIT = {
    "total": "distance at the end from the position of the planet without softening, in semi-major axes",
    "model": "that of the softened orbit, without an error of the integrator",
    "numerical": "distance of leapfrog from that softened orbit",
}

N, SPHERES, FIELD_PLACES = 4000, 30, 64  # particles of a sphere, how many are drawn, places where forces are looked at
SHELLS = 4000  # of the smooth sphere
FIELD_SOFTENINGS = (0.01, 0.03, 0.1, 0.3)  # softening, of the scale length
FIELD = {
    "total": "root mean square of the force's error over that of the force of the smooth sphere",
    "model": "bias: that of the smooth sphere, softened",
    "numerical": "noise: the difference between spheres drawn at random",
}


def orbit(benchmark: Benchmark, eps: float, n: int, e: float = E, **time: Any) -> Simulation:
    """Return the simulation of a massless planet around a fixed sun: one orbit from the apocentre in n steps."""
    places, speeds = [[-1.0 - e, 0.0], [0.0, 0.0]], [[0.0, -sqrt((1.0 - e) / (1.0 + e))], [0.0, 0.0]]
    fall = {"position": places, "velocity": speeds, "mass": [0.0, 1.0]}
    return benchmark.simulate(gravity(fall, 2.0 * pi / n, n, softening=eps, **time))


def end(sim: Simulation) -> Array:
    """Return the position of the planet at the end of the run. Collective."""
    sim.run()
    return all_particles(sim).position[0]


def kepler(benchmark: Benchmark) -> list[Experiment]:
    """Measure F1: each softening with the same steps: the numerical error falls, that of the model stays. Collective."""
    exact = place_on_ellipse(3.0 * pi, E)  # at the apocentre, after one orbit
    pairs = {eps: [end(orbit(benchmark, eps, 2, integrator="adaptive", tolerance=t)) for t in TOLERANCES] for eps in SOFTENINGS}
    softened = {eps: fine for eps, (fine, _) in pairs.items()}
    unsure = max(distance(softened[0.0], exact), *(distance(*pair) for pair in pairs.values()))

    def one(eps: float, n: int) -> Setting:
        def errors(sim: Simulation) -> Errors:
            place = end(sim)
            whole, model = distance(place, exact), distance(softened[eps], exact)
            return {"total": whole, "model": model, "numerical": distance(place, softened[eps])}

        return Setting(f"softening {eps:g}", 2.0 * pi / n, lambda: orbit(benchmark, eps, n), n, errors)

    steps = ORBIT_STEPS[:2] if benchmark.quick else ORBIT_STEPS
    reference = (
        f"exact: Kepler's equation; softened: adaptive at a tolerance of {TOLERANCES[0]:.0e}, within {unsure:.1e} of that at"
        f" {TOLERANCES[1]:.0e} and, without softening, of the exact place"
    )
    title = f"Softened Kepler orbit, e = {E:g}, one orbit by leapfrog"
    tried = [one(eps, n) for eps in SOFTENINGS for n in steps]
    found = benchmark.compare("F1", title, tried, ORBIT, reference, slopes=(2.0,), floor=unsure)
    for n in steps:
        rows = sorted((row for row in found.rows if row.setting.steps == n), key=lambda row: row.errors["total"])
        best, worst = rows[0], rows[-1]
        found.answers.append(
            f"{n} steps an orbit: the total error is least, {best.errors['total']:.1e}, with {best.setting.curve}"
            f" (model {best.errors['model']:.1e}, numerical {best.errors['numerical']:.1e});"
            f" with {worst.setting.curve} it is {worst.errors['total']:.1e}"
        )
    orders = ", ".join(f"{slope(found.curve(curve)[-2:], 'numerical'):.2f}" for curve in found.curves)
    small, large = SOFTENINGS[1:3]
    power = log(distance(softened[large], exact) / distance(softened[small], exact)) / log(large / small)
    grows = f"the model error grows as softening^{power:.2f} at first; orders of the numerical one: {orders}"
    far = place_on_ellipse(3.0 * pi, LARGER_E)
    point, soft = (distance(end(orbit(benchmark, eps, ORBIT_STEPS[0], LARGER_E)), far) for eps in (0.0, ENCOUNTER_SOFTENING))
    found.answers += [
        grows,
        f"a closer encounter, e = {LARGER_E:g}, in {ORBIT_STEPS[0]} steps: without softening the planet is thrown out and"
        f" {point:.2g} away at the end; with {ENCOUNTER_SOFTENING:g} it is {soft:.2g} away, on an orbit, but on another one",
    ]
    return [found]


def smooth_field(r: Array, eps: float) -> Array:
    """Return the inward force at radii r of the smooth sphere of mass 1 whose parts attract with softening.

    A shell of radius R has the potential -(|r + R| - |r - R|)/(2 r R), with |x| = (x^2 + eps^2)^(1/2). SHELLS of them
    hold the mass between cubes of equal steps, so that radii begin evenly.
    """
    u = (np.arange(SHELLS) + 0.5) / SHELLS
    shell, r = 1.0 / np.sqrt((MASS_SHARE * u**3) ** (-2.0 / 3.0) - 1.0), r[:, None]
    outer, inner = np.sqrt((r + shell) ** 2 + eps**2), np.sqrt((r - shell) ** 2 + eps**2)
    steepness = (r + shell) / outer - (r - shell) / inner
    return ((outer - inner) / (2.0 * r * r * shell) - steepness / (2.0 * r * shell)) @ (3.0 * u * u / SHELLS)


@cache
def fields(n: int) -> dict[float, Errors]:
    """Return the errors of the field of n particles relative to the smooth sphere from which they are drawn, by softening.

    They are measured at positions that are drawn like particles, so that all are weighted by mass.
    """
    random, mass = np.random.default_rng(1), np.full(n, 1.0 / n)
    at, *drawn = (plummer_places(random, 1.0, np.full(many, 1.0 / many)) for many in (FIELD_PLACES, *[n] * SPHERES))
    r = np.sqrt((at**2).sum(axis=1))
    exact = r * (r * r + 1.0) ** -1.5 / MASS_SHARE  # the sphere is cut where the drawn ones end
    found = {}
    for eps in FIELD_SOFTENINGS:
        sums = [Attraction(at, n, eps * eps) for _ in drawn]
        for one, x in zip(sums, drawn, strict=True):
            one.add(x, mass)
        forces = np.array([one.accelerations() for one in sums])
        bias, noise = ((smooth_field(r, eps) - exact) ** 2).mean(), forces.var(axis=0, ddof=1).sum(axis=1).mean()
        squares = zip(FIELD, (bias + noise, bias, noise), strict=True)
        found[eps] = {name: float(np.sqrt(square / (exact**2).mean())) for name, square in squares}
    return found


def plummer(benchmark: Benchmark) -> list[Experiment]:
    """Measure F2: softening of N particles that represent a smooth sphere. Collective."""

    def one(eps: float) -> Setting:
        def errors(sim: Simulation) -> Errors:
            sim.sum_forces()
            return fields(N)[eps]

        begin = cache(lambda: benchmark.simulate(plummer_sphere(N, 1e-6, softening=eps)))  # a step evaluates all forces once
        return Setting("direct sum", eps, begin, 1, errors)

    title = f"Softened forces of {N} particles that stand for a smooth sphere"
    reference = f"exact: Plummer's formula, at {FIELD_PLACES} places; noise over {SPHERES} spheres"
    found = benchmark.compare("F2", title, [one(eps) for eps in FIELD_SOFTENINGS], FIELD, reference, "softening")
    smallest, best = found.rows[:2], min(found.rows, key=lambda row: row.errors["total"])
    published = 0.98 * N**-0.26  # E. Athanassoula et al., MNRAS 314, 475 (2000), for Plummer spheres
    found.answers = [
        f"the error is least, {best.errors['total']:.2g}, with a softening of {best.setting.parameter:g} scale lengths"
        f" (bias {best.errors['model']:.2g}, noise {best.errors['numerical']:.2g}); Athanassoula et al. (2000): {published:.2g}",
        f"at first the bias grows as softening^{slope(smallest, 'model'):.2f}, the noise falls as"
        f" softening^{slope(smallest, 'numerical'):.2f}; a force takes the same time with any",
    ]
    return [found]
