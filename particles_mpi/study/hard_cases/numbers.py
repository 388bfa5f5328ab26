"""Numbers at the ends of what a float64 holds."""

from functools import partial
from typing import Any

import numpy as np

from particles_mpi import SceneError
from particles_mpi.errors import StoppedError
from particles_mpi.study.experiment import everyone, total
from particles_mpi.study.hard_cases.catalogue import CaseRun, Effects, Finding, case

NAIVE, MUST = "NaN, or particles lost", "finite, inside, energy kept; or a refusal that says why"


def gas(run: CaseRun, scale: float = 1.0, speed: float = 1.0, offset: float = 0.0, moves: float = 0.05) -> Finding:
    """30 spheres in an elastic box of side 10 scales, which move by so many of them in a step."""
    spheres = {"count": 30, "position": "random", "radius": 0.5 * scale, "velocity": {"speed": speed}}
    effects: Effects = {"collisions": {}, "walls": {}}
    try:
        sim = run.simulate([spheres], moves * scale / speed, 400, effects, box=run.cube(10.0 * scale, offset), seed=3)
        before = sim.measure()["kinetic"]
        sim.run()
        after, p = sim.measure()["kinetic"], everyone(sim)
    except (SceneError, StoppedError) as error:
        return f"refused: {str(error)[:60]}", True
    unit = np.spacing(abs(offset) + 10.0 * scale) * 8.0  # places are no finer
    inside = (p.position >= offset + 0.5 * scale - unit).all() and (p.position <= offset + 9.5 * scale + unit).all()
    events = total(sim, "collisions")
    change = after / before - 1.0 if before > 0.0 else after - before
    holds = bool(np.isfinite(p.position).all() and np.isfinite(p.velocity).all() and inside and abs(change) <= 1e-10)
    holds &= events > 0 or moves < 0.01
    return f"{events} contacts, energy {change:+.0e}, {'inside' if inside else 'OUTSIDE'}", holds


EXTREMES: dict[str, dict[str, Any]] = {
    "box at an offset of 1e8": {"offset": 1e8},
    "box of size 1e-8": {"scale": 1e-9},
    "speeds of 1e150": {"speed": 1e150},
    "speeds of 1e-310 (denormal)": {"speed": 1e-310, "moves": 1e-6},
}
for name, numbers in EXTREMES.items():
    case(name, NAIVE, MUST)(partial(gas, **numbers))
