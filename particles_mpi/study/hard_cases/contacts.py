"""Single contacts: where and when they happen, and what they give."""

from math import pi, sqrt

import numpy as np

from particles_mpi import SceneError
from particles_mpi.contacts.law import contact_time
from particles_mpi.kernels.markers import NEVER
from particles_mpi.study.experiment import everyone, total
from particles_mpi.study.hard_cases.catalogue import CaseRun, Effects, Finding, case


@case(
    "overlap at the start, coincident centres",
    "0/0 makes NaN, or a spring throws them apart",
    "finite, separated, momentum kept, energy not raised",
)
def overlap(run: CaseRun) -> Finding:
    """Two clusters of spheres that overlap, two of them at the same place."""
    places = [run.point(x) for x in (0.0, 0.0, 0.7, 5.0, 5.1)]
    speeds = np.random.default_rng(1).standard_normal((5, run.dimension)).tolist()
    spheres = {"position": places, "velocity": speeds, "radius": 0.5, "mass": [1.0, 2.0, 1.0, 3.0, 1.0]}
    sim = run.simulate([spheres], 0.01, 200, {"collisions": {"restitution": 0.9, "allow_overlap": True}})
    before = sim.measure()
    sim.run()
    after, p = sim.measure(), everyone(sim)
    apart = np.sqrt(((p.position[:, None] - p.position[None]) ** 2).sum(axis=2))[np.triu_indices(5, 1)].min()
    change = max(abs(after[f"momentum_{k}"] - before[f"momentum_{k}"]) for k in "xyz"[: run.dimension])
    risen = after["kinetic"] / before["kinetic"] - 1.0
    holds = apart >= 1.0 - 1e-12 and change <= 1e-14 * 20.0 and risen <= 1e-14
    return f"closest {apart:.3f} diameters, momentum off {change:.0e}, energy {risen:+.1%}", bool(holds)


@case("touching, at rest or moving apart", "an event at zero time, for ever", "no event")
def touching(run: CaseRun) -> Finding:
    """A pair at rest, and a pair that moves apart."""
    places, speeds = ([run.point(x) for x in column] for column in ((0.0, 1.0, 3.0, 4.0), (0.0, 0.0, -1.0, 1.0)))
    sim = run.simulate([{"position": places, "velocity": speeds, "radius": 0.5}], 0.01, 100, {"collisions": {}})
    sim.run()
    events = total(sim, "collisions")
    return f"{events} events in 100 steps", events == 0


@case("grazing, from distance 1e4 with b/d = 1 - 1e-10", "b^2 - a c cancels: 220 of 300 missed", "0 of 300 missed")
def grazing(run: CaseRun) -> Finding:
    """Whole steps by `event`; the root that `rewind` uses, because its steps may not be so long."""
    d, random, missed = run.dimension, np.random.default_rng(2), 0
    for _ in range(300):
        way = random.standard_normal(d)
        way /= sqrt(way @ way)
        side = random.standard_normal(d)
        side -= (side @ way) * way
        x = np.array([1e4 * way + side / sqrt(side @ side) * (1.0 - 1e-10), np.zeros(d)])
        v = np.array([-2e4 * way, np.zeros(d)])
        if run.mode == "rewind":
            t = contact_time((0,) * d, x, v, np.zeros(2), 0, 1, 1.0, 1.0, np.zeros(d))
            missed += t == NEVER
            continue
        pair = {"position": x.tolist(), "velocity": v.tolist(), "radius": 0.5}
        sim = run.simulate([pair], 1.0, effects={"collisions": {}})
        sim.step()
        missed += total(sim, "collisions") == 0
        run.built.clear()
    return f"{missed} of 300 missed", missed == 0


@case("mass ratio 1e8, and a fixed sphere", "momentum lost to round-off, the heavy one shaken", "momentum to a few ulp")
def mass_ratio(run: CaseRun) -> Finding:
    """A heavy sphere hits a light one, another light one a sphere that is fixed."""
    particles = [
        {"position": [run.point(0.0)], "velocity": run.point(1.0), "radius": 0.5, "mass": 1e8},
        {"position": [run.point(1.5)], "radius": 0.5, "mass": 1.0},
        {"position": [run.point(20.0)], "velocity": run.point(-3.0), "radius": 0.5, "mass": 1.0},
        {"position": [run.point(17.0)], "radius": 0.5, "fixed": True},
    ]
    sim = run.simulate(particles, 0.01, 400, {"collisions": {}})
    sim.run()
    p = everyone(sim)
    sent = p.velocity[1, 0] - 2.0 / (1.0 + 1e-8)  # what the light one must get
    off = abs(1e8 * p.velocity[0, 0] + p.velocity[1, 0] - 1e8) / 1e8
    still = bool((p.position[3] == run.point(17.0)).all() and (p.velocity[3] == 0.0).all())
    holds = off <= 4e-16 and abs(sent) <= 1e-14 and still and p.velocity[2, 0] == 3.0
    return f"momentum off {off:.0e}, light one {sent:+.0e}, fixed one {'still' if still else 'MOVED'}", bool(holds)


@case("as many walls as axes in one step", "reflected by one, out through another", "inside, reflected by each")
def corner(run: CaseRun) -> Finding:
    """A ball flies into the corner of a box."""
    d = run.dimension
    ball = {"position": [[1.2 + 0.1 * k for k in range(d)]], "velocity": [-1.0] * d, "radius": 0.9}
    sim = run.simulate([ball], 1.0, effects={"walls": {}, "collisions": {}}, box=run.cube(10.0))
    sim.step()
    p = everyone(sim)
    off = np.abs(p.position - np.array([[0.9 + 1.0 - (0.3 + 0.1 * k) for k in range(d)]])).max()
    holds = off <= 1e-15 * 4 and (p.velocity == 1.0).all()
    return f"{total(sim, 'wall_hits')} hits, place off {off:.0e}", bool(holds)


@case("acute wedge of two planes (10 degrees)", "leaves through the other plane", "inside; ceil(pi/angle) bounces at most")
def wedge(run: CaseRun) -> Finding:
    """A ball flies into the wedge, and out again."""
    angle = pi / 18.0
    normals = run.point(0.0, 1.0), run.point(float(np.sin(angle)), float(-np.cos(angle)))
    walls = {"planes": [{"point": run.point(), "normal": normal} for normal in normals]}
    place = run.point(20.0, 20.0 * float(np.tan(angle / 2)))
    ball = {"position": [place], "velocity": run.point(-1.0, 0.03), "radius": 0.1}
    sim = run.simulate([ball], 0.05, 800, {"walls": walls, "collisions": {}})
    deepest = np.inf
    for _ in range(800):
        sim.step()
        x = everyone(sim).position[0]
        deepest = min(deepest, x[1], np.sin(angle) * x[0] - np.cos(angle) * x[1])
    hits = total(sim, "wall_hits")
    energy = sim.measure()["kinetic"] / (0.5 * (1.0 + 0.03**2)) - 1.0
    holds = deepest >= 0.1 - 1e-13 and hits <= 18 and abs(energy) <= 1e-14 and everyone(sim).velocity[0, 0] > 0.0
    return f"{hits} bounces, closest {deepest - 0.1:+.0e} beyond a radius, energy {energy:+.0e}", bool(holds)


@case("bullet: 100 diameters a step, thin wall", "flies through", "`event` hits; `rewind` refuses the scene")
def bullet(run: CaseRun) -> Finding:
    """One bullet meets a tiny fixed sphere, the other a plane."""
    particles = [
        {"position": [run.point(0.0)], "velocity": run.point(100.0), "radius": 0.5},
        {"position": [run.point(60.3)], "radius": 0.01, "fixed": True},
        {"position": [run.point(-60.0, 5.0)], "velocity": run.point(-200.0), "radius": 0.5},
    ]
    walls = {"planes": [{"point": run.point(-100.0), "normal": run.point(1.0)}]}
    try:
        sim = run.simulate(particles, 1.0, effects={"collisions": {}, "walls": walls})
    except SceneError as error:
        return f"refused: {error.faults[0][:40]}...", run.mode == "rewind" and "time.step" in str(error)
    sim.step()
    v = everyone(sim).velocity[:, 0]
    return f"speeds after: {v[0]:g}, {v[2]:g}", bool(abs(v[0] + 100.0) <= 1e-12 and v[2] == 200.0)


@case("squeezed between wall and sphere, and between two fixed spheres", "endless loop, or thrown out", "capped, counted, inside")
def squeezed(run: CaseRun) -> Finding:
    """Two spheres without room to move, both with a speed."""
    moving = [{"position": [run.point(x, rest=5.0)], "velocity": run.point(1.0), "radius": 0.5} for x in (0.5, 10.0)]
    fixed = {"position": [run.point(x, rest=5.0) for x in (1.5, 9.0, 11.0)], "radius": 0.5, "fixed": True}
    effects: Effects = {"collisions": {}, "walls": {}}
    sim = run.simulate([moving[0], fixed, moving[1]], 0.01, 20, effects, box=run.cube(20.0))
    sim.run()
    p, missed = everyone(sim), total(sim, "missed")
    off = max(abs(p.position[0, 0] - 0.5), abs(p.position[4, 0] - 10.0))
    return f"{missed} counted as missed, moved {off:.0e}", bool(missed > 0 and off <= 1e-12 and np.isfinite(p.velocity).all())
