"""Single contacts: where and when they happen, and what they give."""

from math import pi, sqrt

import numpy as np

from particles_mpi import SceneError
from particles_mpi.contacts.law import contact_time
from particles_mpi.kernels.markers import NEVER
from particles_mpi.study.hard_cases import Bench, case, everyone


def along(d: int, x: float) -> list[float]:
    """The point at x of the first axis."""
    return [x] + [0.0] * (d - 1)


@case(
    "overlap at the start, coincident centres",
    "0/0 makes NaN, or a spring throws them apart",
    "finite, separated, momentum kept, energy not raised",
)
def overlap(bench: Bench) -> tuple[str, bool]:
    d = bench.dimension
    places = [along(d, x) for x in (0.0, 0.0, 0.7, 5.0, 5.1)]
    speeds = np.random.default_rng(1).standard_normal((5, d))
    sim = bench.simulate(
        time={"step": 0.01, "steps": 200},
        particles=[{"position": places, "velocity": speeds.tolist(), "radius": 0.5, "mass": [1.0, 2.0, 1.0, 3.0, 1.0]}],
        effects={"collisions": {"restitution": 0.9, "allow_overlap": True}},
    )
    before = sim.measure()
    sim.run()
    after, p = sim.measure(), everyone(sim)
    apart = np.sqrt(((p.position[:, None] - p.position[None]) ** 2).sum(axis=2))[np.triu_indices(5, 1)].min()
    change = max(abs(after[f"momentum_{k}"] - before[f"momentum_{k}"]) for k in "xyz"[:d])
    risen = after["kinetic"] / before["kinetic"] - 1.0
    holds = apart >= 1.0 - 1e-12 and change <= 1e-14 * 20.0 and risen <= 1e-14
    return f"closest {apart:.3f} diameters, momentum off {change:.0e}, energy {risen:+.1%}", bool(holds)


@case("touching, at rest or moving apart", "an event at zero time, for ever", "no event")
def touching(bench: Bench) -> tuple[str, bool]:
    d = bench.dimension
    places = [along(d, x) for x in (0.0, 1.0, 3.0, 4.0)]
    sim = bench.simulate(
        time={"step": 0.01, "steps": 100},
        particles=[{"position": places, "velocity": [along(d, v) for v in (0.0, 0.0, -1.0, 1.0)], "radius": 0.5}],
        effects={"collisions": {}},
    )
    sim.run()
    events = int(sim.ranks.allreduce_sum(sim.totals["collisions"])[0])
    return f"{events} events in 100 steps", events == 0


@case(
    "grazing, from distance 1e4 with b/d = 1 - 1e-10",
    "b^2 - a c cancels: 220 of 300 missed",
    "0 of 300 missed",
)
def grazing(bench: Bench) -> tuple[str, bool]:
    """Whole steps by `event`; the root that `rewind` uses, because its steps may not be so long."""
    d, random, missed = bench.dimension, np.random.default_rng(2), 0
    for _ in range(300):
        way = random.standard_normal(d)
        way /= sqrt(way @ way)
        side = random.standard_normal(d)
        side -= (side @ way) * way
        x = np.array([1e4 * way + side / sqrt(side @ side) * (1.0 - 1e-10), np.zeros(d)])
        v = np.array([-2e4 * way, np.zeros(d)])
        if bench.mode == "rewind":
            t = contact_time((0,) * d, x, v, np.zeros(2), 0, 1, 1.0, 1.0, np.zeros(d))
            missed += t == NEVER
            continue
        sim = bench.simulate(
            time={"step": 1.0, "steps": 1},
            particles=[{"position": x.tolist(), "velocity": v.tolist(), "radius": 0.5}],
            effects={"collisions": {}},
        )
        sim.step()
        missed += int(sim.ranks.allreduce_sum(sim.totals["collisions"])[0]) == 0
        bench.built.clear()
    return f"{missed} of 300 missed", missed == 0


@case("mass ratio 1e8, and a fixed sphere", "momentum lost to round-off, the heavy one shaken", "momentum to a few ulp")
def mass_ratio(bench: Bench) -> tuple[str, bool]:
    d = bench.dimension
    sim = bench.simulate(
        time={"step": 0.01, "steps": 400},
        particles=[
            {"position": [along(d, 0.0)], "velocity": along(d, 1.0), "radius": 0.5, "mass": 1e8},
            {"position": [along(d, 1.5)], "radius": 0.5, "mass": 1.0},
            {"position": [along(d, 20.0)], "velocity": along(d, -3.0), "radius": 0.5, "mass": 1.0},
            {"position": [along(d, 17.0)], "radius": 0.5, "fixed": True},
        ],
        effects={"collisions": {}},
    )
    sim.run()
    p = everyone(sim)
    sent = p.velocity[1, 0] - 2.0 / (1.0 + 1e-8)  # what the light one must get
    off = abs(1e8 * p.velocity[0, 0] + p.velocity[1, 0] - 1e8) / 1e8
    still = bool((p.position[3] == along(d, 17.0)).all() and (p.velocity[3] == 0.0).all())
    holds = off <= 4e-16 and abs(sent) <= 1e-14 and still and p.velocity[2, 0] == 3.0
    return f"momentum off {off:.0e}, light one {sent:+.0e}, fixed one {'still' if still else 'MOVED'}", bool(holds)


@case("as many walls as axes in one step", "reflected by one, out through another", "inside, reflected by each")
def corner(bench: Bench) -> tuple[str, bool]:
    d = bench.dimension
    sim = bench.simulate(
        box={"lower": [0.0] * d, "upper": [10.0] * d},
        time={"step": 1.0, "steps": 1},
        particles=[{"position": [[1.2 + 0.1 * k for k in range(d)]], "velocity": [-1.0] * d, "radius": 0.9}],
        effects={"walls": {}, "collisions": {}},
    )
    sim.step()
    p = everyone(sim)
    right = np.array([[0.9 + 1.0 - (0.3 + 0.1 * k) for k in range(d)]])
    off = np.abs(p.position - right).max()
    holds = off <= 1e-15 * 4 and (p.velocity == 1.0).all()
    return f"{sim.ranks.allreduce_sum(sim.totals['wall_hits'])[0]} hits, place off {off:.0e}", bool(holds)


@case("acute wedge of two planes (10 degrees)", "leaves through the other plane", "inside; ceil(pi/angle) bounces at most")
def wedge(bench: Bench) -> tuple[str, bool]:
    d, angle = bench.dimension, pi / 18.0
    rest = [0.0] * (d - 2)
    planes = [
        {"point": [0.0] * d, "normal": [0.0, 1.0, *rest]},
        {"point": [0.0] * d, "normal": [float(np.sin(angle)), float(-np.cos(angle)), *rest]},
    ]
    sim = bench.simulate(
        time={"step": 0.05, "steps": 800},
        particles=[
            {"position": [[20.0, 20.0 * float(np.tan(angle / 2)), *rest]], "velocity": [-1.0, 0.03, *rest], "radius": 0.1}
        ],
        effects={"walls": {"planes": planes}, "collisions": {}},
    )
    deepest = np.inf
    for _ in range(800):
        sim.step()
        x = everyone(sim).position[0]
        deepest = min(deepest, x[1], np.sin(angle) * x[0] - np.cos(angle) * x[1])
    hits = int(sim.ranks.allreduce_sum(sim.totals["wall_hits"])[0])
    energy = sim.measure()["kinetic"] / (0.5 * (1.0 + 0.03**2)) - 1.0
    holds = deepest >= 0.1 - 1e-13 and hits <= 18 and abs(energy) <= 1e-14 and everyone(sim).velocity[0, 0] > 0.0
    return f"{hits} bounces, closest {deepest - 0.1:+.0e} beyond a radius, energy {energy:+.0e}", bool(holds)


@case("bullet: 100 diameters a step, thin wall", "flies through", "`event` hits; `rewind` refuses the scene")
def bullet(bench: Bench) -> tuple[str, bool]:
    d = bench.dimension
    scene = dict(
        time={"step": 1.0, "steps": 1},
        particles=[
            {"position": [along(d, 0.0)], "velocity": along(d, 100.0), "radius": 0.5},
            {"position": [along(d, 60.3)], "radius": 0.01, "fixed": True},
            {"position": [[-60.0, 5.0] + [0.0] * (d - 2)], "velocity": along(d, -200.0), "radius": 0.5},
        ],
        effects={"collisions": {}, "walls": {"planes": [{"point": along(d, -100.0), "normal": along(d, 1.0)}]}},
    )
    try:
        sim = bench.simulate(**scene)
    except SceneError as error:
        return f"refused: {error.faults[0][:40]}...", bench.mode == "rewind" and "time.step" in str(error)
    sim.step()
    v = everyone(sim).velocity[:, 0]
    return f"speeds after: {v[0]:g}, {v[2]:g}", bool(abs(v[0] + 100.0) <= 1e-12 and v[2] == 200.0)


@case("squeezed between wall and sphere, and between two fixed spheres", "endless loop, or thrown out", "capped, counted, inside")
def squeezed(bench: Bench) -> tuple[str, bool]:
    d = bench.dimension
    sim = bench.simulate(
        box={"lower": [0.0] * d, "upper": [20.0] * d},
        time={"step": 0.01, "steps": 20},
        particles=[
            {"position": [[0.5] + [5.0] * (d - 1)], "velocity": along(d, 1.0), "radius": 0.5},
            {
                "position": [[1.5] + [5.0] * (d - 1), [9.0] + [5.0] * (d - 1), [11.0] + [5.0] * (d - 1)],
                "radius": 0.5,
                "fixed": True,
            },
            {"position": [[10.0] + [5.0] * (d - 1)], "velocity": along(d, 1.0), "radius": 0.5},
        ],
        effects={"collisions": {}, "walls": {}},
    )
    sim.run()
    p, missed = everyone(sim), int(sim.ranks.allreduce_sum(sim.totals["missed"])[0])
    off = max(abs(p.position[0, 0] - 0.5), abs(p.position[4, 0] - 10.0))
    return f"{missed} counted as missed, moved {off:.0e}", bool(missed > 0 and off <= 1e-12 and np.isfinite(p.velocity).all())
