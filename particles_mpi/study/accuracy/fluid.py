"""C: the hard-sphere fluid. Collision mode, step and passes against error in the pressure and in the rate of collisions.

Trajectories are chaotic and are never compared; the fluid as a whole is: its compressibility factor Z = p V/(N T) is known within
some 1e-4, and with it the rate of collisions (Enskog: Gamma = (Z - 1) 6/sigma sqrt(T/(pi m)) in three dimensions).
"""

from collections.abc import Iterator
from functools import partial
from math import pi, sqrt
from typing import Any

import numpy as np

from particles_mpi import Simulation
from particles_mpi.study.experiment import Benchmark, Errors, Experiment, Setting

N, QUICK_N = 4000, 1000
MELTING_COLLISIONS, RUN_COLLISIONS = 20.0, 100.0  # collisions of each sphere before the start, and in a run
PARTS = 10
PACKINGS = {"C1": 0.10, "C2": 0.30, "C3": 0.45}
COLLISIONS_A_STEP = (0.03, 0.1, 0.3, 1.0, 2.8)  # Gamma dt: collisions of a sphere in a step
PASSES = (10, 3, 1)
FASTEST_SPEED = 4.8  # thermal speeds: rewind allows steps of one diameter
KLM = (4.0, 6.0, 2.3647684, -0.8698551, 1.1062803, -1.095049, 0.637614, -0.2279397, 0.1098948, -0.00906797)
NOISE_FLOOR = 2e-3  # noise of RUN_COLLISIONS collisions of N spheres, one standard deviation or two
REFERENCE = "Kolafa, Labik and Malijevsky (2004): Z within 5e-4; and mode event, which has no error of the step"
ERRORS = {
    "collision rate": "|Gamma/Gamma_exact - 1|, collisions of a sphere in unit time",
    "Z - 1": "|(Z - 1)/(Z_exact - 1) - 1|, Z by the virial",
    "noise": "standard error of the rate, from ten parts of the run",
}


def compressibility(packing: float) -> float:
    """Return Z of the hard-sphere fluid: J. Kolafa, S. Labik, A. Malijevsky, Phys. Chem. Chem. Phys. 6, 2335 (2004)."""
    x = packing / (1.0 - packing)
    return 1.0 + sum(c * x ** (k + 1) for k, c in enumerate(KLM))


def collision_rate(packing: float, temperature: float = 1.0) -> float:
    """Return the collisions of a sphere per unit time, for diameter and mass 1."""
    return 6.0 * (compressibility(packing) - 1.0) * sqrt(temperature / pi)


def fluid(packing: float, n: int, step: float, steps: int, spheres: dict[str, Any], **collisions: Any) -> dict[str, Any]:
    """Return the tables of a periodic box of spheres with diameter and mass 1."""
    side = (n * pi / 6.0 / packing) ** (1.0 / 3.0)
    box, time = {"lower": [0.0] * 3, "upper": [side] * 3, "periodic": True}, {"step": step, "steps": steps}
    effects = {"collisions": {"allow_overlap": True, **collisions}}  # round-off, where two have just met
    particles, output = [{"radius": 0.5, "mass": 1.0, **spheres}], {"observables": True}
    space = {"dimension": 3, "seed": 1, "box": box}
    return space | {"time": time, "particles": particles, "effects": effects, "output": output}


def melted(benchmark: Benchmark, packing: float, n: int) -> dict[str, Any]:
    """Return positions and velocities of a fluid in equilibrium."""
    crystal = {"count": n, "position": "lattice", "velocity": {"temperature": 1.0}}
    scene = fluid(packing, n, MELTING_COLLISIONS / collision_rate(packing) / 4.0, 4, crystal, mode="event")
    return benchmark.at_end(scene, "position", "velocity")


def errors(packing: float, sim: Simulation) -> Errors:
    """Return the errors in rate and pressure over the whole run."""
    rates, virials, steps = [], [], sim.scene.steps
    sim.measure()
    for k in range(PARTS):
        sim.steps((k + 1) * steps // PARTS - sim.steps_done)
        row = sim.measure()
        rates.append(row["collision_rate"] / collision_rate(packing, row["temperature"]))
        virials.append((row["z_virial"] - 1.0) / (compressibility(packing) - 1.0))
    rate, virial = (abs(float(np.mean(values)) - 1.0) for values in (rates, virials))
    return {"collision rate": rate, "Z - 1": virial, "noise": float(np.std(rates, ddof=1)) / sqrt(PARTS)}


def settings(benchmark: Benchmark, packing: float) -> Iterator[Setting]:
    """Yield `event` with long steps, and `rewind` with several steps and numbers of passes."""
    n, path = (QUICK_N, 0.2 * RUN_COLLISIONS) if benchmark.quick else (N, RUN_COLLISIONS)
    rate, spheres = collision_rate(packing), melted(benchmark, packing, n)

    def one(curve: str, moment: float, **collisions: Any) -> Setting:
        scene = fluid(packing, n, moment / rate, round(path / moment), spheres, **collisions)
        return benchmark.setting(curve, moment, scene, partial(errors, packing))

    yield one("event", 2.0, mode="event")
    for passes in PASSES[:: 2 if benchmark.quick else 1]:
        for moment in COLLISIONS_A_STEP[1 : 4 if benchmark.quick else None]:
            if moment / rate * FASTEST_SPEED < 1.0:
                yield one(f"rewind, {passes} pass{'es' if passes > 1 else ''}", moment, passes=passes)


def experiments(benchmark: Benchmark) -> list[Experiment]:
    """Measure C for each packing, and compare the time of event with that of the fastest rewind that is as good. Collective."""
    all_found = []
    for key in ["C2"] if benchmark.quick else PACKINGS:
        packing = PACKINGS[key]
        title, tried = f"Hard-sphere fluid, packing {packing:g}", settings(benchmark, packing)
        found = benchmark.compare(key, title, tried, ERRORS, REFERENCE, "Gamma dt", floor=NOISE_FLOOR)
        event, *others = found.rows
        good = [row for row in others if row.errors["collision rate"] < NOISE_FLOOR + 2.0 * row.errors["noise"]]
        best, seconds = min(good, key=lambda row: row.seconds.median, default=None), event.seconds.median
        found.answers.append(
            f"packing {packing:g}: event is exact and takes {seconds:.2g} s; the fastest rewind whose error in the rate is "
            f"hidden by noise: {best.setting.curve} at Gamma dt = {best.setting.parameter:g}, {best.seconds.median:.2g} s"
            if best
            else f"packing {packing:g}: no setting of rewind is as accurate as event, which takes {seconds:.2g} s"
        )
        all_found.append(found)
    return all_found
