"""Mutual gravity: close encounters, and very many orbits."""

from functools import partial
from math import log, sqrt

import numpy as np

from particles_mpi import Simulation
from particles_mpi.kernels.jit import kernel
from particles_mpi.kernels.motion import free_drift, kick
from particles_mpi.particles import Array
from particles_mpi.study.hard_cases.catalogue import CaseRun, Finding, case, energies

KEPLER_ORBITS, KEPLER_STEPS = 1_000_000, 50
FAR_BINARIES = ((0.01, 100.0), (1.0, 1e4), (1.0, 1e6))  # separation, and place on every axis
FAR_ORBITS = 5  # of each: what round-off does grows as their root
SAMPLES_AN_ORBIT = 4  # of the energy
ROUNDINGS = {"adaptive": 1, "leapfrog": 1, "order4": 6}  # of a position in a step, for `adaptive` in each that it takes inside
NEGLIGIBLE_CHANGE = 1e-9  # change of the energy that is acceptable


def two_masses(
    run: CaseRun, apart: float, speed: float, integrator: str, step: float, softening: float = 0.0, place: float = 0.0
) -> Simulation:
    """Return two halves of mass 1, `apart` along x around a point, with this relative speed along y. Collective."""
    masses = [
        {"position": [run.point(place + sign * apart / 2, rest=place)], "velocity": run.point(0.0, sign * speed / 2), "mass": 0.5}
        for sign in (1.0, -1.0)
    ]
    return run.simulate(masses, step, 1, {"mutual_gravity": {"softening": softening}}, integrator, G=1.0)


def energy_changes(sim: Simulation, samples: int, steps: int) -> Array:
    """Return the relative changes of the energy since the start: there and, `samples` times, after more steps. Collective."""
    found = energies(sim, samples, steps)
    return found / found[0] - 1.0


def encounter(run: CaseRun, integrator: str, softening: float, periods: float, substeps: int) -> tuple[float, float]:
    """Return (largest, last) relative change of the energy of two masses on an orbit of e = 0.999, sampled 200 times."""
    step, speed = 2.0 * np.pi * periods / 200.0 / substeps, sqrt(2.0 * (1.0 / 1.999 - 0.5))
    changes = np.abs(energy_changes(two_masses(run, 1.999, speed, integrator, step, softening), 200, substeps))
    return float(changes.max()), float(changes[-1])


@case("close encounter, e = 0.999, not softened", "thrown out of the system", "`adaptive`: energy within 1e-10", modes=(None,))
def close_encounter(run: CaseRun) -> Finding:
    """Adaptive steps get through the encounter."""
    worst, _ = encounter(run, "adaptive", 0.0, 2.0, 1)
    return f"energy within {worst:.0e} over 2 periods", worst <= 1e-10


@case("close encounter, e = 0.999, softening 0.05", "thrown out", "`leapfrog`: within 5 %, and back", modes=(None,))
def softened_encounter(run: CaseRun) -> Finding:
    """Fixed steps get through a softened encounter."""
    worst, last = encounter(run, "leapfrog", 0.05, 1.0, 20)
    return f"energy within {worst:.1e}, {last:.0e} after the period", worst <= 5e-2 and last <= 1e-4


def binary(run: CaseRun, integrator: str, steps: int, apart: float, place: float) -> tuple[Array, int]:
    """Return (relative changes of the energy, roundings of a position) of equal masses on a circle, in `steps` per orbit."""
    rate = apart**-1.5
    sim = two_masses(run, apart, rate * apart, integrator, 2.0 * np.pi / rate / steps, place=place)
    changes = energy_changes(sim, FAR_ORBITS * SAMPLES_AN_ORBIT, steps // SAMPLES_AN_ORBIT)
    return changes, (sim.integrator.substeps if integrator == "adaptive" else sim.steps_done) * ROUNDINGS[integrator]


def far_binaries(run: CaseRun, integrator: str, steps: int) -> Finding:
    """Binaries far from the origin: how far their energies depart from those of the same binaries at the origin.

    Rounding a position by u/sqrt(12), u its unit in the last place, changes the energy of a circular orbit by the force
    times that, relatively by 2 u/apart at most; n roundings by chance add up as the root of n. Forces at rounded places
    do as much again.
    """
    texts, holds = [], True
    at_origin = {apart: binary(run, integrator, steps, apart, 0.0)[0] for apart in {apart for apart, _ in FAR_BINARIES}}
    for apart, place in FAR_BINARIES:
        changes, n = binary(run, integrator, steps, apart, place)
        parted, limit = float(np.abs(changes - at_origin[apart]).max()), 4.0 * float(np.spacing(place)) / apart * sqrt(n)
        texts.append(f"{apart:g} at {place:.0e}: {parted:.0e} (round-off: {limit:.0e})")
        holds &= parted <= max(limit, NEGLIGIBLE_CHANGE)
    return "; ".join(texts), holds


FAR_MUST = f"energy as at the origin, within 1e-9 or round-off, {FAR_ORBITS} orbits"
for integrator, steps in {"adaptive": 4, "leapfrog": 100, "order4": 40}.items():
    naive = "steps shrink until it stops" if integrator == "adaptive" else "round-off grows with every step"
    function = partial(far_binaries, integrator=integrator, steps=steps)
    case(f"binaries far from the origin, `{integrator}`", naive, FAR_MUST, modes=(None,))(function)


@kernel
def circle(orbits, steps, compensated):
    """Return energy errors of a circular orbit after 10, 100, ... orbits, by the program's kick and drift, in `steps` per orbit.

    The radius is that of the leapfrog's own circle, so that all that is left is round-off. `compensated`: positions by
    Kahan's sum.
    """
    h = 2.0 * np.pi / steps
    x, v, a = np.array([[1.0, 0.0]]), np.array([[0.0, 1.0]]), np.empty((1, 2))
    lost, way = np.zeros((1, 2)), np.empty((1, 2))
    v[0, 1] = np.sqrt(1.0 - 0.25 * h * h)  # x(h) has the same length then
    sums, count, mark = np.zeros(8), 0, 10
    start, total, r2 = 0.0, 0.0, 0.0
    for orbit in range(1, orbits + 1):
        total = 0.0
        for _ in range(steps):
            for half in range(2):
                r2 = x[0, 0] ** 2 + x[0, 1] ** 2
                for k in range(2):
                    a[0, k] = -x[0, k] / (r2 * np.sqrt(r2))
                kick(v, a, 0.5 * h)
                if half == 0 and not compensated:
                    free_drift(x, v, h)
                elif half == 0:
                    for k in range(2):
                        way[0, k] = v[0, k] * h - lost[0, k]
                        new = x[0, k] + way[0, k]
                        lost[0, k] = (new - x[0, k]) - way[0, k]
                        x[0, k] = new
            total += 0.5 * (v[0, 0] ** 2 + v[0, 1] ** 2) - 1.0 / np.sqrt(r2)
        if orbit == 1:
            start = total
        if orbit == mark:
            sums[count] = abs(total / start - 1.0)
            count += 1
            mark *= 10
    return sums[:count]


@case(
    "1e6 Kepler orbits of 50 steps",
    "energy drifts in proportion to time",
    "within 1e-10; grows as the root of time (Brouwer)",
    modes=(None,),
    dimensions=(2,),
)
def many_orbits(run: CaseRun) -> Finding:
    """Only round-off, from the kick and the drift of the program."""
    simple, kahan = circle(KEPLER_ORBITS, KEPLER_STEPS, False), circle(KEPLER_ORBITS, KEPLER_STEPS, True)
    power = log(simple[-1] / simple[2]) / log(KEPLER_ORBITS / 1000.0)
    measured = f"{simple[-1]:.0e} after 1e6 (1e3: {simple[2]:.0e}; power {power:.1f}); compensated {kahan[-1]:.0e}"
    return measured, bool(simple.max() <= 1e-10)
