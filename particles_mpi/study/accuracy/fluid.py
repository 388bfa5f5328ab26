"""C: the hard-sphere fluid. Collision mode, step and passes against error in the pressure and in the rate of collisions.

Trajectories are chaotic and never compared. The fluid is: its compressibility factor Z = p V/(N T) is known within some 1e-4,
and with it the rate of collisions (Enskog: Gamma = (Z - 1) 6/sigma sqrt(T/(pi m)) in three dimensions).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from math import pi, sqrt
from typing import Any

import numpy as np

from particles_mpi import Simulation
from particles_mpi.measure import snapshot
from particles_mpi.study.measuring.experiment import Errors, Experiment, Lab, Row, Setting

N, QUICK_N = 4000, 1000
MELT, PATH = 20.0, 100.0  # collisions of each sphere before the start, and in a run
BLOCKS = 10
PACKINGS = (0.10, 0.30, 0.45)
MOMENTS = (0.03, 0.1, 0.3, 1.0, 2.8)  # Gamma dt: collisions of a sphere in a step
PASSES = (10, 3, 1)
FASTEST = 4.8  # thermal speeds: rewind allows steps of one diameter
KLM = (4.0, 6.0, 2.3647684, -0.8698551, 1.1062803, -1.095049, 0.637614, -0.2279397, 0.1098948, -0.00906797)
FLOOR = 2e-3  # of what PATH collisions of N spheres tell, one standard deviation or two
ERRORS = {
    "collision rate": "|Gamma/Gamma_exact - 1|, collisions of a sphere in unit time",
    "Z - 1": "|(Z - 1)/(Z_exact - 1) - 1|, Z by the virial",
    "noise": "standard error of the rate, from ten parts of the run",
}


def compressibility(packing: float) -> float:
    """Z of the hard-sphere fluid: J. Kolafa, S. Labik, A. Malijevsky, Phys. Chem. Chem. Phys. 6, 2335 (2004)."""
    x = packing / (1.0 - packing)
    return 1.0 + sum(c * x ** (k + 1) for k, c in enumerate(KLM))


def collision_rate(packing: float, temperature: float = 1.0) -> float:
    """Collisions of a sphere in unit time, for diameter and mass 1."""
    return 6.0 * (compressibility(packing) - 1.0) * sqrt(temperature / pi)


def fluid(packing: float, n: int, step: float, steps: int, spheres: dict[str, Any], **collisions: Any) -> dict[str, Any]:
    """A periodic box of spheres of diameter and mass 1."""
    side = (n * pi / 6.0 / packing) ** (1.0 / 3.0)
    return {
        "dimension": 3,
        "seed": 1,
        "box": {"lower": [0.0] * 3, "upper": [side] * 3, "periodic": True},
        "time": {"step": step, "steps": steps},
        "particles": [{"radius": 0.5, "mass": 1.0, **spheres}],
        "effects": {"collisions": {"allow_overlap": True, **collisions}},  # round-off, where two have just met
        "output": {"observables": True},
    }


def melted(lab: Lab, packing: float, n: int) -> dict[str, Any]:
    """Places and velocities of a fluid in equilibrium."""
    crystal = {"count": n, "position": "lattice", "velocity": {"temperature": 1.0}}
    sim = lab.simulate(fluid(packing, n, MELT / collision_rate(packing) / 4.0, 4, crystal, mode="event"))
    sim.run()
    p = snapshot.gather_all(sim.ranks, sim.particles)
    return {"position": p.position.tolist(), "velocity": p.velocity.tolist()}


def errors(packing: float, sim: Simulation) -> Errors:
    """Rate and pressure of the whole run."""
    rates, virials, steps = [], [], sim.scene.steps
    sim.measure()
    for k in range(BLOCKS):
        while sim.steps_done < (k + 1) * steps // BLOCKS:
            sim.step()
        row = sim.measure()
        rates.append(row["collision_rate"] / collision_rate(packing, row["temperature"]))
        virials.append((row["z_virial"] - 1.0) / (compressibility(packing) - 1.0))
    return {
        "collision rate": abs(float(np.mean(rates)) - 1.0),
        "Z - 1": abs(float(np.mean(virials)) - 1.0),
        "noise": float(np.std(rates, ddof=1)) / sqrt(BLOCKS),
    }


def settings(lab: Lab, packing: float) -> Iterator[Setting]:
    """`event` with long steps, `rewind` over steps and passes."""
    n, path = (QUICK_N, 0.2 * PATH) if lab.quick else (N, PATH)
    rate, spheres = collision_rate(packing), melted(lab, packing, n)

    def one(curve: str, moment: float, **collisions: Any) -> Setting:
        steps = round(path / moment)
        scene = fluid(packing, n, moment / rate, steps, spheres, **collisions)
        begin: Callable[[], Simulation] = lambda: lab.simulate(scene)  # noqa: E731
        return Setting(curve, moment, begin, steps, partial(errors, packing))

    yield one("event", 2.0, mode="event")
    for passes in PASSES[:: 2 if lab.quick else 1]:
        for moment in MOMENTS[1 : 4 if lab.quick else None]:
            if moment / rate * FASTEST < 1.0:
                yield one(f"rewind, {passes} pass{'es' if passes > 1 else ''}", moment, passes=passes)


def answers(packing: float, rows: list[Row]) -> list[str]:
    """What event costs against the rewind that is as good."""
    event = rows[0]
    good = [row for row in rows[1:] if row.errors["collision rate"] < FLOOR + 2.0 * row.errors["noise"]]
    if not good:
        return [f"packing {packing:g}: no setting of rewind is as right as event, {event.seconds.median:.2g} s"]
    best = min(good, key=lambda row: row.seconds.median)
    return [
        f"packing {packing:g}: event is exact and takes {event.seconds.median:.2g} s; the fastest rewind whose error in the "
        f"rate is hidden by noise: {best.setting.curve} at Gamma dt = {best.setting.knob:g}, {best.seconds.median:.2g} s"
    ]


def measure(lab: Lab) -> list[Experiment]:
    found = []
    for k, packing in enumerate(PACKINGS):
        if lab.quick and k != 1:
            continue
        rows = lab.measure(f"fluid, packing {packing:g}", list(settings(lab, packing)))
        reference = "Kolafa, Labik and Malijevsky (2004): Z within 5e-4; event, which has no error of the step, beside it"
        title = f"Hard-sphere fluid, packing {packing:g}"
        found.append(Experiment(f"C{k + 1}", title, "Gamma dt", ERRORS, reference, rows, (), FLOOR, answers(packing, rows)))
    return found
