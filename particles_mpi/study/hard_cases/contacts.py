"""Friction and drag where explicit rules fail; single contacts: where and when they happen, and their result."""

from math import pi, sqrt

import numpy as np

from particles_mpi import SceneError
from particles_mpi.contacts.law import contact_time
from particles_mpi.kernels.markers import NEVER
from particles_mpi.study.experiment import all_particles, total_count
from particles_mpi.study.hard_cases.catalogue import CaseRun, Effects, Finding, case


@case(
    "friction at rest, force below alpha", "0/0 makes NaN, or the particle creeps", "v and displacement exactly 0", modes=(None,)
)
def friction_at_rest(run: CaseRun) -> Finding:
    """Eight particles at rest, pushed harder one by one."""
    places = [run.point(float(k)) for k in range(8)]
    pushes = [run.point(0.999 * k / 7.0) for k in range(8)]
    effects: Effects = {"friction": {"strength": 1.0}, "user_acceleration": {}}
    _, p = run.finish([{"position": places, "acceleration": pushes}], 0.1, 1000, effects)
    moved, fast = np.abs(p.position - places).max(), np.abs(p.velocity).max()
    return f"v {fast:.0f}, displacement {moved:.0f}", bool(moved == 0.0 and fast == 0.0)


@case("drag with k dt = 10", "explodes, or changes sign every step", "monotone decay to g/k", modes=(None,))
def stiff_drag(run: CaseRun) -> Finding:
    """Two particles thrown up and down, each a hundred times as fast as it falls in the end."""
    thrown = {"position": [run.point(), run.point(1.0, rest=1.0)], "velocity": [run.upright(v) for v in (100.0, -100.0)]}
    effects: Effects = {"drag": {"rate": 100.0}, "uniform_gravity": {"acceleration": run.upright(-9.81)}}
    sim = run.simulate([thrown], 0.1, 40, effects)
    end, left = -9.81 / 100.0, []
    for _ in range(40):
        sim.step()
        left.append(np.abs(all_particles(sim).velocity[:, -1] - end).max())
    monotone = bool((np.diff(left) <= 0.0).all())
    return f"{'monotone' if monotone else 'NOT monotone'}, {left[-1] / abs(end):.0e} off g/k", monotone and left[-1] <= 1e-12


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
    after, p = sim.measure(), all_particles(sim)
    apart = np.sqrt(((p.position[:, None] - p.position[None]) ** 2).sum(axis=2))[np.triu_indices(5, 1)].min()
    change = max(abs(after[f"momentum_{k}"] - before[f"momentum_{k}"]) for k in "xyz"[: run.dimension])
    risen = after["kinetic"] / before["kinetic"] - 1.0
    holds = apart >= 1.0 - 1e-12 and change <= 1e-14 * 20.0 and risen <= 1e-14
    return f"closest {apart:.3f} diameters, momentum off {change:.0e}, energy {risen:+.1%}", bool(holds)


@case("touching, at rest or moving apart", "an event at zero time, for ever", "no event")
def touching(run: CaseRun) -> Finding:
    """A pair at rest, and a pair that moves apart."""
    places, speeds = ([run.point(x) for x in column] for column in ((0.0, 1.0, 3.0, 4.0), (0.0, 0.0, -1.0, 1.0)))
    sim, _ = run.finish([{"position": places, "velocity": speeds, "radius": 0.5}], 0.01, 100, {"collisions": {}})
    events = total_count(sim, "collisions")
    return f"{events} events in 100 steps", events == 0


@case("grazing, from distance 1e4 with b/d = 1 - 1e-10", "b^2 - a c cancels: 220 of 300 missed", "0 of 300 missed")
def grazing(run: CaseRun) -> Finding:
    """`event` computes whole steps; of `rewind`, which allows no such long steps, only its root is tested."""
    d, random, missed = run.dimension, np.random.default_rng(2), 0
    for _ in range(300):
        way, side = random.standard_normal((2, d))
        way /= sqrt(way @ way)
        side -= (side @ way) * way
        x = np.array([1e4 * way + side / sqrt(side @ side) * (1.0 - 1e-10), np.zeros(d)])
        v = np.array([-2e4 * way, np.zeros(d)])
        if run.mode == "rewind":
            missed += contact_time((0,) * d, x, v, np.zeros(2), 0, 1, 1.0, 1.0, np.zeros(d)) == NEVER
            continue
        sim = run.simulate([{"position": x.tolist(), "velocity": v.tolist(), "radius": 0.5}], 1.0, effects={"collisions": {}})
        sim.step()
        missed += total_count(sim, "collisions") == 0
        run.built.clear()
    return f"{missed} of 300 missed", missed == 0


@case("mass ratio 1e8, and a fixed sphere", "momentum lost to round-off, the heavy one shaken", "momentum to a few ulp")
def mass_ratio(run: CaseRun) -> Finding:
    """A heavy sphere hits a light one, and another light one hits a fixed sphere."""
    particles = [
        {"position": [run.point(0.0)], "velocity": run.point(1.0), "radius": 0.5, "mass": 1e8},
        {"position": [run.point(1.5)], "radius": 0.5, "mass": 1.0},
        {"position": [run.point(20.0)], "velocity": run.point(-3.0), "radius": 0.5, "mass": 1.0},
        {"position": [run.point(17.0)], "radius": 0.5, "fixed": True},
    ]
    _, p = run.finish(particles, 0.01, 400, {"collisions": {}})
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
    sim, p = run.finish([ball], 1.0, effects={"walls": {}, "collisions": {}}, box=run.cube(10.0))
    off = np.abs(p.position - np.array([[0.9 + 1.0 - (0.3 + 0.1 * k) for k in range(d)]])).max()
    return f"{total_count(sim, 'wall_hits')} hits, place off {off:.0e}", bool(off <= 1e-15 * 4 and (p.velocity == 1.0).all())


@case("acute wedge of two planes (10 degrees)", "leaves through the other plane", "inside; ceil(pi/angle) bounces at most")
def wedge(run: CaseRun) -> Finding:
    """A ball flies into the wedge, and out again."""
    angle = pi / 18.0
    normals = run.point(0.0, 1.0), run.point(float(np.sin(angle)), float(-np.cos(angle)))
    walls = {"planes": [{"point": run.point(), "normal": normal} for normal in normals]}
    place = run.point(20.0, 20.0 * float(np.tan(angle / 2)))
    ball = {"position": [place], "velocity": run.point(-1.0, 0.03), "radius": 0.1}
    sim, deepest = run.simulate([ball], 0.05, 800, {"walls": walls, "collisions": {}}), np.inf
    for _ in range(800):
        sim.step()
        x = all_particles(sim).position[0]
        deepest = min(deepest, x[1], np.sin(angle) * x[0] - np.cos(angle) * x[1])
    hits, energy = total_count(sim, "wall_hits"), sim.measure()["kinetic"] / (0.5 * (1.0 + 0.03**2)) - 1.0
    holds = deepest >= 0.1 - 1e-13 and hits <= 18 and abs(energy) <= 1e-14 and all_particles(sim).velocity[0, 0] > 0.0
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
        _, p = run.finish(particles, 1.0, effects={"collisions": {}, "walls": walls})
    except SceneError as error:
        return f"refused: {error.faults[0][:40]}...", run.mode == "rewind" and "time.step" in str(error)
    v = p.velocity[:, 0]
    return f"speeds after: {v[0]:g}, {v[2]:g}", bool(abs(v[0] + 100.0) <= 1e-12 and v[2] == 200.0)


@case("squeezed between wall and sphere, and between two fixed spheres", "endless loop, or thrown out", "capped, counted, inside")
def squeezed(run: CaseRun) -> Finding:
    """Two spheres without room to move have a speed."""
    moving = [{"position": [run.point(x, rest=5.0)], "velocity": run.point(1.0), "radius": 0.5} for x in (0.5, 10.0)]
    fixed = {"position": [run.point(x, rest=5.0) for x in (1.5, 9.0, 11.0)], "radius": 0.5, "fixed": True}
    effects: Effects = {"collisions": {}, "walls": {}}
    sim, p = run.finish([moving[0], fixed, moving[1]], 0.01, 20, effects, box=run.cube(20.0))
    missed = total_count(sim, "missed")
    off = max(abs(p.position[0, 0] - 0.5), abs(p.position[4, 0] - 10.0))
    return f"{missed} counted as missed, moved {off:.0e}", bool(missed > 0 and off <= 1e-12 and np.isfinite(p.velocity).all())
