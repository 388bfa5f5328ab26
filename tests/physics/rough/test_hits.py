"""Hits of rough spheres: the three-parameter law for each angle, what it keeps, and what it takes."""

import numpy as np
import pytest
from scenes import simulation

from particles_mpi import Scene, Simulation

MODES = ("rewind", "event")
ANGLES = np.radians([0.0, 5.0, 20.0, 35.0, 50.0, 65.0, 80.0, 85.0])
E, MU, BETA = 0.8, 0.3, 0.4


def hit(d, mode, angle, spin, partner, mu=MU, beta=BETA):
    """(velocity, spin) of a sphere of radius 0.5 and mass 1.5 after it hit a wall, a fixed sphere, or a free one of mass 3.

    It comes along the normal, which is the last axis, tilted by the angle to the first axis.
    """
    v = np.zeros(d)
    v[0], v[-1] = np.sin(angle), -np.cos(angle)
    start = np.zeros(d)
    start[-1] = 0.5 + 0.7 * (partner != "wall")
    turning = spin if d == 2 else [0.0, spin, 0.0]
    ball = {"position": [(start - 0.005 * v).tolist()], "velocity": [v.tolist()], "radius": 0.5, "mass": 1.5}
    ball["spin"] = turning if d == 2 else [turning]
    surfaces = {"restitution": E, "friction": mu, "tangential_restitution": beta}
    if partner == "wall":
        plane = {"point": [0.0] * d, "normal": [0.0] * (d - 1) + [1.0]}
        effects = {"walls": {"planes": [plane]} | surfaces, "collisions": {"mode": mode}}
        sim = simulation(d, [ball], effects)
    else:
        other = {"position": [[0.0] * d], "radius": 0.7, "mass": 3.0, "fixed": partner == "fixed"}
        sim = simulation(d, [ball, other], {"collisions": {"mode": mode} | surfaces})
    sim.step()
    p = sim.rows
    i = int(np.flatnonzero(p.id == 0)[0])
    assert sim.totals["collisions"] + sim.totals["wall_hits"] == 1
    return p.velocity[i], p.spin[i]


def expected(d, angle, spin, partner, mu=MU, beta=BETA):
    """The same by the formulas of Foerster et al., in the plane of the first and the last axis.

    With a positive spin about the axis that turns the last axis towards the first (y in space), or about z in the plane, where it
    turns the first towards the last.
    """
    q = 1.0 / (0.5 if d == 2 else 0.4) / (1.5 * 0.5**2)
    w, arm_term = 1.0 / 1.5, 0.5**2 * q
    w_j, far_term = (1.0 / 3.0, 0.7**2 / (0.5 if d == 2 else 0.4) / (3.0 * 0.7**2)) if partner == "free" else (0.0, 0.0)
    sense = 1.0 if d == 2 else -1.0  # of the spin, where it moves the lowest point of the sphere to the first axis
    slip = np.sin(angle) + sense * 0.5 * spin
    push = (1.0 + E) * np.cos(angle) / (w + w_j)
    grip = min((1.0 + beta) * abs(slip) / (w + w_j + arm_term + far_term), mu * push)
    across = -np.sign(slip) * grip
    velocity = np.zeros(d)
    velocity[0], velocity[-1] = np.sin(angle) + w * across, -np.cos(angle) + w * push
    turned = spin + sense * 0.5 * q * across
    return velocity, np.array([turned]) if d == 2 else np.array([0.0, turned, 0.0])


@pytest.mark.parametrize("partner", ["wall", "fixed", "free"])
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("d", [2, 3])
def test_the_law_for_every_angle(d, mode, partner):
    for angle in ANGLES:
        for spin in (0.0, 3.0, -3.0):
            got, want = hit(d, mode, angle, spin, partner), expected(d, angle, spin, partner)
            assert np.abs(got[0] - want[0]).max() <= 1e-12 and np.abs(got[1] - want[1]).max() <= 1e-12, (angle, spin)


def pairs_that_meet(d, random, count):
    """Populations of two spheres on their way to an oblique hit, spinning."""
    for _ in range(count):
        x, v = random.normal(size=d) + np.zeros((2, d)), 0.1 * random.normal(size=(2, d))
        x[0, 0] -= 1.5
        x[0, 1] += random.uniform(0.0, 1.05)
        v[0, 0] += random.uniform(2.0, 4.0)
        spin = 3.0 * random.normal(size=(2, d * (d - 1) // 2))
        sizes = {"radius": [0.5, 0.6], "mass": random.uniform(0.01, 3.0, 2).tolist()}
        yield {"position": x.tolist(), "velocity": v.tolist(), "spin": spin.tolist() if d == 3 else spin[:, 0].tolist(), **sizes}


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("d", [2, 3])
def test_momenta_are_kept_and_energy_never_rises(d, mode):
    random = np.random.default_rng(d)
    for number, population in enumerate(pairs_that_meet(d, random, 12)):
        surfaces = {"friction": [0.1, 0.5, 1e6][number % 3], "tangential_restitution": [0.5, -0.5, 1.0, 0.0][number % 4]}
        sim = simulation(d, [population], {"collisions": {"mode": mode, "restitution": 0.9} | surfaces}, step=0.2)
        before = sim.measure()
        for _ in range(6):
            sim.step()
        after = sim.measure()
        assert sim.totals["collisions"] == 1
        size = max(1.0, *(abs(before[name]) for name in before if "momentum" in name))
        assert max(abs(after[name] - before[name]) for name in before if "momentum" in name) <= 1e-14 * size
        assert after["total_energy"] <= before["total_energy"] * (1.0 + 1e-15)


@pytest.mark.parametrize("mode", MODES)
def test_a_super_ball_between_two_planes_keeps_its_energy(mode):
    ball = {"position": [[0.0, 0.0, 0.8]], "velocity": [[1.0, 0.3, -2.0]], "spin": [[4.0, -3.0, 1.0]], "radius": 0.5}
    planes = [{"point": [0, 0, 0], "normal": [0, 0, 1]}, {"point": [0, 0, 1.5], "normal": [0, 0, -1]}]
    effects = {"walls": {"planes": planes, "tangential_restitution": 1.0}, "collisions": {"mode": mode}}
    sim = simulation(3, [ball], effects, step=0.05)
    before = sim.measure()["total_energy"]
    for _ in range(400):
        sim.step()
    assert sim.totals["wall_hits"] > 70
    assert abs(sim.measure()["total_energy"] / before - 1.0) <= 1e-13


@pytest.mark.parametrize("mode", MODES)
def test_without_friction_nothing_turns_and_mu_0_is_smooth(mode):
    """Where it is named as 0, spins stay what they are, and all else has the bits of the scene that does not name it."""
    gas = [{"count": 60, "position": "random", "radius": 0.2, "velocity": {"temperature": 1.0}}]
    more = {"box": {"lower": [0] * 3, "upper": [3] * 3}}
    smooth = simulation(3, gas, {"collisions": {"mode": mode, "restitution": 0.9}, "walls": {}}, **more)
    rough = {"collisions": {"mode": mode, "restitution": 0.9, "friction": 0.0}, "walls": {"friction": 0.0}}
    zero = simulation(3, gas, rough, **more)
    for _ in range(100):
        smooth.step()
        zero.step()
    assert smooth.totals["collisions"] > 20
    assert "spin" not in smooth.rows.arrays and "spin" not in zero.rows.arrays
    assert smooth.rows.position.tobytes() == zero.rows.position.tobytes()


@pytest.mark.parametrize("mode", [None, "event", "rewind"])
@pytest.mark.parametrize("surface", [{}, {"tangential_restitution": 0.5}])
def test_a_wall_that_takes_all_of_the_approach_is_hit_once(surface, mode):
    """What is left of the approach is round-off, above 0 or below, by the direction of the wall: the speed along it stays."""
    for degrees in range(0, 360, 10):
        normal = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
        along = np.array([-normal[1], normal[0]])
        disc = {"position": [(0.3 * normal).tolist()], "velocity": (along - normal).tolist(), "radius": 0.1}
        walls = {"restitution": 0.0, "planes": [{"point": [0.0, 0.0], "normal": normal.tolist()}]} | surface
        effects = {"walls": walls} | ({"collisions": {"mode": mode}} if mode else {})
        sim = Simulation(Scene(dimension=2, time={"step": 0.02, "steps": 100}, effects=effects, particles=[disc]))
        sim.steps(100)
        speed = 0.5 if surface else 1.0  # a disc with I = m R^2/2 sticks: 1 - (1 + beta_0)/3
        assert (sim.totals["wall_hits"], sim.particles.velocity[0] @ along) == (1, pytest.approx(speed, rel=1e-12)), degrees


@pytest.mark.parametrize("restitution", [1.0, 0.9])
@pytest.mark.parametrize("what", ["walls", "collisions"])
def test_contacts_within_t_c_of_the_last_one_take_nothing(what, restitution):
    """Between surfaces that are rough, whatever they leave of the approach: t_c is longer than the run."""
    effects = {"collisions": {"mode": "event", "contact_duration": 10.0}, "walls": {"planes": []}}
    effects["walls"]["planes"] = [{"point": [0.0, y], "normal": [0.0, -np.sign(y)]} for y in (-0.5, 0.5)]
    effects[what] |= {"friction": 0.2, "restitution": restitution}
    discs = {"position": [[0.0, 0.0]], "velocity": [1.0, 2.0], "radius": 0.1}
    if what == "collisions":
        spins = {"spin": [0.1, 0.0]}
        discs = {"position": [[0.0, 0.0], [0.0, 0.3]], "velocity": [[0.0, 2.0], [0.0, -1.0]], "radius": 0.1} | spins
    sim, energies = Simulation(Scene(dimension=2, time={"step": 0.02, "steps": 200}, effects=effects, particles=[discs])), []
    for _ in range(200):
        hits = sim.totals[what if what == "collisions" else "wall_hits"]
        sim.step()
        if sim.totals[what if what == "collisions" else "wall_hits"] > hits:
            energies.append(sim.measure()["total_energy"])
    assert len(energies) > 2 and energies == pytest.approx([energies[0]] * len(energies), rel=1e-12)


@pytest.mark.parametrize("read", [False, True])
@pytest.mark.parametrize("later", [0.0, -2.5, 7.0])
def test_the_clock_may_be_set_between_two_contacts(later, read):
    """The second one is long after the first, whatever the clock says: it takes energy."""
    effects = {"collisions": {"mode": "event", "contact_duration": 0.2}, "walls": {"restitution": 0.5}}
    ball = {"position": [[2.0]], "velocity": [-2.0], "radius": 0.5}
    box = {"lower": [0.0], "upper": [10.0]}
    sim = Simulation(Scene(dimension=1, box=box, time={"step": 0.05, "steps": 80}, effects=effects, particles=[ball]))
    sim.steps(40)
    sim.particles.velocity *= -1.0
    before = sim.particles.contacted.copy() if read else 0.75
    sim.time += later
    assert sim.particles.contacted == pytest.approx(before + later)
    sim.steps(40)
    assert sim.totals["wall_hits"] == 2 and sim.particles.velocity[0, 0] == pytest.approx(0.5) and not sim.remarks()
