"""Contacts that last: what forces press together comes to rest, does not sink, and does not get warm."""

import resource

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import pdist
from with_all import with_all

from particles_mpi import Scene, Simulation
from particles_mpi.contacts.persistent.descent import EXACT
from particles_mpi.contacts.persistent.iterations import OUTLIER
from particles_mpi.contacts.persistent.problem import IMPULSE, Problem, bound_rows, table_of
from particles_mpi.contacts.persistent.solver import Solver
from particles_mpi.parallel.communicator import Communicator

MODES = ("rewind", "event")
FLOOR = {d: [{"point": [0.0] * d, "normal": [0.0] * (d - 1) + [1.0]}] for d in (2, 3)}
LOSSES = (0.5, *with_all(0.0, 0.9))


def column(mode, e, n, steps, d=2, apart=1.02):
    """n spheres of radius 0.05 one above the other, dropped from small distances."""
    places = [[0.5] * (d - 1) + [0.05 + 0.1 * k * apart] for k in range(n)]
    return Simulation(
        Scene(
            dimension=d,
            box={"lower": [0.0] * d, "upper": [1.0] * (d - 1) + [0.12 * n + 1.0]},
            time={"step": 0.005, "steps": steps},
            particles=[{"position": places, "radius": 0.05}],
            effects={
                "uniform_gravity": {"acceleration": [0.0] * (d - 1) + [-9.81]},
                "walls": {"restitution": e},
                **({"collisions": {"mode": mode, "restitution": e}} if mode else {}),
            },
        )
    )


@pytest.mark.parametrize("mode", [None, *MODES])
@pytest.mark.parametrize("e", LOSSES)
def test_a_ball_comes_to_rest(mode, e):
    """Kinetic energy exactly 0, and it stays; never more energy than before; nothing below the floor."""
    sim = column(mode, e, 1, 0)
    sim.particles.position[0, 1] = 0.3
    energy, lowest = sim.measure()["total_energy"], np.inf
    for _ in range(1500):
        sim.step()
        now = sim.measure()["total_energy"]
        assert now <= energy + 1e-12
        energy, lowest = now, min(lowest, sim.particles.position[0, 1])
    place = sim.particles.position.copy()
    for _ in range(200):
        sim.step()
        assert (sim.particles.velocity == 0.0).all() and (sim.particles.position == place).all()
    assert lowest >= 0.05 - 1e-12 and place[0, 1] == pytest.approx(0.05, abs=1e-5)


@pytest.mark.parametrize("mode", [None, *MODES])
def test_a_step_without_collisions_keeps_no_contact(mode):
    """Free fall through the floor and through the ball below, for one step; the next is one with contacts again."""
    sim = column(mode, 0.5, 2 if mode else 1, 0, apart=1.0)
    for _ in range(50):
        sim.step()
    assert np.abs(sim.particles.velocity).max() < 1e-7
    sim.step(collisions=False)
    np.testing.assert_allclose(sim.particles.velocity[:, 1], -9.81 * 0.005, atol=1e-7)


def test_an_elastic_ball_never_rests():
    assert "supported" not in column("event", 1.0, 1, 0).particles.arrays


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("n", "d"), [(10, 2), (50, 3)])
@pytest.mark.parametrize("e", LOSSES)
def test_a_column_comes_to_rest(mode, n, d, e):
    sim = column(mode, e, n, 1000, d)
    sim.run()
    x = sim.particles.position[np.argsort(sim.particles.id)].copy()
    assert sim.measure()["kinetic"] < 1e-20
    assert (np.diff(x[:, -1]) >= 0.1 * (1.0 - 0.5e-3)).all() and x[0, -1] >= 0.05 * (1.0 - 1e-3)
    for _ in range(200):
        sim.step()
    assert np.abs(sim.particles.position[np.argsort(sim.particles.id)] - x).max() < 1e-9
    assert x[-1, -1] == pytest.approx(0.1 * n - 0.05, abs=1e-4 * n)


def touching(shape, d):
    """Places of spheres of radius 0.5 that touch, with gaps of round-off: a column, a pyramid, a ball around its middle one."""
    if shape == "column":
        return [[0.5] * (d - 1) + [0.5 + k] for k in range(10)]
    if shape == "pyramid":  # its lowest row fills the box
        return [[0.5 + i + 0.5 * k, *[0.5] * (d - 2), 0.5 + k * 0.75**0.5] for k in range(6) for i in range(6 - k)]
    return np.stack(np.meshgrid(*[np.arange(3.0)] * d), axis=-1).reshape(-1, d).tolist()  # row 13 is its middle


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("surface", [{"restitution": 0.0}, {"restitution": 0.5}, {"restitution": 0.5, "friction": 0.3}])
@pytest.mark.parametrize(
    ("shape", "d", "walls"),
    [("column", 2, {}), ("column", 3, {}), ("pyramid", 2, {}), ("pyramid", 3, {}), ("ball", 3, {})]
    + [(shape, 2, {"restitution": 1.0, "friction": 0.0}) for shape in ("column", "pyramid")],
)
def test_spheres_that_touch_from_the_start_stand_still(shape, d, walls, surface, mode):
    """No speed, no collision, and after a few steps no work: contacts of round-off are none; on walls that take no energy too."""
    walls = surface | walls
    down = {"uniform_gravity": {"acceleration": [0.0] * (d - 1) + [-9.81]}}
    forces = {"mutual_gravity": {"G": 1.0}} if shape == "ball" else down
    places = touching(shape, d)
    sim = Simulation(
        Scene(
            dimension=d,
            box={"lower": [0.0] * d, "upper": [6.0] + [1.0] * (d - 2) + [20.0]} if shape == "pyramid" else None,
            time={"step": 0.01, "steps": 1},
            particles=[{"position": places, "radius": 0.5, "fixed": [shape == "ball" and n == 13 for n in range(len(places))]}],
            effects=forces
            | ({"walls": walls} if shape == "pyramid" else {})
            | ({"walls": walls | {"planes": FLOOR[d]}} if shape == "column" else {})
            | {"collisions": surface | {"mode": mode}},
        )
    )
    for step in range(60):
        sim.step()
        assert step < 30 or not sim.particles.velocity.any(), step
        if step == 30:
            before = dict(sim.totals), sim.persistent.slow.solver.iterations
    assert (dict(sim.totals), sim.persistent.slow.solver.iterations) == before
    assert np.abs(sim.particles.position[np.argsort(sim.particles.id)] - places).max() < 1e-9


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("pairs", [{"restitution": 0.5}, {"damping": 0.01}, {"friction": 0.3}])
@pytest.mark.parametrize("speed", [1.5, 2.9, *with_all(2.4)])
def test_a_sphere_by_itself_bounces_on_an_elastic_floor_for_ever(speed, pairs, mode):
    """At speeds of so many times g h, though spheres would lose energy to one another; two far away lie one on the other."""
    row = {
        "position": [[0.0, 0.1], [9.0, 0.1], [9.0, 0.3]],
        "velocity": [[0.0, 0.1 * speed], [0.0, 0.0], [0.0, 0.0]],
        "radius": 0.1,
    }
    walls = {"planes": [{"point": [0, 0], "normal": [0, 1]}]}
    effects = {"uniform_gravity": {"acceleration": [0.0, -10.0]}, "collisions": pairs | {"mode": mode}, "walls": walls}
    sim = Simulation(Scene(dimension=2, time={"step": 0.01, "steps": 1000}, particles=[row], effects=effects))
    before = sim.measure()["total_energy"]
    sim.steps(1000)
    assert sim.measure()["total_energy"] == pytest.approx(before, abs=1e-12)


SURFACES = [{"restitution": 0.5}, {"restitution": 0.5, "friction": 0.3}]


def velocities(sim):
    """In the order of ids."""
    return sim.particles.velocity[np.argsort(sim.particles.id)]


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("surface", SURFACES)
@pytest.mark.parametrize("ratio", [1e2, 1e6, 1e12])
def test_a_light_sphere_pushes_a_heavy_one(ratio, surface, mode):
    """However slow both are, and though another one lies on a floor far away: momentum is kept."""
    heavy = {"position": [[0.0, 9.0]], "radius": 0.5, "mass": ratio}
    light = {"position": [[0.0, 10.0]], "radius": 0.5, "mass": 1.0, "acceleration": [0.0, -1.0]}
    lies = {"position": [[9.0, 0.5]], "radius": 0.5, "acceleration": [0.0, -1.0]}
    effects = {"user_acceleration": {}, "walls": {"restitution": 0.5, "planes": FLOOR[2]}, "collisions": surface | {"mode": mode}}
    particles = [heavy, light, lies]
    sim = Simulation(Scene(dimension=2, time={"step": 0.01, "steps": 100}, particles=particles, effects=effects))
    sim.steps(100)
    assert velocities(sim)[:2, 1] == pytest.approx(-1.0 / (1.0 + ratio), rel=1e-3, abs=0.0)


@pytest.mark.parametrize("surface", SURFACES)
@pytest.mark.parametrize("gap", [0.0, 5e-4])
@pytest.mark.parametrize("part", [1e-6, 1e-12])
def test_what_is_pressed_nearby_holds_nothing(part, gap, surface):
    """On a smooth floor two lie one on the other; weak forces move them past one that strong forces press onto it."""
    pressed = {"position": [[0.0, 0.5]], "radius": 0.5, "acceleration": [0.0, -1.0]}
    two = {"position": [[1.0 + gap, 0.5], [1.0 + gap, 1.5]], "radius": 0.5, "acceleration": [part, -part]}
    effects = {"user_acceleration": {}, "walls": {"restitution": 0.5, "planes": FLOOR[2]}, "collisions": surface}
    sim = Simulation(Scene(dimension=2, time={"step": 0.01, "steps": 100}, particles=[pressed, two], effects=effects))
    sim.steps(100)
    assert velocities(sim)[1:, 0] == pytest.approx(part, rel=1e-6, abs=0.0)


@pytest.mark.parametrize("surface", SURFACES)
@pytest.mark.parametrize("apart", [1e3, 1e6])
def test_balls_of_spheres_fall_toward_one_another(apart, surface):
    """What holds each of them together is stronger by twelve orders than what pulls them, which still moves all of it."""
    ball, half = np.array(touching("ball", 3)) - 1.0, np.array([0.5 * apart, 0.0, 0.0])
    places = np.concatenate((ball - half, ball + half)).tolist()
    effects = {"mutual_gravity": {"G": 1.0}, "collisions": surface | {"mode": "event"}}
    time = {"step": 0.02, "steps": 50}
    sim = Simulation(Scene(dimension=3, time=time, particles=[{"position": places, "radius": 0.5}], effects=effects))
    sim.steps(50)
    one, other = velocities(sim)[:27].mean(axis=0), velocities(sim)[27:].mean(axis=0)
    assert [one[0], other[0]] == pytest.approx([27.0 / apart**2, -27.0 / apart**2], rel=1e-3, abs=0.0)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("step", [0.1, *with_all(0.01)])
def test_two_spheres_rest_upon_one_another(mode, step):
    """rebound#865: masses 1, radii 2, from x = +-10 with G = 1 and e = 0.5: at rest at separation 4."""
    sim = Simulation(
        Scene(
            dimension=3,
            G=1.0,
            time={"step": step, "end": 200.0},
            particles=[{"position": [[10.0, 0.0, 0.0], [-10.0, 0.0, 0.0]], "radius": 2.0}],
            effects={"mutual_gravity": {}, "collisions": {"mode": mode, "restitution": 0.5}},
        )
    )
    sim.run()
    x = sim.particles.position
    assert 0.0 <= abs(x[0, 0] - x[1, 0]) - 4.0 < 2e-4 * step
    assert (sim.particles.velocity == 0.0).all()


@pytest.mark.parametrize("mode", ["rewind", *with_all("event")])
def test_a_pile_of_its_own_gravity(mode):
    """150 spheres fall together, e = 0.5: no overlap, energy only falls, and they settle."""
    sim = Simulation(
        Scene(
            dimension=3,
            G=1.0,
            seed=3,
            box={"lower": [-4.0] * 3, "upper": [4.0] * 3},
            time={"step": 0.01, "steps": 500},
            particles=[{"count": 150, "position": "random", "radius": 0.5}],
            effects={"mutual_gravity": {}, "collisions": {"mode": mode, "restitution": 0.5}},
        )
    )
    energies = []
    for _ in range(10):
        for _ in range(50):
            sim.step()
        energies.append(sim.measure())
        x = sim.particles.position
        apart = np.sqrt(((x[:, None] - x[None]) ** 2).sum(axis=2)) + 9.0 * np.eye(len(x))
        assert apart.min() >= 1.0 - 0.5e-3
    total = [row["total_energy"] for row in energies]
    assert (np.diff(total) <= 1e-4 * abs(total[-1])).all()
    assert energies[-1]["kinetic"] < 1e-3 * abs(total[-1])
    assert np.abs([energies[-1][f"momentum_{k}"] for k in "xyz"]).max() < 1e-9


def test_a_heap_that_is_rained_upon_does_not_rattle():
    """Counted work: without crowds 150 spheres make hundreds of contacts each in a step, as the first ones hit the heap."""
    sim = Simulation(
        Scene(
            dimension=3,
            seed=1,
            box={"lower": [0.0] * 3, "upper": [0.5, 0.5, 2.5]},
            time={"step": 0.005, "steps": 160},
            particles=[{"count": 150, "position": "random", "radius": {"min": 0.045, "max": 0.05}}],
            effects={
                "uniform_gravity": {"acceleration": [0.0, 0.0, -9.81]},
                "walls": {"restitution": 0.5},
                "collisions": {"mode": "event", "restitution": 0.5},
            },
        )
    )
    sim.run()
    assert sim.measure()["kinetic"] < 0.05 * 150 * 9.81 * 0.5
    assert sim.totals["collisions"] + sim.totals["wall_hits"] < 100 * 150
    said, sim.totals["unconverged"] = sim.remarks(), 2
    assert "collapsing crowds" in said[0]
    for height in (2.0, 2.2):
        sim.add({"position": [[0.25, 0.25, height]], "radius": 0.05})
    assert sim.remarks() == ["lasting contacts: 2 solutions ended above contact_tolerance", *said]  # once, whatever was changed


def test_only_those_that_are_near_are_looked_at():
    """Forces that differ press free spheres onto one another too, but most are far from any other: counted work."""
    sim = Simulation(
        Scene(
            dimension=3,
            seed=2,
            box={"lower": [0.0] * 3, "upper": [1.0] * 3, "periodic": True},
            time={"step": 0.02, "steps": 1},
            particles=[{"count": 150, "position": "random", "radius": 0.05, "acceleration": [0.0, 0.0, -1.0]}],
            effects={"user_acceleration": {}, "collisions": {"restitution": 0.5}},
        )
    )
    sim.persistent.keep(sim.rows, sim.sum_forces(), sim.h)
    graph, p = sim.persistent.history.graph, sim.rows
    apart = p.position[:, None] - p.position[None]
    apart -= np.round(apart)
    distance = np.sqrt((apart**2).sum(axis=2)) + 9.0 * np.eye(len(p))
    near = distance <= 2.0 * (0.05 + 5.0 * 2.0 * 0.02**2) + graph.skin
    assert 2 <= near.any(axis=1).sum() < 100
    rows = np.repeat(np.arange(len(p)), np.diff(graph.start))
    assert sorted(zip(rows.tolist(), graph.other.tolist())) == sorted(zip(*(k.tolist() for k in np.nonzero(near))))


def test_a_large_sphere_among_many_small_ones():
    """10 000 spheres of radius 0.9 pressed onto one of radius 100: memory goes with the contacts, not with their squares."""
    n = 10_000
    z, turn = 1.0 - (2.0 * np.arange(n) + 1.0) / n, np.pi * (1.0 + 5.0**0.5) * np.arange(n)
    ring = np.sqrt(1.0 - z * z)
    towards = np.stack((ring * np.cos(turn), ring * np.sin(turn), z), axis=1)
    small = {"position": (100.9 * (1.0 + 1e-12) * towards).tolist(), "radius": 0.9, "mass": 1.0}
    large = {"position": [[0.0] * 3], "radius": 100.0, "mass": 1e6}
    sim = Simulation(
        Scene(
            dimension=3,
            time={"step": 0.01, "steps": 3},
            particles=[large, small],
            effects={"user_acceleration": {}, "collisions": {"restitution": 0.5, "allow_overlap": True}},
        )
    )
    p = sim.particles
    p.acceleration[np.argsort(p.id)[1:]] = -towards
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    sim.run()
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB
    supported = sim.rows.supported[np.argsort(sim.rows.id)]
    assert supported.sum() > 0.99 * n
    assert sim.measure()["kinetic"] < 1e-3 * 0.5 * n * 0.03**2  # of what they would have in free fall


problems = st.tuples(st.integers(0, 2**32), st.integers(1, 30), st.integers(1, 60), st.sampled_from((0, 0, 50, 200)))


def half_edges(n, a, b, normal):
    """(order of the half-edges, by rows; start; partner; normal): a[c] and b[c] >= 0 have one each, walls are row n."""
    rows, partners = np.concatenate((a, b)), np.concatenate((np.where(b >= 0, b, n), a))
    order = np.argsort(rows, kind="stable")[np.count_nonzero(b < 0) :]
    start = np.searchsorted(rows[order], np.arange(n + 1))
    return order, start, partners[order].astype(np.int32), np.concatenate((normal, -normal))[order]


@given(problems)
@example((112302617, 13, 12, 0))  # errors pass through 0 while momentum carries them on
@settings(max_examples=60)
def test_projection(drawn):
    """No contact closes faster than it may, momentum stays, energy does not rise, and pressed ones close as fast as they may."""
    check_random_problem(*drawn)


def test_problems_at_random_are_solved():
    """As many contacts as rigid spheres have: nearly all problems, so that what is asserted of solutions is."""
    drawn = np.random.default_rng(1)
    solved = [check_random_problem(seed, drawn.integers(5, 30), drawn.integers(1, 40), 0) for seed in range(60)]
    few = [converged for converged, few in solved if few]
    assert len(few) > 40 and np.mean(few) > 0.97


def check_random_problem(seed, n, contacts, idle):
    """Solves a problem at random, asserts what must hold, and returns (is it solved, are there as few as rigid spheres have?).

    `idle`: contacts with gaps that hardly ever close.
    """
    random = np.random.default_rng(seed)
    w = np.where(random.random(n) < 0.1, 0.0, 10.0 ** random.uniform(-3, 3, n))
    a = random.integers(0, n, contacts + idle)
    b = random.integers(-3, n, contacts + idle)
    of_b = np.where(b >= 0, w[np.maximum(b, 0)], 0.0)
    good = (a != b) & (w[a] + of_b > 0.0) & ((b >= 0) | (w[a] > 0.0))
    a, b = a[good], np.maximum(b[good], -1)
    normal = random.standard_normal((len(a), 3))
    normal /= np.sqrt((normal**2).sum(axis=1))[:, None]
    may_close = np.where(random.random(len(a)) < 0.5, 0.0, random.random(len(a)))
    may_close[random.random(len(a)) < idle / (contacts + idle)] += 3.0
    v = np.where(w[:, None] > 0.0, random.standard_normal((n, 3)), 0.0)
    before, w = v.copy(), np.append(w, 0.0)
    order, start, partner, normals = half_edges(n, a, b, normal)
    axes, all_of_them, bound = (0.0, 0.0, 0.0), np.ones(len(partner), np.bool_), np.zeros(n + 1)
    bound_rows(axes, start, normals, w, all_of_them, bound)
    may = np.concatenate((may_close, may_close))[order]
    table = table_of(axes, start, partner, normals, w, all_of_them, bound, may, np.zeros(len(may)))
    problem = Problem(start, partner, table, np.full(len(may), 1e9), np.full(len(may), 1e11))
    solver = Solver(Communicator.alone(), axes)
    v, converged, _ = solver.solve(problem, w, np.vstack((v, np.zeros(3))), np.arange(n), lambda _: None, EXACT)
    v, impulses = np.vstack((v, np.zeros(3))), table[:, IMPULSE]
    both = np.full((2, len(a)), np.nan)
    both.reshape(-1)[order] = impulses
    assert (both[0] == both[1])[b >= 0].all()  # the two owners of a contact come to the same bits
    speeds = ((v[a] - v[b]) * normal).sum(axis=1)  # b = -1 is the wall
    assert (impulses >= 0.0).all()
    # As many as rigid spheres have; with more their shares are not unique, and convergence is slow.
    few = ((may_close < 3.0) | (both[0] > 0.0)).sum() <= 3 * n
    assert not few or converged or solver.iterations >= 5000
    left = 50.0 * OUTLIER / 1e9  # an error is a speed; iterations end where the largest one is OUTLIER/1e9, and one more follows
    assert not converged or (speeds + may_close >= -left).all()
    mass = np.divide(1.0, w, out=np.zeros(n + 1), where=w > 0.0)[:n, None]
    energy = [float((mass * u**2).sum()) for u in (before, v[:n])]
    assert energy[1] <= energy[0] * (1.0 + 1e-9) + 1e-9
    assert not converged or (np.abs(speeds + may_close) <= left)[both[0] > 1e-6].all()
    if (w[:n] > 0.0).all() and (b >= 0).all():
        np.testing.assert_allclose((mass * v[:n]).sum(axis=0), (mass * before).sum(axis=0), rtol=1e-9, atol=1e-9 * mass.sum())
    return bool(converged), bool(few)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("surface", [{"restitution": 0.0}, {"restitution": 0.5}, {}, {"restitution": 0.5, "friction": 0.3}])
@pytest.mark.parametrize(
    ("effects", "speed"),
    [
        ({"drag": {}}, lambda t: 3.0 * np.exp(-2.0 / 11.0 * t)),  # (10 * 0.1 + 1 * 1.0)/11 for both together
        ({"friction": {"strength": 0.3}}, lambda t: 3.0 - 0.6 / 11.0 * t),
    ],
)
def test_a_sphere_that_is_slowed_less_pushes_the_one_before_it(mode, surface, effects, speed):
    """It presses that one for 5 units of time, goes with it at the speed of both together, and never goes into it."""
    both = {"velocity": [0.0, -3.0], "radius": 0.5}
    sim = Simulation(
        Scene(
            dimension=2,
            time={"step": 0.01, "steps": 500},
            particles=[
                {"position": [[0.0, 1.0]], "mass": 10.0, **both} | ({"drag": 0.1} if "drag" in effects else {}),
                {"position": [[0.0, 0.0]], "mass": 1.0, **both} | ({"drag": 1.0} if "drag" in effects else {}),
            ],
            effects=effects | {"collisions": {"mode": mode} | surface},
        )
    )
    for _ in range(500):
        sim.step()
        assert np.ptp(sim.particles.position[:, 1]) >= 1.0 - 1e-12
    assert -sim.particles.velocity[:, 1] == pytest.approx(speed(sim.time), rel=0.02)


@pytest.mark.parametrize("mode", ["rewind", *with_all("event")])
def test_a_step_in_which_gravity_moves_spheres_by_many_radii(mode):
    """g h^2 is 2.5 radii: they come to rest all the same, and none has contacts with more than those around it."""
    n, radius = 200, 0.01
    sim = Simulation(
        Scene(
            dimension=3,
            box={"lower": [0.0] * 3, "upper": [0.15, 0.15, 1.0]},
            time={"step": 0.05, "steps": 60},
            particles=[{"count": n, "position": "lattice", "radius": radius}],
            effects={
                "uniform_gravity": {"acceleration": [0.0, 0.0, -9.81]},
                "walls": {"restitution": 0.5},
                "collisions": {"mode": mode, "restitution": 0.5},
            },
        )
    )
    start = sim.measure()["total_energy"]
    most = 0
    for _ in range(60):
        sim.step()
        x = sim.particles.position
        assert x.min() >= radius * (1.0 - 1e-9) and pdist(x).min() >= 2.0 * radius * (1.0 - 1e-3)
        assert sim.measure()["total_energy"] <= start * (1.0 + 1e-9)
        most = max(most, len(sim.persistent.history.graph.other) if sim.persistent.history.graph else 0)
    assert n < most < 40 * n
    assert sim.measure()["kinetic"] < 1e-4 * start


@pytest.mark.parametrize(("seed", "friction"), [(3, 0.4), (8, 0.0)])
def test_steps_in_which_forces_move_spheres_by_more_than_their_radius(seed, friction):
    """A copy knows what contacts took, but has neither their graph nor their solution; it goes on with the same bits."""
    surface = {"restitution": 0.3, **({"friction": friction} if friction else {})}
    spheres = {"count": 90, "position": "random", "radius": {"min": 0.08, "max": 0.2}, "velocity": {"speed": 1.0}}
    sim = Simulation(
        Scene(
            dimension=2,
            seed=seed,
            box={"lower": [0, 0], "upper": [6, 6]},
            time={"step": 0.06, "steps": 15},
            particles=[spheres],
            effects={"uniform_gravity": {"acceleration": [0.3, -9.81]}, "collisions": surface, "walls": surface},
        )
    )
    for _ in range(15):
        twin = sim.copy()
        twin.step()
        sim.step()
        assert sim == twin


LIGHT, RADII = {"mass": 1e-6, "velocity": {"speed": 30.0}}, {"min": 0.03, "max": 0.1}
NARROW = {  # as far as a sphere's width and the skin of a graph reach, a pair is near through two images
    "dimension": 2,
    "seed": 945,
    "time": {"step": 0.05, "steps": 30},
    "box": {"lower": [0.0, 0.0], "upper": [0.52, 0.52], "periodic": [True, False]},
    "particles": [
        {"position": [[0.13557966246417263, 0.39757144394296273]], "radius": 0.1, **LIGHT, "acceleration": [2.09, -1.62]},
        {"position": [[0.11664369853346215, 0.12794731059901013]], "radius": RADII, **LIGHT, "acceleration": [2.78, -3.08]},
    ],
    "effects": {
        "collisions": {"mode": "event", "restitution": 0.0, "friction": 0.5, "tangential_restitution": 1.0},
        "walls": {"restitution": 0.5},
        "user_acceleration": {},
    },
}
LATTICE = {  # spheres that touch exactly; contacts that take nothing along their normals, and next to nothing across
    "dimension": 3,
    "seed": 720,
    "time": {"step": 0.05, "steps": 30},
    "box": {"lower": [0.0] * 3, "upper": [0.6] * 3, "periodic": [False, True, False]},
    "particles": [
        {"position": [[0.1, 0.3, 0.5], [0.3, 0.1, 0.1], [0.5, 0.3, 0.3], [0.1, 0.5, 0.5]], "radius": 0.1, "mass": 1e6},
        {
            "position": [[0.1, 0.1, 0.5], [0.5, 0.3, 0.1], [0.5, 0.5, 0.3], [0.5, 0.1, 0.5], [0.3, 0.5, 0.5]],
            "radius": 0.1,
            "mass": {"min": 0.1, "max": 3.0},
            "fixed": [False, False, False, True, False],
        },
    ],
    "effects": {
        "collisions": {"mode": "event", "restitution": 0.3},
        "walls": {"restitution": 0.5, "friction": 0.1},
        "uniform_gravity": {"acceleration": [0.0, 0.0, -9.81]},
    },
}


@pytest.mark.parametrize("e", [0.0, 0.5, 0.9])
def test_what_has_no_mass_comes_to_rest_on_walls_too(e):
    """A wall takes what comes, whatever that weighs."""
    ends = []
    for mass in (0.0, 1.0, 8.0):
        ball = {"position": [[0.1, 0.3]], "velocity": [0.3, 0.0], "radius": 0.1, "mass": mass}
        planes = [{"point": [0.0, 0.0], "normal": [0.0, 1.0]}, {"point": [1.0, 0.0], "normal": [-1.0, 1.0]}]
        effects = {"uniform_gravity": {"acceleration": [0.0, -10.0]}, "walls": {"restitution": e, "planes": planes}}
        sim = Simulation(Scene(dimension=2, time={"step": 0.01, "steps": 1000}, particles=[ball], effects=effects))
        sim.steps(1000)
        assert sim.particles.velocity[0, 1] == 0.0
        ends.append(sim.particles.position[0])
    assert (ends[0] == ends[1]).all() and (ends[1] == ends[2]).all()


@pytest.mark.parametrize("tables", [NARROW, LATTICE], ids=["narrow", "lattice"])
def test_a_copy_goes_on_with_the_same_bits(tables):
    sim = Simulation(Scene.from_dict(tables))
    for _ in range(tables["time"]["steps"]):
        twin = sim.copy()
        twin.step()
        sim.step()
        assert sim == twin


def line(places, mode, e, step, steps, fall, **more):
    """Discs at these places (n, 2), under gravity where they `fall`, after some steps: their velocities, and the simulation."""
    effects = {"collisions": {"mode": mode, "restitution": e}}
    if fall:
        effects["uniform_gravity"] = {"acceleration": [0.0, -9.81]}
        effects["walls"] = {
            "restitution": e,
            "planes": [{"point": [0.0, -100.0 if "velocity" in more else 0.0], "normal": [0, 1]}],
        }
    particles = [{"position": places, "radius": 0.1, **more}]
    sim = Simulation(Scene(dimension=2, time={"step": step, "steps": steps}, particles=particles, effects=effects))
    sim.run()
    return sim.particles.velocity.copy()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("n", "e"), [(5, 0.5), (8, 0.7), (12, 0.7), (15, 0.9)])
def test_a_row_that_falls_freely_is_hit_as_without_gravity(n, e, mode):
    """Discs that touch, and one that hits them from the side: to fall with them changes nothing."""
    places = [[-0.6, 0.0], *([0.2 * k, 0.0] for k in range(n))]
    velocity = [[3.0, 0.0]] + [[0.0, 0.0]] * n
    still, falling = (line(places, mode, e, 0.005, 100, fall, velocity=velocity) for fall in (False, True))
    assert np.abs(falling[:, 0] - still[:, 0]).max() < 1e-6
    assert np.abs(falling[:, 1] + 9.81 * 0.5).max() < 1e-6


def hit_by_hit(y, mass, e, end):
    """Velocities (n,) at a time of balls of radius 0.1 on a line above a floor, which fall from rest at heights y (n,).

    All fall alike, so from one hit to the next the gaps between balls change evenly. Balls whose hits follow one another without
    end in the last 1e-12 of the floor end the search: what has left them by then goes on by itself.
    """
    y, v, mass, t, g = np.array(y), np.zeros(len(y)), np.array(mass, float), 0.0, 9.81
    for _ in range(1000):  # ten thousand give the same to the bit
        gaps, approach = np.maximum(np.diff(y) - 0.2, 0.0), v[:-1] - v[1:]
        pairs = np.where(approach > 1e-12, gaps / np.where(approach > 1e-12, approach, 1.0), np.inf)
        root = np.sqrt(v[0] ** 2 + 2.0 * g * max(y[0] - 0.1, 0.0))
        floor = (v[0] + root) / g
        k, wait = int(pairs.argmin()), min(pairs.min(), floor)
        if t + wait > end:
            break
        t, y, v = t + wait, y + v * wait - 0.5 * g * wait**2, v - g * wait
        if floor <= pairs.min():
            v[0] *= -e
        else:
            change = (1.0 + e) * (v[k] - v[k + 1]) / (mass[k] + mass[k + 1])
            v[k], v[k + 1] = v[k] - change * mass[k + 1], v[k + 1] + change * mass[k]
    return v - g * (end - t)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("step", [0.02, 0.005, *with_all(0.0005)])
@pytest.mark.parametrize(
    ("mass", "e", "gap"),
    [([16, 8, 4, 2, 1], 0.5, 1e-9), ([32, 16, 8, 4, 2, 1], 0.5, 1e-9), ([1] * 5, 0.7, 1e-7), ([1] * 5, 0.8, 1e-9)],
)
def test_the_uppermost_of_balls_that_fall_together_leaves_as_hit_by_hit(mass, e, gap, step, mode):
    """Its speed is that of the exact order of hits, at any step; below it some rattle on the floor without end."""
    places = [0.9 + (0.2 + gap) * k for k in range(len(mass))]
    found = line([[0.0, y] for y in places], mode, e, step, round(0.42 / step), True, mass=mass)
    assert found[-1, 1] == pytest.approx(hit_by_hit(places, mass, e, 0.42)[-1], abs=5e-3)
