"""Numbers at the ends of what a float64 holds."""

import numpy as np

from particles_mpi import SceneError
from particles_mpi.errors import StoppedError
from particles_mpi.study.hard_cases import Bench, case, everyone

LOST, FINITE = "NaN, or particles lost", "finite, inside, energy kept; or a refusal that says why"


def gas(bench: Bench, scale: float, speed: float, offset: float, moves: float = 0.05) -> tuple[str, bool]:
    """30 spheres in an elastic box of side 10 scales, which move by so many of them in a step."""
    d = bench.dimension
    scene = dict(
        seed=3,
        box={"lower": [offset] * d, "upper": [offset + 10.0 * scale] * d},
        time={"step": moves * scale / speed, "steps": 400},
        particles=[{"count": 30, "position": "random", "radius": 0.5 * scale, "velocity": {"speed": speed}}],
        effects={"collisions": {}, "walls": {}},
    )
    try:
        sim = bench.simulate(**scene)
        before = sim.measure()["kinetic"]
        sim.run()
        after, p = sim.measure()["kinetic"], everyone(sim)
    except (SceneError, StoppedError) as error:
        return f"refused: {str(error)[:60]}", True
    unit = np.spacing(abs(offset) + 10.0 * scale) * 8.0  # places are no finer
    inside = (p.position >= offset + 0.5 * scale - unit).all() and (p.position <= offset + 9.5 * scale + unit).all()
    events = int(sim.ranks.allreduce_sum(sim.totals["collisions"])[0])
    change = after / before - 1.0 if before > 0.0 else after - before
    holds = bool(np.isfinite(p.position).all() and np.isfinite(p.velocity).all() and inside and abs(change) <= 1e-10)
    holds &= events > 0 or moves < 0.01
    return f"{events} contacts, energy {change:+.0e}, {'inside' if inside else 'OUTSIDE'}", holds


@case("box at an offset of 1e8", LOST, FINITE)
def far_away(bench: Bench) -> tuple[str, bool]:
    return gas(bench, 1.0, 1.0, 1e8)


@case("box of size 1e-8", LOST, FINITE)
def tiny(bench: Bench) -> tuple[str, bool]:
    return gas(bench, 1e-9, 1.0, 0.0)


@case("speeds of 1e150", LOST, FINITE)
def fast(bench: Bench) -> tuple[str, bool]:
    return gas(bench, 1.0, 1e150, 0.0)


@case("speeds of 1e-310 (denormal)", LOST, FINITE)
def slow(bench: Bench) -> tuple[str, bool]:
    return gas(bench, 1.0, 1e-310, 0.0, 1e-6)
