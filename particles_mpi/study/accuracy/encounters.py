"""B: close encounters. The Pythagorean problem by fixed steps, and by steps that follow the forces."""

from __future__ import annotations

import numpy as np

from particles_mpi import Simulation
from particles_mpi.measure import snapshot
from particles_mpi.study.accuracy.orbits import gravity
from particles_mpi.study.measuring.experiment import Errors, Experiment, Lab, Setting

END = 20.0
PLACES = {10.0: (0.778480410138, 0.141392300290), 20.0: (3.004292636696, 0.511925235025)}  # of m = 3, in twelve digits
FLOOR = 1e-12
LATE = "place, t = 20"
TOLERANCES = (1e-3, 1e-5, 1e-7, 1e-9)
REGIMES = {  # steps to the end, quick ones
    "leapfrog": ((4_000, 16_000, 64_000), (4_000, 16_000)),
    "order4": ((2_000, 8_000, 16_000), (1_000, 4_000)),
}
BODIES = {"position": [[1.0, 3.0], [-2.0, -1.0], [1.0, -1.0]], "velocity": [0.0, 0.0], "mass": [3.0, 4.0, 5.0]}
ERRORS = {
    "place, t = 10": "distance of m = 3 from where it is at t = 10, after an encounter of 0.01",
    LATE: "the same at t = 20, after one of 0.0004",
    "energy": "|dE/E| at the end",
}


def errors(sim: Simulation) -> Errors:
    """To the end, with a look on the way."""
    start, found = sim.measure()["total_energy"], {}
    for moment, place in PLACES.items():
        while sim.steps_done < round(moment / sim.h):
            sim.step()
        body = snapshot.gather_all(sim.ranks, sim.particles).position[0]
        found[f"place, t = {moment:g}"] = float(np.sqrt(((body - place) ** 2).sum()))
    return found | {"energy": abs(sim.measure()["total_energy"] / start - 1.0)}


def pythagorean(lab: Lab) -> Experiment:
    """Masses of 3, 4 and 5 that fall from rest."""

    def one(curve: str, knob: float, n: int, tolerance: float | None = None) -> Setting:
        scene = gravity({"particles": [BODIES]}, END / n, n, curve, tolerance)
        return Setting(curve, knob, lambda: lab.simulate(scene), n, errors, by_forces=curve == "adaptive")

    settings = [one(curve, END / n, n) for curve, regimes in REGIMES.items() for n in regimes[lab.quick]]
    settings += [one("adaptive", t, 200, t) for t in TOLERANCES[: 2 if lab.quick else None]]
    rows = lab.measure("Pythagorean", settings)
    found = Experiment(
        "B", "Pythagorean problem, t = 20", "step or tolerance", ERRORS,
        "published: twelve digits of two places", rows, (2.0, 4.0), FLOOR,
    )  # fmt: skip
    fixed = [row for row in rows if row.setting.curve != "adaptive"]
    best, chosen = min(fixed, key=lambda r: r.errors[LATE]), min(found.curve("adaptive"), key=lambda r: r.errors[LATE])
    found.answers = [
        f"fixed steps: {best.setting.curve}, {best.work['forces']} forces, {best.seconds.median:.2g} s, "
        f"wrong by {best.errors[LATE]:.1g} at t = 20; "
        f"adaptive: {chosen.work['forces']} forces, {chosen.seconds.median:.2g} s, {chosen.errors[LATE]:.1g}"
    ]
    return found


def measure(lab: Lab) -> list[Experiment]:
    return lab.ranks.run_on_root(lambda: [pythagorean(lab.alone())]) or []
