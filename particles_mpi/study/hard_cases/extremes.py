"""Numbers at the ends of what a float64 holds; particles where ranks meet, and ranks without particles.

Under mpirun each is compared, bit for bit, with one rank.
"""

from functools import partial
from typing import Any

import numpy as np

from particles_mpi import SceneError, Simulation
from particles_mpi.errors import StoppedError
from particles_mpi.particles import Array
from particles_mpi.study.experiment import all_particles, total_count
from particles_mpi.study.hard_cases.catalogue import CaseRun, Effects, Finding, case

CLOSED: Effects = {"collisions": {}, "walls": {}}
LONGEST_STEP = 1e90


def gas(
    run: CaseRun, scale: float = 1.0, speed: float = 1.0, offset: float = 0.0, moves: float = 0.05, refusable: bool = False
) -> Finding:
    """30 spheres in an elastic box of side 10 scales, which move by so many of them in a step, or less in the longest one."""
    spheres = {"count": 30, "position": "random", "radius": 0.5 * scale, "velocity": {"speed": speed}}
    try:
        sim = run.simulate(
            [spheres], min(moves * scale / speed, LONGEST_STEP), 400, CLOSED, box=run.cube(10.0 * scale, offset), seed=3
        )
        before = sim.measure()["kinetic"]
        sim.run()
        after, p = sim.measure()["kinetic"], all_particles(sim)
    except (SceneError, StoppedError) as error:
        return f"refused: {str(error)[:60]}", refusable
    unit = np.spacing(abs(offset) + 10.0 * scale) * 8.0  # places are no finer
    inside = (p.position >= offset + 0.5 * scale - unit).all() and (p.position <= offset + 9.5 * scale + unit).all()
    events = total_count(sim, "collisions")
    change = after / before - 1.0 if before > 0.0 else after - before
    holds = bool(np.isfinite(p.position).all() and np.isfinite(p.velocity).all() and inside and abs(change) <= 1e-10)
    holds &= events > 0 or moves < 0.01
    return f"{events} contacts, energy {change:+.0e}, {'inside' if inside else 'OUTSIDE'}", holds


EXTREMES: dict[str, dict[str, Any]] = {
    "box at an offset of 1e8": {"offset": 1e8},
    "box of size 1e-8": {"scale": 1e-9},
    "speeds of 1e150": {"speed": 1e150, "refusable": True},
    "speeds of 1e-310 (denormal)": {"speed": 1e-310, "moves": 1e-6},
}
for name, numbers in EXTREMES.items():
    must = "finite, inside, energy kept; or a refusal that says why"
    case(name, "NaN, or particles lost", must)(partial(gas, **numbers))

MUST = "ids a permutation at every step; same bits on any number of ranks"


def watch_ids(sim: Simulation, steps: int) -> Finding:
    """Do steps, and check after each that every id is present once."""
    number, lost = sim.total, 0
    for _ in range(steps):
        sim.step()
        lost += not np.array_equal(all_particles(sim).id, np.arange(number))
    return f"{number} ids at each of {steps} steps, {total_count(sim, 'collisions')} contacts", lost == 0


def grid(run: CaseRun, axis: Any) -> Array:
    """Return all points, one in each row, whose coordinates are among those of the axis."""
    return np.stack(np.meshgrid(*[axis] * run.dimension, indexing="ij"), axis=-1).reshape(-1, run.dimension)


@case("on borders and corners of domains", "owned by two ranks, or by none", MUST)
def on_borders(run: CaseRun) -> Finding:
    """A lattice symmetric about all borders of 2, 4, 8 ranks, and spheres at rest exactly on these."""
    lattice, corners = grid(run, np.arange(1.0, 16.0, 2.0)), grid(run, [4.0, 8.0, 12.0])
    speeds = np.random.default_rng(5).choice([-4.0, 4.0], size=lattice.shape)
    moving = {"position": lattice.tolist(), "velocity": speeds.tolist(), "radius": 0.3}
    particles, box = [{"position": corners.tolist(), "radius": 0.3}, moving], run.cube(16.0) | {"periodic": True}
    return watch_ids(run.simulate(particles, 0.05, effects={"collisions": {}}, box=box), 60)


@case("crossing many domains in a step", "handed to a neighbour only, and lost", MUST)
def crossing(run: CaseRun) -> Finding:
    """Four large spheres that fly through a dense cluster of small ones."""
    cluster = (19.0 + 0.2 * grid(run, np.arange(10.0)))[:: run.dimension]
    places = [run.point(5.0 + 30.0 * (k % 2), 9.0 + 7.5 * k, rest=20.0) for k in range(4)]
    speeds = [run.point(10.0 - 20.0 * (k % 2)) for k in range(4)]
    small = {"position": cluster.tolist(), "radius": 0.09, "velocity": {"speed": 0.1}}
    large = {"position": places, "radius": 2.0, "velocity": speeds}
    return watch_ids(run.simulate([small, large], 0.35, effects=CLOSED, box=run.cube(40.0), seed=6), 30)


@case("all particles in one rank's corner", "ranks without work hang", MUST)
def one_corner(run: CaseRun) -> Finding:
    """A small cluster in a large box."""
    places = 0.05 + 0.1 * grid(run, np.arange(4.0))
    cluster = {"position": places.tolist(), "radius": 0.04, "velocity": {"speed": 2.0}}
    return watch_ids(run.simulate([cluster], 0.01, effects=CLOSED, box=run.cube(1000.0), seed=7), 60)


@case("three particles, and none", "more ranks than particles: a hang", MUST)
def few_particles(run: CaseRun) -> Finding:
    """The box without particles, and with three."""
    three = {"position": [run.point(rest=1.0 + 1.5 * k) for k in range(3)], "radius": 0.5, "velocity": {"speed": 3.0}}
    none = {"count": 0, "position": "random", "radius": 0.5}
    outcomes = [watch_ids(run.simulate([some], 0.05, effects=CLOSED, box=run.cube(10.0)), 60) for some in (none, three)]
    return outcomes[-1][0], all(holds for _, holds in outcomes)
