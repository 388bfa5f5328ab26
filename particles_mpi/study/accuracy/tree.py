"""D: the tree. Opening angle against error of the force, with and without quadrupoles, and where the direct sum is cheaper."""

from collections.abc import Callable, Iterator, Sequence
from functools import cache
from math import exp, inf, log, nan
from typing import Any

import numpy as np

from particles_mpi import Simulation
from particles_mpi.gravity.method import choose
from particles_mpi.parallel.exchange import allgather_rows
from particles_mpi.particles import Array
from particles_mpi.study.accuracy.orbits import plummer_sphere
from particles_mpi.study.experiment import Benchmark, Errors, Experiment, Row, Setting, all_particles

SIZES, QUICK_SIZES = (500, 2000, 8000, 32_000), (500, 2000)
ANGLES = (1.0, 0.7, 0.5, 0.35)
DIRECT_SUM, TREE_CURVES = "direct sum", {"quadrupole": "quadrupoles", "monopole": "monopoles"}
COMPARED_ERROR = 1e-3  # median error at which trees and direct sum are compared
STEP = 1e-6  # dynamical times: every step has new positions, and an evaluation of all forces
CHECKED_PARTICLES = 100  # whose forces are summed once more with more digits
ERRORS = {"median": "median of |da|/|a| over all particles", "99 %": "99th percentile of |da|/|a|"}
BY_PARTICLE = {  # median errors at angles 1, 0.7, 0.5 where each particle walks by itself, N = 20 000
    "monopole": "1.1e-2, 3.5e-3, 1.3e-3",
    "quadrupole": "7.5e-3, 1.6e-3, 4.3e-4",
}


def settings(benchmark: Benchmark, n: int) -> Iterator[Setting]:
    """Yield the direct sum, whose forces are the reference for the others, and trees from coarse to fine.

        A step has one evaluation of the forces, and two kicks and a drift, about 10 ns per particle. The simulation is not begun
    anew for each sample, because an evaluation costs the same at any time.
    """
    exact: list[Array] = []  # accelerations of this rank's particles

    def errors(sim: Simulation) -> Errors:
        a = sim.sum_forces()
        assert a is not None
        if not exact:
            exact.append(a)
            wrong = round_off(sim, a)
        else:
            wrong = allgather_rows(sim.ranks, {"wrong": relative(a, exact[0])})["wrong"]
        return {"median": float(np.median(wrong)), "99 %": float(np.quantile(wrong, 0.99))}

    def one(curve: str, angle: float, **gravity: Any) -> Setting:
        begin = cache(lambda: benchmark.simulate(plummer_sphere(n, STEP, **gravity)))
        return Setting(curve, angle, begin, 1, errors)

    yield one(DIRECT_SUM, 0.0, method="direct")
    for multipole, curve in TREE_CURVES.items():
        for angle in ANGLES:
            yield one(curve, angle, method="tree", opening_angle=angle, multipole=multipole)


def relative(a: Array, exact: Array) -> Array:
    """|a - exact|/|exact|, row by row."""
    return np.sqrt(((a - exact) ** 2).sum(axis=1) / (exact**2).sum(axis=1)).astype(float)


def round_off(sim: Simulation, a: Array) -> Array:
    """Return the relative errors of some accelerations, from sums in extended precision. Collective."""
    p = all_particles(sim)
    arrived = allgather_rows(sim.ranks, {"id": sim.particles.id, "a": a})
    a = arrived["a"][np.argsort(arrived["id"], kind="stable")]
    x, some = p.position.astype(np.longdouble), np.arange(0, len(a), max(1, len(a) // CHECKED_PARTICLES))
    exact = np.empty((len(some), 3), np.longdouble)
    for k, i in enumerate(some):
        r = x - x[i]
        r2 = (r * r).sum(axis=1)
        r2[i] = inf
        exact[k] = ((p.mass / (r2 * np.sqrt(r2)))[:, None] * r).sum(axis=0)
    return relative(a[some], exact)


def at_error(rows: Sequence[Row], error: float, cost: Callable[[Row], float] = lambda row: row.seconds.median) -> float:
    """Return the cost of a tree with this median error, by interpolation of logarithms; of the coarsest if better; or nan."""
    order = sorted(rows, key=lambda row: row.errors["median"])
    if error < order[0].errors["median"]:
        return nan
    return exp(np.interp(log(error), [log(row.errors["median"]) for row in order], [log(cost(row)) for row in order]))


def compared(found: Experiment) -> Iterator[str]:
    """Describe what the same error costs with monopoles, with quadrupoles, and with the direct sum, which is always better."""
    direct, trees = found.curve(DIRECT_SUM)[0].seconds.median, [found.curve(curve) for curve in TREE_CURVES.values()]
    finest = max(min(row.errors["median"] for row in rows) for rows in trees)
    for error in sorted({COMPARED_ERROR, finest}, reverse=True):
        quad, mono = (at_error(rows, error) for rows in trees)
        if quad > 0.0 and mono > 0.0:
            work = [at_error(rows, error, lambda row: row.work["interactions"]) for rows in trees]
            yield (
                f"a median error of {error:.1e} takes {1e3 * quad:.3g} ms by quadrupoles; by monopoles {mono / quad:.2f} times"
                f" that and {work[1] / work[0]:.2f} times the interactions; by the direct sum {direct / quad:.2f} times that"
            )


def crossover(sizes: Sequence[int], found: Sequence[Experiment], curve: str) -> float:
    """Return the N above which a tree of median error COMPARED_ERROR costs less than the direct sum, by interpolation.

    0 if it does at all sizes, inf if at none.
    """
    gain = [log(e.curve(DIRECT_SUM)[0].seconds.median / at_error(e.curve(curve), COMPARED_ERROR)) for e in found]
    if not gain[-1] > 0.0:
        return inf
    k = max((k for k in range(len(gain)) if not gain[k] > 0.0), default=-1)  # the last size at which the direct sum is cheaper
    return 0.0 if k < 0 else exp(np.interp(0.0, gain[k : k + 2], np.log(sizes[k : k + 2])))


def conclusions(sizes: Sequence[int], found: Sequence[Experiment], ranks: int) -> Iterator[str]:
    """Describe from which number of particles on trees cost less, as measured and by the cost model of the plan; their errors."""
    for curve in TREE_CURVES.values():
        n = crossover(sizes, found, curve)
        where = {0.0: f"at N = {sizes[0]} already", inf: f"not yet at N = {sizes[-1]}"}.get(n, f"from N = {n:.0f} on")
        tree = f"a tree of {curve} with a median error of {COMPARED_ERROR:.0e}"
        yield f"{tree} costs less than the direct sum {where}, on {ranks} rank{'s' if ranks > 1 else ''}"
    planned = next(n for n in range(100, 10**6, 10) if choose("auto", 0.5, COMPARED_ERROR, 3, n).angle is not None)
    yield f"the cost model of check and of method auto, quadrupoles on one rank: from N = {planned} on"
    for multipole, curve in TREE_CURVES.items():
        medians = ", ".join(f"{row.errors['median']:.1e}" for row in found[-1].curve(curve)[:3])
        other = f"where each particle walks by itself, N = 20 000: {BY_PARTICLE[multipole]}"
        yield f"{curve} at angles 1, 0.7, 0.5: median {medians}; {other}"


def experiment(benchmark: Benchmark, k: int, n: int) -> Experiment:
    """Measure all settings for n particles."""
    title = f"One evaluation of the forces in a Plummer sphere of {n}"
    found = benchmark.compare(f"D{k}", title, settings(benchmark, n), ERRORS, "the direct sum in float64", "opening angle")
    own = found.rows[0].errors
    found.reference += f", itself within {own['median']:.1e} (median), {own['99 %']:.1e} of extended precision"
    found.floor, found.answers = own["99 %"], list(compared(found))
    return found


def experiments(benchmark: Benchmark) -> list[Experiment]:
    """Measure D for each number of particles. Collective."""
    sizes = QUICK_SIZES if benchmark.quick else SIZES
    found = [experiment(benchmark, k, n) for k, n in enumerate(sizes, 1)]
    found[-1].answers += conclusions(sizes, found, benchmark.ranks.size)
    return found
