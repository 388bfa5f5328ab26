"""Balls that lie on something bounce off one another, and off walls, as if they flew: nothing presses those contacts."""

from math import sqrt

import numpy as np
import pytest
from with_all import with_all

from particles_mpi import Scene, SceneError, Simulation

MODES = ("rewind", "event")
SPEEDS = (0.6, 0.4, 0.1, 0.01)
STEPS = (0.01, 0.005, 0.0005)
G, R, E = 9.81, 0.05, 0.9
TILT = 1e-3  # of slopes: less than the slowest balls gain in a step
PLANET = 10.0  # its radius


def place(d, x, z, y=0.0):
    """Across, along and up, in 2D without the second."""
    return [x, z] if d == 2 else [x, y, z]


class Meeting:
    """Where two balls (or one and a wall) lie, at which speeds, on which planes and fixed spheres."""

    def __init__(self, ground, d, speed, gap):
        u, x = 0.5 * speed, R + 0.5 * gap
        self.planes = [{"point": [0.0] * d, "normal": place(d, 0.0, 1.0), "restitution": 0.5}]
        self.fixed, self.mass = None, 1.0
        self.position, self.velocity = [place(d, -x, R), place(d, x, R)], [place(d, u, 0.0), place(d, -u, 0.0)]
        getattr(self, ground.replace(" ", "_"))(d, speed, u, x, gap)

    def floor(self, d, speed, u, x, gap):
        """As it is."""

    def wall(self, d, speed, u, x, gap):
        """One ball rolls into a wall."""
        self.planes.append({"point": [0.0] * d, "normal": place(d, 1.0, 0.0), "restitution": E})
        self.position, self.velocity = [place(d, R + gap, R)], [place(d, -speed, 0.0)]

    def valley(self, d, speed, u, x, gap):
        """Both lie on two planes, and move along the line where these meet."""
        self.planes = [{"point": [0.0] * 3, "normal": [s, 0.0, 1.0], "restitution": 0.5} for s in (-0.7, 0.7)]
        z = R * sqrt(1.0 + 0.7**2)
        self.position, self.velocity = [[0.0, -x, z], [0.0, x, z]], [[0.0, u, 0.0], [0.0, -u, 0.0]]

    def slopes(self, d, speed, u, x, gap):
        """Each lies on a plane of its own, and rolls down to the other."""
        self.planes = [{"point": [0.0] * d, "normal": place(d, s, 1.0), "restitution": 0.5} for s in (-TILT, TILT)]
        z = R * sqrt(1.0 + TILT**2) + TILT * x
        self.position = [place(d, -x, z), place(d, x, z)]
        self.velocity = [place(d, u, -TILT * u), place(d, -u, -TILT * u)]

    def fixed_spheres(self, d, speed, u, x, gap):
        """They meet where each is on the top of a sphere."""
        self.planes, self.fixed = [], {"position": [place(d, -R, 0.0), place(d, R, 0.0)], "radius": R, "fixed": True}
        z = sqrt(4.0 * R**2 - (x - R) ** 2)
        self.position = [place(d, -x, z), place(d, x, z)]

    def planet(self, d, speed, u, x, gap):
        """A large sphere whose gravity holds them."""
        reach = PLANET + R
        self.planes, self.mass = [], 1e-6
        self.fixed = {"position": [[0.0] * d], "radius": PLANET, "fixed": True, "mass": G * reach**2}
        z = sqrt(reach**2 - x**2)
        self.position = [place(d, -x, z), place(d, x, z)]
        self.velocity = [place(d, u * z / reach, u * x / reach), place(d, -u * z / reach, u * x / reach)]


def measured(ground, force, d, mode, step, speed):
    """(restitution; some steps later: whether all are supported still, how far up or down from the start)."""
    gap = min(3.3 * step * speed, 2e-4 if ground == "fixed spheres" else 1.0)
    scene = Meeting(ground, d, speed, gap)
    balls = {"position": scene.position, "velocity": scene.velocity, "radius": R, "mass": scene.mass}
    down = place(d, 0.0, -G)
    options = {"uniform_gravity": {"acceleration": down}, "user_acceleration": {}, "mutual_gravity": {"G": 1.0}}
    effects = {force: options[force], "collisions": {"mode": mode, "restitution": E}}
    if force == "user_acceleration":
        balls["acceleration"] = down
    if scene.planes:
        effects["walls"] = {"planes": scene.planes}
    particles = [balls, *([scene.fixed] if scene.fixed else [])]
    sim = Simulation(Scene(dimension=d, time={"step": step, "steps": 1}, particles=particles, effects=effects))
    balls, drift, found = slice(0, len(scene.position)), sim.drift.operator.drift, []

    def apart():
        """(distance between the surfaces, how fast it shrinks, and how fast that grows) of the two, or of one and the wall."""
        rows = np.argsort(sim.rows.id)[balls]
        x, v, a = (sim.rows[name][rows] for name in ("position", "velocity", "total_acceleration"))
        if len(x) == 1:
            return x[0, 0] - R, -v[0, 0], -a[0, 0]
        n = (x[0] - x[1]) / np.sqrt((x[0] - x[1]) @ (x[0] - x[1]))
        return (x[0] - x[1]) @ n - 2.0 * R, -(v[0] - v[1]) @ n, -(a[0] - a[1]) @ n

    def watched(*args):
        gap, before, faster = apart()
        counts = drift(*args)
        after = apart()[1]
        if before > 0.0 > after:  # these are the velocities of the middle of the step
            gained = faster * (gap / before - 0.5 * step)
            found.append(-(after + gained) / (before + gained))
        return counts

    sim.drift.operator.drift = watched
    for _ in range(6):
        sim.step()
    order = np.argsort(sim.particles.id)[balls]
    lifted = sim.particles.position[order, -1] - np.array(scene.position)[:, -1]
    return (found[0] if found else 0.0), bool(sim.particles["supported"][order].all()), float(np.abs(lifted).max())


CASES = [
    (ground, force, d)
    for ground, forces, dimensions in (
        ("floor", ("uniform_gravity", "user_acceleration"), (2, 3)),
        ("wall", ("uniform_gravity", "user_acceleration"), (2, 3)),
        ("valley", ("uniform_gravity", "user_acceleration"), (3,)),
        ("slopes", ("uniform_gravity", "user_acceleration"), (2, 3)),
        ("fixed spheres", ("uniform_gravity", "user_acceleration"), (2, 3)),
        ("planet", ("mutual_gravity",), (2, 3)),
    )
    for force in forces
    for d in dimensions
]


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("ground", "force", "d"), CASES)
def test_restitution(ground, force, d, mode):
    """That of the scene at every speed and step; and what lay, lies, without a jump."""
    for step in STEPS:
        for speed in SPEEDS:
            e, supported, lifted = measured(ground, force, d, mode, step, speed)
            assert e == pytest.approx(E, abs=1e-3), (step, speed)
            assert supported, (step, speed)
            assert lifted < 1e-12 or ground in ("slopes", "fixed spheres", "planet"), (step, speed)


@pytest.mark.parametrize("mode", [None, *MODES])
@pytest.mark.parametrize("speed", SPEEDS)
def test_only_walls_are_lossy(mode, speed):
    """Nothing is remembered then: the wall gives its restitution all the same, and the ball stays on the floor."""
    sim = Simulation(
        Scene(
            dimension=2,
            box={"lower": [0.0, 0.0], "upper": [9.0, 9.0]},
            time={"step": 0.005, "steps": 1},
            particles=[{"position": [[R + 3.3 * 0.005 * speed, R]], "velocity": [-speed, 0.0], "radius": R}],
            effects={
                "uniform_gravity": {"acceleration": [0.0, -G]},
                "walls": {"restitution": E},
                **({"collisions": {"mode": mode}} if mode else {}),
            },
        )
    )
    for _ in range(10):
        sim.step()
    np.testing.assert_allclose(sim.particles.velocity[0], [E * speed, 0.0], rtol=1e-12, atol=0.0)
    assert sim.particles.position[0, 1] == R


@pytest.mark.parametrize("mode", [None, *MODES])
@pytest.mark.parametrize("faces", [True, False])
@pytest.mark.parametrize("d", [3, *with_all(1, 2)])
def test_a_point_comes_to_rest(d, faces, mode):
    """As a ball does: no bounces after a while, and no speed."""
    up = [0.0] * (d - 1) + [1.0]
    for e in (0.0, 0.9):
        walls = {"restitution": e} if faces else {"restitution": e, "planes": [{"point": [0.0] * d, "normal": up}]}
        effects = {"uniform_gravity": {"acceleration": [-9.81 * x for x in up]}, "walls": walls}
        effects |= {"collisions": {"mode": mode, "restitution": e}} if mode else {}
        box = {"box": {"lower": [0.0] * d, "upper": [2.0] * d}} if faces else {}
        ball = [{"position": [[1.0] * d]}]
        sim = Simulation(Scene(dimension=d, time={"step": 0.02, "steps": 1}, particles=ball, effects=effects, **box))
        sim.steps(500)
        hits = sim.totals["wall_hits"]
        sim.steps(50)
        assert sim.totals["wall_hits"] == hits and np.abs(sim.particles.velocity).max() < 1e-12, e


@pytest.mark.parametrize("size", [1e-300, 1e-160, 1e-8, 1e8, 1e90])
def test_normals_have_any_length(size):
    planes = [{"point": [0.0, 0.0], "normal": [0.0, size]}]
    ball = [{"position": [[2.0, 2.0]], "velocity": [-1.0, -1.0], "radius": 0.5}]
    sim = Simulation(Scene(dimension=2, time={"step": 0.1, "steps": 30}, particles=ball, effects={"walls": {"planes": planes}}))
    sim.run()
    assert sim.totals["wall_hits"] == 1
    np.testing.assert_allclose(sim.particles.position, [[-1.0, 2.0]], atol=1e-12)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("step", [0.01, 0.0005])
def test_cradle_on_a_floor(mode, d, step):
    """Five touching balls, e = 1 between them; the last one leaves with the velocity of the one that comes."""
    for speed in (2.0, 0.1, 0.01):
        row = [place(d, 2.0 * R * k, R) for k in range(5)]
        sim = Simulation(
            Scene(
                dimension=d,
                time={"step": step, "steps": 1},
                particles=[
                    {"position": row, "radius": R},
                    {"position": [place(d, -2.0 * R - 3.3 * step * speed, R)], "velocity": place(d, speed, 0.0), "radius": R},
                ],
                effects={
                    "uniform_gravity": {"acceleration": place(d, 0.0, -G)},
                    "walls": {"planes": [{"point": [0.0] * d, "normal": place(d, 0.0, 1.0)}], "restitution": 0.5},
                    "collisions": {"mode": mode},
                },
            )
        )
        for _ in range(12):
            sim.step()
        right = np.zeros((6, d))
        right[4, 0] = speed
        assert np.abs(sim.particles.velocity[np.argsort(sim.particles.id)] - right).max() <= 1e-9 * speed


def forget(sim):
    """As after a change of the state by a user."""
    sim.persistent.history.forget()
    sim.particles["supported"][:] = 0


def column(mode, n):
    """n touching balls, one on the other."""
    return Simulation(
        Scene(
            dimension=2,
            box={"lower": [0.0, 0.0], "upper": [1.0, 0.2 * n]},
            time={"step": 0.005, "steps": 1},
            particles=[{"position": [[0.5, R + 2.0 * R * k] for k in range(n)], "radius": R}],
            effects={
                "uniform_gravity": {"acceleration": [0.0, -G]},
                "walls": {"restitution": E},
                "collisions": {"mode": mode, "restitution": E},
            },
        )
    )


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("n", [1, 10, 50])
def test_what_rests_needs_no_memory(mode, n):
    """A column that stands from the start stays where it is, though memory is lost, once or in every step."""
    sim = column(mode, n)
    place = sim.particles.position.copy()
    for step in range(30):
        if step == 10 or step >= 20:
            forget(sim)
        sim.step()
        assert sim.measure()["kinetic"] == 0.0
    assert (sim.particles.position == place).all()


@pytest.mark.parametrize("d", [1, 2, 3])
def test_rows_that_a_drift_tells_near_walls_are_those_that_are_found_by_looking(d):
    """With lossy walls alone the drift of many steps tells who is near; looking at all rows after each kick gives the same bits.

    Also where a user moves, adds and removes particles, lets them pass through walls for a step, and changes g and the step.
    """
    scene = Scene.from_dict(
        {
            "dimension": d,
            "seed": 3,
            "box": {"lower": [-1.0] * d, "upper": [1.0] * d},
            "time": {"step": 0.01, "steps": 1000},
            "particles": [
                {
                    "count": 400,
                    "position": "random",
                    "velocity": {"speed": 1.0},
                    "radius": {"min": 0.01, "max": 0.05},
                    "mass": 1.0,
                }
            ],
            "effects": {"uniform_gravity": {"acceleration": [-9.81, 1.0, 0.5][:d]}, "walls": {"restitution": 0.8}},
        }
    )
    told, looking = Simulation(scene), Simulation(scene)
    rested = 0
    for step in range(400):
        for sim in (told, looking):
            if step == 100:
                sim.particles.position[:5] = 0.25
            if step % 40 == 0:
                sim.particles.velocity[:] += np.random.default_rng(step).normal(size=(len(sim.particles), d))
            if step == 150:
                sim.remove(sim.particles.id[3:6])
                sim.add({"count": 2, "position": "random", "radius": 0.03, "mass": 1.0})
            if step == 200:
                sim.effects["uniform_gravity"].acceleration = [9.81, 0.0, -2.0][:d]
            if step == 220:
                sim.h = 0.03
            if sim is looking:
                sim.many_steps = None
            sim.step(collisions=step < 250 or step % 3 != 0)
        assert told == looking, step
        np.testing.assert_array_equal(told.rows["supported"], looking.rows["supported"])
        rested += int(told.rows["supported"].sum())
    assert rested > 500


@pytest.mark.parametrize("mode", [None, "event", "rewind"])
@pytest.mark.parametrize(("gap", "speed", "h", "steps"), [(1.0, 1500.0, 1.0, 1), (1.0, 9000.0, 1.0, 1), (5e-4, 1.0, 0.2, 5)])
def test_any_number_of_bounces_between_two_plates_in_a_step(mode, gap, speed, h, steps):
    """The way along the plates is v t, and hits across are counted; where there is no gap at all the run says so."""
    planes = [{"point": [0.0, 0.0], "normal": [0.0, 1.0]}, {"point": [0.0, 1.0 + gap], "normal": [0.0, -1.0]}]
    effects = {"walls": {"planes": planes}} | ({"collisions": {"mode": mode}} if mode else {})
    ball = {"position": [[0.0, 0.5 + 0.3 * gap]], "velocity": [0.7, speed], "radius": 0.5}
    scene = {"dimension": 2, "time": {"step": h, "steps": steps}, "particles": [ball], "effects": effects}
    if mode == "rewind" and speed > 1.0:
        with pytest.raises(SceneError, match=r"time\.step"):  # it would cross more than its diameter
            Simulation(Scene(**scene))
        return
    sim = Simulation(Scene(**scene))
    sim.run()
    assert sim.particles.position[0, 0] == pytest.approx(0.7 * h * steps, rel=1e-9)
    assert sim.totals["wall_hits"] == pytest.approx(speed * h * steps / gap, abs=1.5)
    assert sim.totals["missed"] == 0 and not sim.remarks()


@pytest.mark.parametrize("mode", [None, "event", "rewind"])
def test_a_sphere_without_room_is_told(mode):
    planes = [{"point": [0.0, 0.0], "normal": [0.0, 1.0]}, {"point": [0.0, 1.0], "normal": [0.0, -1.0]}]
    effects = {"walls": {"planes": planes}} | ({"collisions": {"mode": mode}} if mode else {})
    ball = {"position": [[0.0, 0.5]], "velocity": [0.7, 1.0], "radius": 0.5}
    sim = Simulation(Scene(dimension=2, time={"step": 0.1, "steps": 5}, particles=[ball], effects=effects))
    sim.run()
    assert sim.totals["missed"] > 0 and "had no room" in sim.remarks()[0]
    assert sim.measure()["kinetic"] == pytest.approx(0.5 * 1.49) and abs(sim.particles.position[0, 1] - 0.5) < 1e-12


@pytest.mark.parametrize("collisions", [{}, {"collisions": {"mode": "rewind"}}, {"collisions": {"mode": "event"}}])
@pytest.mark.parametrize("loss", [{"restitution": 0.1}, {"restitution": 0.5}, {"damping": 0.9}])
def test_a_ceiling_holds_nothing_and_a_force_of_zero_changes_nothing(loss, collisions):
    """Balls that come to a ceiling at any speed, also so slowly that on a floor they would stay: gravity pulls them off it."""
    random, n, step = np.random.default_rng(1), 40, 0.03
    height, speed = 4.6 - random.uniform(0.0, 0.1, n), random.uniform(0.0, 1.5, n)
    balls = {
        "position": np.column_stack((np.arange(n) + 0.5, height)).tolist(),
        "velocity": np.column_stack((np.zeros(n), speed)).tolist(),
        "radius": 0.4,
    }
    effects = {"uniform_gravity": {"acceleration": [0.0, -9.81]}, "walls": loss}
    effects |= {name: {**options, "restitution": 0.8} for name, options in collisions.items()}
    ends = []
    for other in ({}, {"user_acceleration": {}}):
        box, time = {"lower": [0.0, 0.0], "upper": [float(n), 5.0]}, {"step": step, "steps": 6}
        sim = Simulation(Scene(dimension=2, box=box, time=time, particles=[balls], effects=effects | other))
        for _ in range(6):
            sim.step()
            ends.append(np.concatenate((sim.particles.position, sim.particles.velocity), axis=1)[np.argsort(sim.particles.id)])
    assert np.array(ends[:6]) == pytest.approx(np.array(ends[6:]), abs=1e-12)
    assert (ends[5][:, 3] < 0.0).all()


@pytest.mark.parametrize("mode", ["rewind", "event"])
@pytest.mark.parametrize("e", [0.9, 0.95, 1.0])
def test_a_rack_of_balls_on_a_floor_breaks_as_without_one(e, mode):
    """Fifteen that touch, hit by one at 6 m/s: as a crowd that collapses they lost 59 % of the energy."""
    radius, row = 0.03, [(k, j) for k in range(5) for j in range(k + 1)]
    plane = [[-0.2, 0.002], *([np.sqrt(3.0) * radius * k, radius * (2 * j - k)] for k, j in row)]
    law = {"mode": mode, "restitution": e}

    def energy(d, **more):
        places, velocity = [[*place, radius][:d] for place in plane], np.zeros((16, d))
        velocity[0, 0] = 6.0
        balls = {"position": places, "velocity": velocity, "radius": radius, "mass": 0.17}
        sim = Simulation(Scene(dimension=d, time={"step": 0.004, "steps": 15}, particles=[balls], **more))
        sim.steps(15)
        return 0.5 * 0.17 * (sim.particles.velocity[:, :2] ** 2).sum()

    floor = {"planes": [{"point": [0.0] * 3, "normal": [0.0, 0.0, 1.0]}], "restitution": 0.5}
    gravity = {"acceleration": [0.0, 0.0, -9.81]}
    without = energy(2, effects={"collisions": law})
    lying = energy(3, effects={"collisions": law, "walls": floor, "uniform_gravity": gravity})
    assert lying == pytest.approx(without, rel=1e-3)
