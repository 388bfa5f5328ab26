"""Particles without a radius: they pass one another, wherever they lie, and a simulation may have none at all."""

from itertools import product

import numpy as np
import pytest
from with_all import with_all

from particles_mpi import Scene, Simulation

MODES = ["rewind", "event"]
SIDE = 4.0
PLACES = {  # which axes the points are spread over
    "at one place": 0,
    "on a line": 1,
    "in a plane": 2,
}


@pytest.mark.timeout(60)  # lists of neighbours with no width expired without end
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("walls", [False, True])
@pytest.mark.parametrize("count", [1, 2, 50])
@pytest.mark.parametrize(("d", "spread"), [(d, spread) for d, spread in product([1, 2, 3], PLACES) if PLACES[spread] < d])
def test_points_of_no_volume_fly_straight(d, spread, count, walls, mode):
    random = np.random.default_rng(4)
    x, v = np.full((count, d), 2.0), random.uniform(-1.0, 1.0, (count, d))
    axes = PLACES[spread]
    x[:, :axes] = random.uniform(1.5, 2.5, (count, axes))
    if d == 1 and mode == "event":  # there they would meet
        v = np.sort(v, axis=0) if axes else np.ones_like(v)
        x = np.sort(x, axis=0)
    more = {"box": {"lower": [0.0] * d, "upper": [SIDE] * d}} if walls else {}
    effects = {"collisions": {"mode": mode}} | ({"walls": {}} if walls else {})
    points = {"position": x.tolist(), "velocity": v.tolist()}
    sim = Simulation(Scene(dimension=d, time={"step": 0.05, "steps": 10}, particles=[points], effects=effects, **more))
    sim.steps(10)
    ids = sim.particles.id
    assert np.abs(sim.particles.position - (x + 0.5 * v)[ids]).max() < 1e-14
    assert (sim.particles.velocity == v[ids]).all() and sim.totals["collisions"] == 0


@pytest.mark.parametrize(
    ("restitution", "radius", "count", "told"),
    [(0.0, 0.0, 3, True), (0.3, [0.01, 0.0, 0.0], 3, True), (1.0, 0.0, 3, False), (0.0, 0.01, 3, False), (0.0, 0.0, 2, False)],
)
def test_points_that_may_stick_together_are_told_of(restitution, radius, count, told):
    """A third one passes through two at one place; spheres, however small, take it along."""
    row = {"position": [[0.0], [1.0], [3.0]][:count], "velocity": [[1.0], [-1.0], [-1.0]][:count], "radius": radius}
    effects = {"collisions": {"mode": "event", "restitution": restitution}}
    sim = Simulation(Scene(dimension=1, time={"step": 0.1, "steps": 40}, effects=effects, particles=[row]))
    assert any("let a third one pass" in line for line in sim.warnings) == told
    sim.run()
    if radius == 0.01:
        assert sim.particles.velocity.ravel() == pytest.approx([-1.0 / 3.0] * 3, abs=1e-12)


@pytest.mark.parametrize(("d", "mode", "told"), [(1, "rewind", "on a line they do"), (2, "event", ""), (1, "event", None)])
def test_points_that_meet_no_others_are_told_of(d, mode, told):
    row = {"position": [[0.0] * d, [1.0] * d], "velocity": [1.0] * d}
    sim = Simulation(Scene(dimension=d, time={"step": 0.1, "steps": 1}, effects={"collisions": {"mode": mode}}, particles=[row]))
    said = [line for line in sim.warnings if "never with one another" in line]
    assert len(said) == (told is not None) and all(("on a line" in line) == bool(told) for line in said)
    assert all(told in line for line in said)


@pytest.mark.parametrize("at_once", [True, False])
@pytest.mark.parametrize("count", [2, 3, 20])
def test_points_on_a_line_stay_in_their_order(count, at_once):
    """However near they are at the start, and however far they get in a step; half of them at the same speed to and fro."""
    random = np.random.default_rng(count)
    for number in range(40):
        x = random.uniform(-20.0, 20.0) + np.sort(random.uniform(0.0, 10.0 ** random.uniform(-4.0, 0.0), count))
        v = random.uniform(1.0, 9.0) * ((-1.0) ** np.arange(count) if number % 2 else random.uniform(-1.0, 1.0, count))
        mass = random.uniform(0.1, 3.0, count)
        points = {"position": x[:, None].tolist(), "velocity": v[:, None].tolist(), "mass": mass.tolist()}
        effects = {"collisions": {"mode": "event"}}
        sim = Simulation(Scene(dimension=1, time={"step": 0.1, "steps": 3}, effects=effects, particles=[points]))
        sim.many_steps = sim.many_steps if at_once else None
        sim.steps(3)
        order = np.argsort(sim.particles.id)
        later, velocity = sim.particles.position[order, 0], sim.particles.velocity[order, 0]
        assert (np.diff(later) > -1e-13).all(), f"start {number}"
        assert (mass * velocity).sum() == pytest.approx((mass * v).sum(), abs=1e-12)
        assert (mass * velocity**2).sum() == pytest.approx((mass * v**2).sum(), rel=1e-12)


@pytest.mark.parametrize("radius", [0.0, 1e-18])
def test_points_that_meet_at_the_end_of_a_step_stay_in_their_order(radius):
    """There they are at one place but for round-off; steps of a length after so many of which the first two of all meet."""
    effects = {"collisions": {"mode": "event"}}
    for number in range(120):
        random = np.random.default_rng(number)
        count = 2 + number % 6
        x, v = np.sort(random.uniform(-1.0, 1.0, count)), random.standard_normal(count)
        points = {
            "position": x[:, None].tolist(),
            "velocity": v[:, None].tolist(),
            "mass": random.uniform(0.5, 2.0, count).tolist(),
        }
        nearing = v[:-1] - v[1:]
        if not (nearing > 0.0).any():
            continue
        step = (np.diff(x)[nearing > 0.0] / nearing[nearing > 0.0]).min() / (1 + number % 7)
        time = {"step": step, "steps": 60}
        sim = Simulation(Scene(dimension=1, time=time, effects=effects, particles=[points | {"radius": radius}]))
        sim.steps(60)
        assert (np.diff(sim.particles.position[np.argsort(sim.particles.id), 0]) > -1e-12).all(), f"start {number}"
        one, other = (Simulation(Scene(dimension=1, time=time, effects=effects, particles=[points])) for _ in range(2))
        one.h = 1.0
        one.step()
        other.h = 1.0
        while other.step_to_collision():
            other.h = 1.0 - other.time
        ends = [np.sort(sim.particles.position[:, 0]) for sim in (one, other)]
        assert np.abs(ends[0] - ends[1]).max() < 1e-9, f"start {number}"


def test_points_that_meet_at_the_end_of_a_step_across_a_border_bounce_once():
    """In a periodic box: as in one step of the same length."""
    for number in (10, 40, 48, 74, 135):
        random = np.random.default_rng(number)
        count = 2 + number % 4
        x, v = np.sort(random.uniform(0.0, 1.0, count)), random.standard_normal(count)
        nearing = v - np.roll(v, -1)
        gaps = np.append(np.diff(x), 1.0 + x[0] - x[-1])
        step = (gaps[nearing > 0.0] / nearing[nearing > 0.0]).min() / (1 + number % 5)
        points = {"position": x[:, None].tolist(), "velocity": v[:, None].tolist()}
        box = {"lower": [0.0], "upper": [1.0], "periodic": True}
        ends = []
        for steps in (40, 1):
            time = {"step": 40 * step / steps, "steps": steps}
            scene = Scene(dimension=1, box=box, time=time, effects={"collisions": {"mode": "event"}}, particles=[points])
            sim = Simulation(scene)
            sim.steps(steps)
            ends.append(sim.particles.position[np.argsort(sim.particles.id), 0])
        apart = ends[0] - ends[1]
        assert np.abs(apart - np.rint(apart)).max() < 1e-9, f"start {number}"


def test_a_fixed_point_stays_where_it_is():
    points = {"position": [[0.123], [0.711], [0.345678]], "velocity": [[-0.7], [0.9], [0.0]], "fixed": [False, False, True]}
    box = {"lower": [0.0], "upper": [1.0]}
    effects = {"collisions": {"mode": "event"}, "walls": {}}
    sim = Simulation(Scene(dimension=1, box=box, time={"step": 0.37, "steps": 300}, effects=effects, particles=[points]))
    for _ in range(300):
        sim.step()
        assert sim.particles.position[sim.particles.id == 2, 0] == 0.345678
    assert sim.totals["collisions"] > 100


@pytest.mark.parametrize("restitution", [0.0, 0.3, 1.0, *with_all(0.99)])
@pytest.mark.parametrize("attract", [True, False])
def test_points_on_a_line_go_on_the_same_from_any_step(attract, restitution):
    """Those that lose energy come together at one place, where nothing but round-off tells who is on the right."""
    for number in range(6):
        random = np.random.default_rng(number)
        count = (2, 5, 12)[number % 3]
        points = {"position": random.uniform(0.0, 6.0, (count, 1)).tolist(), "mass": random.uniform(0.1, 3.0, count).tolist()}
        points["velocity"] = random.uniform(-1.0, 1.0, (count, 1)).tolist()
        effects = {"collisions": {"mode": "event", "restitution": restitution}}
        effects |= {"mutual_gravity": {"G": 1.0, "softening": 0.05}} if attract else {}
        time = {"step": (0.005, 0.02, 0.1)[number // 2], "steps": 120}
        sim = Simulation(Scene(dimension=1, time=time, effects=effects, particles=[points]))
        for step in range(5, 120, 5):
            other = sim.copy()
            sim.steps(5)
            other.steps(5)
            assert other == sim, f"start {number}, from step {step - 5}"


@pytest.mark.parametrize("radius", [1e-30, 1e-170])
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("surface", [{}, {"friction": 0.3}, {"restitution": 0.5}])
@pytest.mark.parametrize("pulled", [False, True])
def test_spheres_below_round_off_pass_one_another(pulled, surface, mode, radius):
    """Their centres are at one place when they touch: there is no direction in which to push them apart."""
    spheres = {"position": [[1.0, 0.5], [2.0, 0.5]], "velocity": [[1.0, 0.0], [-1.0, 0.0]], "radius": radius}
    effects = {"collisions": {"mode": mode} | surface} | ({"drag": {"rate": 1e-3}} if pulled else {})
    time = {"step": 0.3 if mode == "event" else radius, "steps": 1}  # in mode rewind steps end before a diameter is crossed
    sim = Simulation(Scene(dimension=2, time=time, particles=[spheres], effects=effects))
    sim.h = 0.3
    sim.steps(4)
    order = np.argsort(sim.particles.id)
    assert np.abs(sim.particles.position[order] - [[2.2, 0.5], [0.8, 0.5]]).max() < 2e-3


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("d", [1, 2, 3])
@pytest.mark.parametrize("force", ["user_acceleration", "mutual_gravity"])
def test_losses_of_contacts_do_not_concern_points(force, d, mode):
    """As without collisions, to the bit: what forces press together are spheres, not points."""
    if d == 1 and mode == "event":
        pytest.skip("points meet on a line")
    start = [[0.0] * d, [0.01] + [1e-6] * (d - 1), [0.3] + [0.02] * (d - 1)]
    pulled = {"acceleration": [[1.0] + [0.0] * (d - 1), [-1.0] + [0.0] * (d - 1), [0.0] * d]}
    effects = {force: {} if force == "user_acceleration" else {"G": 1.0, "softening": 0.05}}
    ends = []
    for more in ({}, {"collisions": {"mode": mode, "restitution": 0.5}}):
        points = {"position": start, "mass": 1.0} | (pulled if force == "user_acceleration" else {})
        sim = Simulation(Scene(dimension=d, time={"step": 0.02, "steps": 50}, effects=effects | more, particles=[points]))
        sim.steps(50)
        order = np.argsort(sim.particles.id)
        ends.append((sim.particles.position[order].tobytes(), sim.particles.velocity[order].tobytes()))
    assert ends[0] == ends[1]


@pytest.mark.parametrize("integrator", ["leapfrog", "order4", "adaptive", "taylor"])
@pytest.mark.parametrize(
    "effects",
    [
        {"mutual_gravity": {}},
        {"mutual_gravity": {"method": "tree"}},
        {"uniform_gravity": {"acceleration": [0.0, -1.0]}, "user_acceleration": {}, "mutual_gravity": {}},
        {"collisions": {"restitution": 0.5}, "walls": {"restitution": 0.5}, "uniform_gravity": {"acceleration": [0.0, -1.0]}},
        {"drag": {"rate": 1.0}, "friction": {"strength": 1.0}},
    ],
)
def test_nobody_is_simulated(effects, integrator):
    tree = effects.get("mutual_gravity", {}).get("method") == "tree"
    if (integrator != "leapfrog" and {"drag", "collisions"} & effects.keys()) or (integrator == "adaptive" and tree):
        pytest.skip("refused")
    box = {"lower": [0.0] * 2, "upper": [1.0] * 2}
    sim = Simulation(
        Scene(dimension=2, box=box, time={"step": 0.1, "steps": 5, "integrator": integrator}, effects=effects, particles=[])
    )
    sim.steps(5)
    assert sim.steps_done == 5 and sim.total == 0


@pytest.mark.parametrize(
    ("step", "end", "told"), [(0.3, 1.0, "t = 0.9, after step 3"), (3.0, 1.0, "t = 0, after step 0"), (0.1, 1.0, None)]
)
def test_an_end_between_two_steps_is_named(step, end, told):
    sim = Simulation(Scene(dimension=1, time={"step": step, "end": end}, particles=[{"position": [[0.0]]}]))
    assert [told in line for line in sim.warnings] == ([True] if told else [])


@pytest.mark.parametrize("number", [2.5, -3, "2"])
def test_a_number_of_steps_is_a_number(number):
    sim = Simulation(Scene(dimension=1, time={"step": 0.1, "steps": 9}, particles=[{"position": [[0.0]]}]))
    with pytest.raises(ValueError, match="is not a number of steps"):
        sim.steps(number)


def test_a_single_step_takes_no_number():
    """It would be read as `collisions=5`."""
    sim = Simulation(Scene(dimension=1, time={"step": 0.1, "steps": 9}, particles=[{"position": [[0.0]]}]))
    with pytest.raises(TypeError):
        sim.step(5)
    assert sim.steps_done == 0


@pytest.mark.parametrize("effects", [{}, {"collisions": {}}, {"collisions": {"mode": "event"}}, {"user_acceleration": {}}])
def test_places_come_back_into_a_periodic_box(effects):
    """In steps computed one by one and many at once, with collisions and where a step leaves them out."""
    points = {"count": 40, "position": "random", "velocity": {"speed": 3.0}}
    box, time = {"lower": [-1.0, 2.0, 0.0], "upper": [2.0, 4.0, 5.0], "periodic": [True, True, False]}, {"step": 0.1, "steps": 9}
    ends = []
    for ways in (
        lambda sim: sim.steps(9),
        lambda sim: [sim.step() for _ in range(9)],
        lambda sim: [sim.step(collisions=False) for _ in range(9)],
    ):
        sim = Simulation(Scene.from_dict({"dimension": 3, "box": box, "time": time, "particles": [points], "effects": effects}))
        start, velocity = (
            sim.particles.position[np.argsort(sim.particles.id)],
            sim.particles.velocity[np.argsort(sim.particles.id)],
        )
        ways(sim)
        ends.append(sim.particles.position[np.argsort(sim.particles.id)])
    length, free = np.array([3.0, 2.0, np.inf]), start + 0.9 * velocity
    free[:, :2] -= np.floor((free[:, :2] - box["lower"][:2]) / length[:2]) * length[:2]
    for end in ends:
        np.testing.assert_allclose(end, free, atol=1e-12)
