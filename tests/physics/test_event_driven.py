"""Mode event against what is known exactly, and against `rewind`."""

from itertools import pairwise

import numpy as np
import pytest
from with_all import with_all

from particles_mpi import Scene, Simulation, StoppedError


def scene(d, particles, step, steps=1, box=None, **effects):
    effects.setdefault("collisions", {})
    effects["collisions"] = {"mode": "event", **effects["collisions"]}
    tables = {"dimension": d, "seed": 1, "time": {"step": step, "steps": steps}, "particles": particles, "effects": effects}
    return Scene.from_dict(tables | ({"box": box} if box else {}))


def by_id(sim):
    order = np.argsort(sim.particles.id)
    return sim.particles.position[order], sim.particles.velocity[order]


@pytest.mark.parametrize(("k", "hits"), [(0, 3), (1, 31), (2, 314), (3, 3141), (4, 31415), (5, 314159)])
@pytest.mark.parametrize("steps", [1, 7])
def test_galperin_counts_the_digits_of_pi(k, hits, steps):
    """G. Galperin, Regul. Chaotic Dyn. 8, 375 (2003): a wall, a point of mass 1, and one of mass 100^k that comes in."""
    pair = [
        {"position": [[1.0]], "velocity": [0.0], "radius": 0.0, "mass": 1.0},
        {"position": [[2.0]], "velocity": [-1.0], "radius": 0.0, "mass": 100.0**k},
    ]
    sim = Simulation(scene(1, pair, 20.0 / steps, steps, walls={"planes": [{"point": [0.0], "normal": [1.0]}]}))
    sim.run()
    assert sim.totals["collisions"] + sim.totals["wall_hits"] == hits
    assert sim.totals["missed"] == 0


@pytest.mark.parametrize("count", [100, 1000])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_rods_on_a_line(count, seed):
    """y_i = x_i - i sigma: the state is sort(y + v t), the number of collisions that of inversions."""
    random = np.random.default_rng(seed)
    sigma, t = 0.3, 2.0
    y, v = np.sort(random.random(count)) * count, random.standard_normal(count)
    x = y + sigma * np.arange(count)
    rods = [{"position": x[:, None].tolist(), "velocity": v[:, None].tolist(), "radius": sigma / 2, "mass": 1.0}]
    sim = Simulation(scene(1, rods, t / 4, 4))
    sim.run()
    then = y + v * t
    inversions = int(np.triu(then[:, None] > then[None], 1).sum())
    assert sim.totals["collisions"] == inversions
    np.testing.assert_allclose(np.sort(by_id(sim)[0][:, 0] - sigma * np.arange(count)), np.sort(then), atol=1e-11)


def test_newtons_cradle():
    """Five touching spheres: one in, one out."""
    x = [[-3.0, 0.0, 0.0], *[[float(k), 0.0, 0.0] for k in range(4)]]
    v = [[1.0, 0.0, 0.0]] + [[0.0] * 3] * 4
    sim = Simulation(scene(3, [{"position": x, "velocity": v, "radius": 0.5, "mass": 1.0}], 5.0))
    sim.run()
    position, velocity = by_id(sim)
    expected = np.zeros((5, 3))
    expected[4, 0] = 1.0
    np.testing.assert_allclose(velocity, expected, atol=1e-12)
    np.testing.assert_allclose(position[:, 0], [-1.0, 0.0, 1.0, 2.0, 6.0], atol=1e-12)


@pytest.mark.parametrize("step", [0.013, 0.5, 7.0])
@pytest.mark.parametrize("b", [0.0, 0.3, 0.5, 0.9])
def test_oblique_pair_at_any_step(step, b):
    """Equal spheres, one at rest, impact parameter b of diameter 1: deflected along and across the line of centres."""
    pair = [
        {"position": [[-3.0, b, 0.0]], "velocity": [1.0, 0.0, 0.0], "radius": 0.5, "mass": 1.0},
        {"position": [[0.0, 0.0, 0.0]], "velocity": [0.0, 0.0, 0.0], "radius": 0.5, "mass": 1.0},
    ]
    sim = Simulation(scene(3, pair, step, int(np.ceil(7.0 / step))))
    sim.run()
    n = np.array([np.sqrt(1.0 - b * b), -b, 0.0])
    _, v = by_id(sim)
    np.testing.assert_allclose(v[1], n[0] * n, atol=1e-12)
    np.testing.assert_allclose(v[0], [1.0, 0.0, 0.0] - n[0] * n, atol=1e-12)


@pytest.mark.slow
def test_sinai_billiard_mean_path():
    """Unit periodic box, fixed disc R = 0.25: (1 - pi R^2)/(2 R) between hits (reference/README.md: 1.607301).

    Flights along the corridors are long, so a mean over 3e5 has a standard error of 0.5 %: eight points, in long steps.
    """
    angle = 1.0 + 0.1 * np.arange(8)
    tables = [
        {"position": [[0.5, 0.5]], "radius": 0.25, "mass": 1.0, "fixed": True},
        {
            "position": [[0.05, 0.1]] * 8,
            "velocity": np.column_stack((np.cos(angle), np.sin(angle))).tolist(),
            "radius": 0.0,
            "mass": 1.0,
        },
    ]
    box = {"lower": [0.0, 0.0], "upper": [1.0, 1.0], "periodic": True}
    sim = Simulation(scene(2, tables, 1000.0, 300, box))
    sim.run()
    assert 8 * 300_000.0 / sim.totals["collisions"] == pytest.approx(1.607301, rel=0.005)


def test_a_bullet_hits_what_is_in_its_way():
    """100 diameters in a step, against a row of spheres and a thin wall."""
    tables = [
        {"position": [[0.0, 0.0]], "velocity": [1000.0, 0.0], "radius": 0.05, "mass": 1.0},
        {"position": [[3.0, 0.0]], "velocity": [0.0, 0.0], "radius": 0.05, "mass": 1.0},
    ]
    walls = {"planes": [{"point": [5.0, 0.0], "normal": [-1.0, 0.0]}]}
    sim = Simulation(scene(2, tables, 0.01, walls=walls))
    sim.run()
    x, v = by_id(sim)
    assert sim.totals["collisions"] == 2 and sim.totals["wall_hits"] == 1
    # contact at 2.9, the other one goes to 4.95 and comes back to 3, the first goes on with what is left of 10
    np.testing.assert_allclose(x[:, 0], [-0.3, 3.0], atol=1e-9)
    np.testing.assert_allclose(v[:, 0], [-1000.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("given", [{}, {"contact_duration": 5e-5}])
@pytest.mark.parametrize(("beads", "restitution"), [(3, 0.05), (4, 0.1)])
def test_inelastic_collapse_does_not_stop_the_clock(beads, restitution, given):
    """Below e = 7 - 4 sqrt(3) = 0.0718 three beads collapse (McNamara and Young, Phys. Fluids A 4, 496, 1992).

    They lose all of their energy, unless contacts have a duration: then the last ones take none, and it is told.
    """
    x = np.arange(beads) * 1.5
    v = np.linspace(1.0, -1.0, beads)
    tables = [{"position": x[:, None].tolist(), "velocity": v[:, None].tolist(), "radius": 0.5, "mass": 1.0}]
    sim = Simulation(scene(1, tables, 0.5, 8, collisions={"restitution": restitution} | given))
    energy = [sim.measure()["kinetic"]]
    for _ in range(8):
        sim.step()
        energy.append(sim.measure()["kinetic"])
    x, v = by_id(sim)
    assert sim.steps_done == 8 and np.isfinite(x).all()
    assert all(b <= a * (1.0 + 1e-12) for a, b in pairwise(energy))
    assert (np.diff(x[:, 0]) > 1.0 - 1e-9).all()
    assert abs(v.sum()) < 1e-12
    if given:
        (remark,) = sim.remarks()
        assert "inelastic collapse" in remark and "particles " + ", ".join(map(str, range(beads))) in remark
    else:
        assert energy[-1] < 1e-20


@pytest.mark.parametrize("mode", ["event", "rewind"])
@pytest.mark.parametrize("gap", [0.0, 0.3])
@pytest.mark.parametrize("waiting", [1, 2, 3, 4, 6, 10])
def test_what_sticks_together_goes_on_with_the_mean_velocity(waiting, gap, mode):
    """A train: e = 0, each car pushes the next one; and their centre of mass is where momentum brings it."""
    x = np.append(-1.5, (1.0 + gap) * np.arange(waiting))
    v = np.append(1.0, np.zeros(waiting))
    tables = [{"position": x[:, None].tolist(), "velocity": v[:, None].tolist(), "radius": 0.5}]
    duration = 2.0 + 1.2 * gap * waiting**2
    sim = Simulation(scene(1, tables, duration / 100, 100, collisions={"restitution": 0.0, "mode": mode}))
    sim.run()
    place, velocity = by_id(sim)
    assert velocity[:, 0] == pytest.approx(np.full(len(x), v.mean()), abs=1e-12)
    assert place.mean() - x.mean() == pytest.approx(v.mean() * duration, abs=1e-12)
    assert np.diff(place[:, 0]) == pytest.approx(np.ones(waiting), abs=1e-9)
    assert sim.totals["missed"] == 0


@pytest.mark.parametrize("mode", ["event", "rewind"])
@pytest.mark.parametrize(
    ("places", "losses"), [([0, 2, 3], (0.0, 0.1, 0.5, 0.95)), ([0, 2, 3, 4, 5], (0.5, 0.95)), ([0, 2, 4], (0.0,))]
)
@pytest.mark.parametrize("forces", [{}, {"user_acceleration": {}}])
def test_what_touches_several_others_loses_energy_at_all_of_them(places, losses, mode, forces):
    """Newton's cradle: contacts at one moment, one after the other, until nobody approaches anybody, with forces of 0 too."""
    for e in losses:
        cradle(places, e, mode, forces)


def cradle(places, e, mode, forces):
    """The first sphere comes with a speed of 1 to others that are at rest."""
    v = np.zeros(len(places))
    v[0] = 1.0
    while (approaching := np.flatnonzero(v[:-1] - v[1:] > 1e-15)).size:
        k = approaching[0]
        v[k], v[k + 1] = 0.5 * ((1.0 - e) * v[k] + (1.0 + e) * v[k + 1]), 0.5 * ((1.0 + e) * v[k] + (1.0 - e) * v[k + 1])
    tables = [{"position": [[x] for x in places], "velocity": [[float(k == 0)] for k in range(len(places))], "radius": 0.5}]
    sim = Simulation(scene(1, tables, 0.01, 500, collisions={"restitution": e, "mode": mode}, **forces))
    sim.run()
    assert by_id(sim)[1][:, 0] == pytest.approx(v, abs=1e-12)
    assert sim.totals["missed"] == 0


@pytest.mark.parametrize("mode", ["event", "rewind"])
@pytest.mark.parametrize(("e", "below"), [(0.0, 3), (0.5, 1), *with_all((0.0, 1), (0.3, 1), (0.5, 2))])
def test_what_falls_onto_what_lies_on_a_floor(e, below, mode):
    """All contacts of a column follow one another at once: ball after ball, floor, and back, each with the loss that it has."""
    h, fall = 1e-4, 1.0
    v = np.zeros(below + 1)
    v[-1] = -1.0  # of what falls, the last one
    for _ in range(100):
        v[0] = max(v[0], -e * v[0])
        closing = v[:-1] - v[1:]
        k = np.argmax(closing)
        if closing[k] <= 1e-6 and v[0] >= 0.0:
            break
        if closing[k] > 0.0:
            v[k], v[k + 1] = v[k] - 0.5 * (1.0 + e) * closing[k], v[k + 1] + 0.5 * (1.0 + e) * closing[k]
    places = [[0.5 + k] for k in range(below)] + [[0.5 + below + fall]]
    walls = {"restitution": e, "planes": [{"point": [0.0], "normal": [1.0]}]}
    effects = {"collisions": {"restitution": e, "mode": mode}, "walls": walls, "uniform_gravity": {"acceleration": [-9.81]}}
    sim = Simulation(scene(1, [{"position": places, "velocity": [0.0], "radius": 0.5}], h, 1, **effects))
    speed = np.sqrt(2.0 * 9.81 * fall)
    sim.steps(int(np.ceil(speed / 9.81 / h)) + 2)
    assert by_id(sim)[1][-1, 0] / speed == pytest.approx(v[-1], abs=0.01)
    assert sim.totals["missed"] == 0


@pytest.mark.parametrize("mode", ["event", "rewind"])
@pytest.mark.parametrize("loss", [{"restitution": 0.5}, {"damping": 0.19}])
@pytest.mark.parametrize("apart", [0.0, 1e-7])
@pytest.mark.parametrize("d", [2, 3, *with_all(4)])
@pytest.mark.parametrize("forces", [{}, {"user_acceleration": {}}])
def test_a_corner_takes_what_each_of_its_walls_takes(d, apart, loss, mode, forces):
    """Each component of the velocity is turned by one wall; the course's damping takes its part of all of it at each."""
    part = loss.get("restitution", (1.0 - 0.19) ** (0.5 * d) if "damping" in loss else 1.0)
    tables = [{"position": [[1.0 + k * apart for k in range(d)]], "velocity": [[-1.0] * d], "radius": 0.2}]
    box = {"lower": [0.0] * d, "upper": [3.0] * d}
    sim = Simulation(scene(d, tables, 0.1, 15, box, collisions={"mode": mode}, walls=loss, **forces))
    sim.run()
    assert by_id(sim)[1][0] == pytest.approx(part, abs=1e-12) and sim.totals["wall_hits"] == d


@pytest.mark.parametrize("step", [1.0, 0.01])
@pytest.mark.parametrize(("heavy", "light", "e"), [(100.0, 0.1, 0.9), (10.0, 0.1, 0.5), (10.0, 0.01, 0.8)])
def test_a_light_one_between_heavy_ones_brings_both_to_rest(heavy, light, e, step):
    """Inelastic collapse of a symmetric three: all of the energy is lost in the end, in up to a thousand hits."""
    tables = [
        {"position": [[0.0], [1.0], [2.0]], "velocity": [[1.0], [0.0], [-1.0]], "radius": 0.1, "mass": [heavy, light, heavy]}
    ]
    sim = Simulation(scene(1, tables, step, round(3.0 / step), collisions={"restitution": e}))
    sim.run()
    assert sim.measure()["kinetic"] < 1e-7 * heavy and sim.totals["missed"] == 0


@pytest.mark.parametrize("steps", [1, 100])
def test_a_light_one_between_a_wall_and_a_heavy_one(steps):
    """363 hits with e = 0.99, of masses 1e-4 and 1, against the same computed hit by hit."""
    e, m, x, v, t, hits = 0.99, (1e-4, 1.0), [0.5, 1.0], [0.0, -1.0], 0.0, 0
    while True:
        wall = -x[0] / v[0] if v[0] < 0.0 else np.inf
        pair = (x[1] - x[0]) / (v[0] - v[1]) if v[0] > v[1] else np.inf
        t += (after := min(wall, pair))
        if t > 3.0:
            break
        hits += 1
        x = [x[0] + v[0] * after, x[1] + v[1] * after]
        if wall < pair:
            v[0] *= -e
        else:
            impulse = (1.0 + e) * (v[0] - v[1]) / (1.0 / m[0] + 1.0 / m[1])
            v = [v[0] - impulse / m[0], v[1] + impulse / m[1]]
    tables = [{"position": [[0.5], [1.0]], "velocity": [[0.0], [-1.0]], "mass": list(m), "radius": 0.0}]
    walls = {"restitution": e, "planes": [{"point": [0.0], "normal": [1.0]}]}
    sim = Simulation(scene(1, tables, 3.0 / steps, steps, collisions={"restitution": e}, walls=walls))
    sim.run()
    assert sim.totals["collisions"] + sim.totals["wall_hits"] == hits > 200
    assert by_id(sim)[1][:, 0] == pytest.approx(v, rel=1e-9)


@pytest.mark.parametrize("mode", [None, "event", "rewind"])
@pytest.mark.parametrize("degrees", [10, 20, 30])
def test_a_wedge_that_takes_everything(degrees, mode):
    """With e = 0 a ball that runs into it comes to rest: each pair of hits leaves cos^2 of the angle."""
    angle = np.radians(degrees)
    planes = [{"point": [0.0, 0.0], "normal": [0.0, 1.0]}, {"point": [3.5, 0.0], "normal": [-np.sin(angle), -np.cos(angle)]}]
    effects = {"walls": {"restitution": 0.0, "planes": planes}} | ({"collisions": {"mode": mode}} if mode else {})
    tables = {"dimension": 2, "time": {"step": 0.01, "steps": 300}, "effects": effects}
    sim = Simulation(Scene.from_dict(tables | {"particles": [{"position": [[1.0, 0.1]], "velocity": [1.0, 0.0], "radius": 0.1}]}))
    sim.run()
    assert np.abs(sim.particles.velocity).max() < 1e-5


@pytest.mark.parametrize("mode", ["rewind", *with_all("event")])
def test_a_pile_that_loses_energy_on_walls_that_take_none_wins_none(mode):
    """What has no room under forces stands: else it would win the speed of a fall that does not take place, step by step."""
    random = np.random.default_rng(1)
    grid = [[0.06 + 0.11 * (k % 10), 0.06 + 0.11 * (k // 10)] for k in range(60)]
    tables = [{"position": grid, "velocity": random.normal(0.0, 0.3, (60, 2)).tolist(), "radius": 0.05}]
    box = {"lower": [0.0, 0.0], "upper": [1.2, 1.2]}
    effects = {"collisions": {"restitution": 0.5, "mode": mode}, "walls": {}, "uniform_gravity": {"acceleration": [0.0, -9.8]}}
    sim, before = Simulation(scene(2, tables, 0.0025, 300, box, **effects)), np.inf
    for _ in range(6):
        sim.steps(50)
        energy = sim.measure()["total_energy"]
        assert energy < before + 1e-3 * 140.0
        before = energy
    assert sim.measure()["kinetic"] < 0.01


def test_the_length_of_a_step_changes_no_loss():
    """Without forces: however many contacts of a gas fall into one step."""
    side = (500 / 0.7) ** (1 / 3)
    box = {"lower": [0.0] * 3, "upper": [side] * 3, "periodic": True}
    tables, found = [{"count": 500, "position": "lattice", "velocity": {"temperature": 1.0}, "radius": 0.5}], []
    for step in (0.02, 0.5, 1.0):
        sim = Simulation(scene(3, tables, step, round(1.0 / step), box, collisions={"restitution": 0.9}))
        sim.run()
        found.append((sim.totals["collisions"], sim.measure()["kinetic"]))
    assert found[0][0] > 3000 and len({collisions for collisions, _ in found}) == 1
    assert [kinetic for _, kinetic in found] == pytest.approx([found[0][1]] * 3, rel=1e-9)


@pytest.mark.parametrize(("density", "z"), [(0.2, 1.55361), (0.5, 3.26941), (0.7, 5.72696), (0.9, 10.76274)])
def test_pressure_of_the_hard_sphere_fluid(density, z):
    """Kolafa, Labik, Malijevsky (Phys. Chem. Chem. Phys. 6, 2335, 2004), by the rate of collisions and by the virial."""
    n = 4000
    side = (n / density) ** (1 / 3)
    tables = [{"count": n, "position": "lattice", "velocity": {"temperature": 1.0}, "radius": 0.5, "mass": 1.0}]
    box = {"lower": [0.0] * 3, "upper": [side] * 3, "periodic": True}
    rate = 6.0 * (z - 1.0) / np.sqrt(np.pi)  # collisions a particle and unit of time
    step = 20.0 / rate
    sim = Simulation(scene(3, tables, step, 12, box))
    for _ in range(4):
        sim.step()
    before, start = sim.totals["collisions"], sim.time
    while sim.steps_done < 12:
        sim.step()
    measured = 2.0 * (sim.totals["collisions"] - before) / n / (sim.time - start)
    temperature = n / (n - 1)  # of 3 (N - 1) degrees of freedom
    assert 1.0 + measured * np.sqrt(np.pi / temperature) / 6.0 == pytest.approx(z, rel=0.003)


def crowd(d, periodic, **collisions):
    """Spheres of many sizes, two giants, points and fixed ones among them; oblique wall, gravity, drag."""
    side = {2: 6.0, 3: 3.6, 4: 3.0}[d]
    box = {"lower": [0.0] * d, "upper": [side] * d, "periodic": [True] + [periodic] * (d - 1)}
    count = {2: 120, 3: 300, 4: 300}[d]
    tables = [
        {"count": 2, "position": "random", "velocity": {"speed": 0.5}, "radius": 0.7, "mass": 40.0},
        {"count": count, "position": "random", "velocity": {"speed": 1.0}, "radius": {"min": 0.02, "max": 0.12}, "mass": 0.3},
        {"count": 20, "position": "random", "velocity": {"speed": 2.0}, "radius": 0.0, "mass": 0.1},
        {"count": 5, "position": "random", "radius": 0.2, "mass": 1.0, "fixed": True},
    ]
    effects = {"drag": {"rate": 0.05}, "collisions": collisions}
    if not periodic:
        effects |= {"walls": {"restitution": 0.9}, "uniform_gravity": {"acceleration": [0.0] * (d - 1) + [-1.0]}}
    return scene(d, tables, 0.05, 60, box, **effects)


def overlaps(x, radius, length):
    r = x[:, None] - x[None]
    r -= np.where(length > 0.0, length * np.rint(r / np.where(length > 0.0, length, 1.0)), 0.0)
    depth = radius[:, None] + radius[None] - np.sqrt((r**2).sum(axis=2))
    np.fill_diagonal(depth, -1.0)
    return np.where((radius[:, None] > 0.0) | (radius[None] > 0.0), depth, -1.0).max()


@pytest.mark.parametrize(("d", "periodic"), [(2, True), (2, False), (3, True), (3, False), *with_all((4, True), (4, False))])
def test_nothing_ever_overlaps(d, periodic):
    """Every contact is found: whatever the sizes, walls and images; after 3 units of time nobody is in anybody."""
    sim = Simulation(crowd(d, periodic, restitution=0.9))
    for _ in range(6):
        for _ in range(10):
            sim.step()
        p = sim.particles
        assert overlaps(p.position, p.radius, sim.length) < 1e-9
    assert sim.totals["collisions"] > 50
    assert sim.totals["missed"] == 0


def in_a_narrow_box(edge, steps):
    """Two discs of radius 0.24 that fly about in a periodic square, for two time units."""
    discs = {"position": [[0.2, 0.2], [0.2, 0.6806]], "velocity": [[1.0, 0.3], [-0.2, -0.7]], "radius": 0.24}
    box = {"lower": [0.0, 0.0], "upper": [edge, edge], "periodic": True}
    return Scene(
        dimension=2,
        box=box,
        time={"step": 2.0 / steps, "steps": steps},
        particles=[discs],
        effects={"collisions": {"mode": "event"}},
    )


def test_a_periodic_box_may_be_barely_longer_than_two_contact_distances():
    """0.96: nothing overlaps, in any image; steps leave no trace; and what is too narrow is refused."""
    coarse, fine = (Simulation(in_a_narrow_box(0.9612, steps)) for steps in (4, 400))
    coarse.run()
    for _ in range(400):
        fine.step()
        apart = np.subtract(*fine.particles.position)
        apart -= 0.9612 * np.rint(apart / 0.9612)
        assert np.sqrt(apart @ apart) >= 0.48 * (1.0 - 1e-12)
    assert coarse.totals["collisions"] == fine.totals["collisions"] > 10
    assert np.abs(coarse.particles.position - fine.particles.position).max() < 1e-6
    with pytest.raises(ValueError, match=r"1\.001 times two contact distances, 0\.96096"):
        Simulation(in_a_narrow_box(0.9605, 4))


def test_skins_leave_no_trace_in_the_bits():
    """Neighbours found with other skins, at other times: the same bits."""
    final = []
    for width in (None, 0.01, 0.5):
        sim = Simulation(crowd(3, False, restitution=0.8))
        if width:
            lists = sim.near.whole.engine.lists
            lists.width = width
            lists.tune = lambda x, radius, w, *_, build=lists.build: build(x, radius, w)
        sim.run()
        final.append(by_id(sim))
    for x, v in final[1:]:
        assert (x == final[0][0]).all() and (v == final[0][1]).all()


def test_energy_and_momentum_of_many_collisions():
    """Elastic, periodic: the energy to 1e-11 of itself, momentum to round-off."""
    n, side = 500, (500 / 0.7) ** (1 / 3)
    tables = [{"count": n, "position": "lattice", "velocity": {"temperature": 1.0}, "radius": 0.5, "mass": 1.0}]
    box = {"lower": [0.0] * 3, "upper": [side] * 3, "periodic": True}
    sim = Simulation(scene(3, tables, 1.0, 100, box))
    before = sim.measure()
    while sim.totals["collisions"] < 1_000_000:
        sim.step()
    after = sim.measure()
    assert after["kinetic"] == pytest.approx(before["kinetic"], rel=1e-12)
    assert max(abs(after[f"momentum_{k}"]) for k in "xyz") < 1e-10


def test_rewind_converges_to_the_order_of_events():
    """One dense scene in both modes: what rewind gets wrong shrinks with the step."""
    errors = []
    for step in (0.04, 0.01, 0.0025):
        n, side = 400, (400 / 0.7) ** (1 / 3)
        tables = [{"count": n, "position": "lattice", "velocity": {"temperature": 1.0}, "radius": 0.5, "mass": 1.0}]
        box = {"lower": [0.0] * 3, "upper": [side] * 3, "periodic": True}
        states = []
        for collisions in ({"mode": "event"}, {"mode": "rewind", "passes": 100}):
            sim = Simulation(scene(3, tables, step, round(0.12 / step), box, collisions=collisions))
            sim.run()
            states.append(by_id(sim)[0])
        r = states[0] - states[1]
        r -= side * np.rint(r / side)
        errors.append(np.count_nonzero((r**2).sum(axis=1) > 1e-16))
    assert errors[0] > 2 * errors[1] > 4 * errors[2], errors


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
def test_what_is_not_a_number_is_named(value):
    sim = Simulation(crowd(2, True))
    sim.step()
    sim.particles.velocity[sim.particles.id == 7, 1] = value
    with pytest.raises(StoppedError, match="particle 7 "):
        sim.step()


@pytest.mark.parametrize("count", [0, 1])
def test_a_single_ball_and_none(count):
    """Alone between two walls, gap 8: 10 units of path are one hit and the way back."""
    ball = [{"position": [[5.0]], "velocity": [1.0], "radius": 1.0, "mass": 1.0}]
    if not count:
        ball = [{"count": 0, "position": "random", "radius": 1.0}]
    sim = Simulation(scene(1, ball, 5.0, 2, {"lower": [0.0], "upper": [10.0]}, walls={}))
    sim.run()
    assert len(sim.particles) == count and sim.totals["wall_hits"] == count
    np.testing.assert_allclose(by_id(sim)[0][:, 0], [3.0] * count, atol=1e-12)
