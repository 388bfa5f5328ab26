"""Collisions against exact results, at every step length and phase."""

from math import sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from with_all import with_all

from particles_mpi import Scene, Simulation


def run(**tables):
    """(position, velocity) in id order at the end of a scene, and the simulation."""
    sim = Simulation(Scene(**tables))
    sim.run()
    order = np.argsort(sim.particles.id)
    return sim.particles.position[order], sim.particles.velocity[order], sim


@pytest.mark.parametrize("step", [0.01, 0.1, 0.37, 0.9, 1.0])
@pytest.mark.parametrize("phase", [0.0, 0.2, 0.5, 0.77, 0.999])
def test_oblique_pair_is_exact_at_every_step_and_phase(step, phase):
    """reference/: b/2R = 0.5 deflects by exactly 60 degrees. The course code gives four other angles."""
    x, v, sim = run(
        dimension=2,
        time={"step": step, "end": 10.0},
        particles=[{"position": [[-3.0 - phase * step, 0.5], [0.0, 0.0]], "velocity": [[1.0, 0.0], [0.0, 0.0]], "radius": 0.5}],
        effects={"collisions": {}},
    )
    after = np.array([[0.25, sqrt(3) / 4], [0.75, -sqrt(3) / 4]])
    contact = 3.0 - sqrt(0.75) + phase * step
    assert np.abs(v - after).max() <= 1e-12
    assert np.abs(x - ([[-sqrt(0.75), 0.5], [0.0, 0.0]] + (sim.time - contact) * after)).max() <= 1e-12
    assert sim.totals == {"collisions": 1, "wall_hits": 0, "missed": 0, "exchanges": 0, "unconverged": 0}


@pytest.mark.parametrize("dimension", [3, *with_all(2, 4)])
@settings(max_examples=60)
@given(st.floats(0.0, 0.99), st.floats(0.0, 1.0), st.floats(0.1, 10.0), st.floats(0.01, 0.9), st.floats(0.05, 0.95))
def test_pair_keeps_momentum_and_loses_what_restitution_says(dimension, b, e, mass, step, offset):
    """Along the normal the relative speed shrinks by e; momentum and the tangential velocity are as before."""
    still = [0.0] * (dimension - 2)
    start = np.array([[-2.0 - offset * step, b, *still], [0.0] * dimension])
    before = np.array([[1.0, 0.0, *still], [0.0] * dimension])
    _, v, sim = run(
        dimension=dimension,
        time={"step": step, "end": 6.0},
        particles=[{"position": start.tolist(), "velocity": before.tolist(), "radius": 0.5, "mass": [1.0, mass]}],
        effects={"collisions": {"restitution": e}},
    )
    assert sim.totals["collisions"] == 1
    normal = np.array([-sqrt(1.0 - b * b), b, *still])
    assert np.abs(v[0] + mass * v[1] - before[0]).max() <= 1e-13 * (1 + mass)
    assert (v[0] - v[1]) @ normal == pytest.approx(-e * before[0] @ normal, abs=1e-12)
    assert v[1] - (v[1] @ normal) * normal == pytest.approx(0.0, abs=1e-12)


def test_damping_multiplies_both_velocities():
    """The course's rule: elastic, then times sqrt(1 - alpha); kinetic energy falls by alpha."""
    _, v, _ = run(
        dimension=1,
        time={"step": 0.1, "end": 2.0},
        particles=[{"position": [[-1.0], [0.0]], "velocity": [[1.0], [-0.5]], "radius": 0.1}],
        effects={"collisions": {"damping": 0.19}},
    )
    assert v[:, 0] == pytest.approx([-0.5 * 0.9, 1.0 * 0.9], abs=1e-14)


def test_fixed_particle_reflects_and_never_moves():
    x, v, _ = run(
        dimension=2,
        time={"step": 0.03, "end": 3.0},
        particles=[
            {"position": [[0.0, 0.0]], "radius": 0.5, "fixed": True},
            {"position": [[-2.0, 0.0]], "velocity": [1.0, 0.0], "radius": 0.5},
        ],
        effects={"collisions": {}},
    )
    assert x[0].tolist() == [0.0, 0.0] and v[0].tolist() == [0.0, 0.0]
    assert v[1] == pytest.approx([-1.0, 0.0], abs=1e-15) and x[1] == pytest.approx([-3.0, 0.0], abs=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_elastic_rods_are_sorted_lines(seed):
    """reference/: with y_i = x_i - i sigma the state is sort(y + v t), and hits are inversions. Small steps order hits."""
    random, n, sigma = np.random.default_rng(seed), 20, 0.1
    y, u = np.sort(random.random(n)) * 10.0, random.normal(size=n)
    x, _, sim = run(
        dimension=1,
        time={"step": 0.0005, "end": 1.0},
        particles=[
            {"position": (y + sigma * np.arange(n))[:, None].tolist(), "velocity": u[:, None].tolist(), "radius": sigma / 2}
        ],
        effects={"collisions": {}},
    )
    end = y + u * sim.time
    assert np.abs(x[:, 0] - sigma * np.arange(n) - np.sort(end)).max() <= 1e-11
    inversions = sum(int((end[i + 1 :] < end[i]).sum()) for i in range(n))
    assert sim.totals["collisions"] == inversions


@pytest.mark.parametrize("dimension", [1, 2, 3, *with_all(4)])  # its kernels take a minute
def test_gas_in_a_box_keeps_energy_and_stays_inside(dimension):
    sim = Simulation(
        Scene(
            dimension=dimension,
            seed=3,
            box={"lower": [0.0] * dimension, "upper": [4.0] * dimension},
            time={"step": 0.02, "steps": 200},
            particles=[
                {"count": 12, "position": "random", "velocity": {"speed": 1.0}, "radius": {"min": 0.05, "max": 0.15},
                 "mass": {"min": 1.0, "max": 3.0}}
            ],
            effects={"collisions": {}, "walls": {}},
        )
    )  # fmt: skip
    before = sim.measure()["kinetic"]
    sim.run()
    p = sim.particles
    assert sim.measure()["kinetic"] == pytest.approx(before, rel=1e-13)
    assert (p.position >= p.radius[:, None] - 1e-13).all() and (p.position <= 4.0 - p.radius[:, None] + 1e-13).all()
    assert sim.totals["wall_hits"] > 0


def test_momentum_of_a_periodic_gas_is_round_off():
    """Restitution rule, periodic box, 1e5 collisions."""
    sim = Simulation(
        Scene(
            dimension=3,
            box={"lower": [0.0] * 3, "upper": [9.6] * 3, "periodic": True},
            time={"step": 0.01, "steps": 1},
            particles=[{"count": 512, "position": "lattice", "velocity": {"temperature": 1.0}, "radius": 0.5}],
            effects={"collisions": {}},
        )
    )
    before = sim.measure()
    while sim.totals["collisions"] < 100_000:
        sim.step()
    after = sim.measure()
    assert all(abs(after[f"momentum_{k}"] - before[f"momentum_{k}"]) <= 1e-11 for k in "xyz")
    assert after["kinetic"] == pytest.approx(before["kinetic"], rel=1e-11)


def test_rate_of_a_dense_gas_is_that_of_the_hard_sphere_fluid():
    """reference/: packing 0.30, Gamma dt = 0.1, at most 10 passes: (Z-1)/(Z_ref-1) = 1.00 +- 0.01."""
    n, packing, z = 4000, 0.30, carnahan_starling(0.30)
    length = (n * np.pi / 6.0 / packing) ** (1.0 / 3.0)
    gamma = (z - 1.0) * 6.0 / np.sqrt(np.pi)
    sim = Simulation(
        Scene(
            dimension=3,
            box={"lower": [0.0] * 3, "upper": [length] * 3, "periodic": True},
            time={"step": 0.1 / gamma, "steps": 1},
            particles=[{"count": n, "position": "lattice", "velocity": {"temperature": 1.0}, "radius": 0.5}],
            effects={"collisions": {}},
        )
    )
    for _ in range(300):  # 30 collisions a particle: the lattice has melted
        sim.step()
    start, steps = sim.totals["collisions"], 400
    for _ in range(steps):
        sim.step()
    temperature = 2.0 * sim.measure()["kinetic"] / (3.0 * n)
    measured = 2.0 * (sim.totals["collisions"] - start) / n / (steps * sim.h) / np.sqrt(temperature)
    assert measured / gamma == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(("d", "radius"), [(2, 0.4), *with_all((3, 0.4))])
def test_a_fixed_sphere_scatters_any_number_in_a_step(d, radius):
    """A Lorentz gas, whose mean free path is pi|Q|/|dQ| in the plane and 4|Q|/|dQ| in space (L. A. Santalo; N. Chernov, J. Stat.
    Phys. 88, 1 (1997)): ten passes a step lost a fifth of the hits, and points came to the middle of the disc."""
    random, n, h, steps = np.random.default_rng(0), 400, 0.02, 500
    places = [x for x in random.random((4000, d)) if np.linalg.norm(x - 0.5) > radius + 1e-3][:n]
    ways = random.normal(size=(n, d))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    disc = {"position": [[0.5] * d], "radius": radius, "fixed": True}
    points = {"position": [x.tolist() for x in places], "velocity": ways.tolist()}
    hits, ends = {}, {}
    for mode in ("rewind", "event"):
        tables = {"dimension": d, "box": {"lower": [0.0] * d, "upper": [1.0] * d, "periodic": True}}
        tables |= {"time": {"step": h, "steps": 1}, "particles": [disc, points], "effects": {"collisions": {"mode": mode}}}
        sim = Simulation(Scene(**tables))
        sim.steps(5)
        ends[mode] = sim.particles.position[np.argsort(sim.particles.id)]
        for _ in range(steps):
            sim.step()
            away = np.linalg.norm(sim.particles.position[sim.particles.id > 0] - 0.5, axis=1)
            assert away.min() > radius * (1.0 - 1e-9)
        assert sim.totals["missed"] == 0
        hits[mode] = sim.totals["collisions"]
    free = (1.0 - np.pi * radius**2) / (2.0 * radius) if d == 2 else (1.0 - 4.0 / 3.0 * np.pi * radius**3) / (np.pi * radius**2)
    assert n * (steps + 5) * h / hits["rewind"] == pytest.approx(free, rel=0.025)
    assert ends["rewind"] == pytest.approx(ends["event"], abs=1e-9)


@pytest.mark.parametrize(("share", "some"), [(0.003, False), (1.0, True)])
def test_collisions_that_come_late_are_told(share, some):
    """Passes go forward in time for each sphere, not for all: with long steps of a dense gas some meet when they overlap."""
    n, packing = 500, 0.30
    length = (n * np.pi / 6.0 / packing) ** (1.0 / 3.0)
    sim = Simulation(
        Scene(
            dimension=3,
            box={"lower": [0.0] * 3, "upper": [length] * 3, "periodic": True},
            time={"step": share / ((carnahan_starling(packing) - 1.0) * 6.0 / np.sqrt(np.pi)), "steps": 1},
            particles=[{"count": n, "position": "random", "velocity": {"temperature": 1.0}, "radius": 0.5}],
            effects={"collisions": {"passes": 50}},
        )
    )
    for _ in range(10):
        sim.step()
    assert sim.totals["collisions"] > 0 and sim.totals["missed"] == 0
    assert any("found late" in remark for remark in sim.remarks()) == some


def test_spheres_that_brush_one_another_are_told():
    """Disc 1 is turned at 0.2 and would meet 0 at 0.259, but 0 has met 3 at 0.5 in the same pass: they overlap, and part."""
    places = [[0.0, 0.0], [0.99, -0.2], [0.99, -1.4], [-0.3, sqrt(0.91) + 0.05]]
    velocities = [[0.0, 0.0], [0.0, 0.0], [0.0, 1.0], [0.0, -0.1]]
    discs = {"position": places, "velocity": velocities, "radius": 0.5}
    x, v, sim = run(dimension=2, time={"step": 0.52, "steps": 1}, particles=[discs], effects={"collisions": {}})
    apart, faster = x[1] - x[0], v[1] - v[0]
    assert apart @ apart < 0.998 and apart @ faster > 0.0
    assert sim.totals["collisions"] == 2
    assert any("found late" in remark for remark in sim.remarks())


@pytest.mark.parametrize("passes", range(1, 6))
def test_a_collision_that_the_last_wall_hit_leads_to_is_missed_not_forgotten(passes):
    """A heavy sphere drives a light one against a wall: hit after hit, of which passes put some in order."""
    light, heavy = {"position": [[0.11]], "velocity": [-1.0]}, {"position": [[0.35]], "velocity": [-4.0], "mass": 1000.0}
    sim = Simulation(
        Scene(
            dimension=1,
            box={"lower": [0.0], "upper": [2.0]},
            time={"step": 0.03, "steps": 1},
            particles=[light | {"radius": 0.1}, heavy | {"radius": 0.1}],
            effects={"collisions": {"passes": passes}, "walls": {}},
        )
    )
    sim.step()
    overlap = 0.2 - np.ptp(sim.particles.position)
    assert overlap > 1e-3 and sim.totals["missed"] == 1


@pytest.mark.parametrize(("mode", "fall", "told"), [("rewind", 8.0, True), ("rewind", 4.0, False), ("event", 8.0, False)])
def test_spheres_that_get_too_fast_for_the_step_are_told(mode, fall, told):
    """A sphere that has fallen by 5 crosses sqrt(2 g 5) h = 0.2 in a step, its diameter."""
    sim = Simulation(
        Scene(
            dimension=2,
            time={"step": 0.02, "steps": 100},
            particles=[{"position": [[0.0, 0.0], [5.0, 0.0]], "radius": 0.1}],
            effects={"uniform_gravity": {"acceleration": [0.0, -9.81]}, "collisions": {"mode": mode}},
        )
    )
    while sim.measure()["potential"] > -2.0 * 9.81 * fall:
        sim.step()
    assert any("more than their diameter in a step" in remark for remark in sim.remarks()) == told


def test_spheres_that_get_too_fast_are_told_where_others_are_added_all_the_time():
    """After an addition everything that depends on the rows is made anew, and with it what looks at the speeds now and then."""
    balls = {"position": [[0.0, 0.0], [5.0, 0.0]], "radius": 0.1}
    fall = {"uniform_gravity": {"acceleration": [0.0, -9.81]}, "collisions": {}}
    sim = Simulation(Scene(dimension=2, time={"step": 0.02, "steps": 100}, particles=[balls], effects=fall))
    for number in range(30):
        sim.steps(4)
        sim.add({"position": [[10.0 + number, 0.0]], "velocity": [0.0, 0.0], "radius": 0.1})
    assert any("more than their diameter in a step" in remark for remark in sim.remarks())


def carnahan_starling(packing: float) -> float:
    """Z by Carnahan and Starling, J. Chem. Phys. 51, 635 (1969); within 0.1 % of reference/ at this density."""
    return (1 + packing + packing**2 - packing**3) / (1 - packing) ** 3


@pytest.mark.parametrize("mode", ["rewind", "event"])
@pytest.mark.parametrize("step", [0.01, *with_all(0.003)])
def test_a_ball_among_pegs_keeps_its_energy_at_any_step(mode, step):
    """Elastic contacts with fixed spheres and walls under gravity, wherever in a step they are."""
    sim = Simulation(
        Scene(
            dimension=2,
            box={"lower": [-2, -2], "upper": [2, 8]},
            time={"step": step, "end": 10.0},
            particles=[
                {"position": [[0.0, 0.0], [1.2, 0.3], [-1.2, 0.3]], "radius": 0.5, "fixed": True},
                {"position": [[0.05, 1.5]], "radius": 0.3},
            ],
            effects={"uniform_gravity": {"acceleration": [0, -9.81]}, "walls": {}, "collisions": {"mode": mode}},
        )
    )
    start, worst = sim.measure()["total_energy"], 0.0
    while sim.steps_done < sim.scene.steps:
        sim.step()
        worst = max(worst, abs(sim.measure()["total_energy"] / start - 1.0))
    assert sim.totals["collisions"] > 15
    assert worst <= 1e-13


@pytest.mark.parametrize("more", [{}, {"friction": 0.3, "tangential_restitution": 0.5}], ids=["smooth", "rough"])
def test_a_step_that_is_done_again_in_order_of_time_leaves_no_trace(more):
    """With one pass, and contacts that take energy, nearly every step is: the bits of mode event, virials and spins too."""
    gas = {"count": 60, "position": "random", "velocity": {"temperature": 1.0}, "radius": 0.35}
    box, found = {"lower": [0.0, 0.0], "upper": [8.0, 8.0], "periodic": True}, []
    for mode in ({"passes": 1}, {"mode": "event"}):
        effects = {"collisions": {"restitution": 0.9} | more | mode}
        time, output = {"step": 0.1, "steps": 6}, {"observables": True}
        sim = Simulation(Scene(dimension=2, seed=2, box=box, time=time, particles=[gas], effects=effects, output=output))
        sim.run()
        order = np.argsort(sim.particles.id)
        found.append({name: column[order].tobytes() for name, column in sim.rows.arrays.items() if name != "contacted"})
    assert sim.totals["collisions"] > 50 and found[0] == found[1]


@pytest.mark.parametrize(("ways", "step"), [(10.0, 0.02), (8.0, 0.02), (8.0, 0.01)])
def test_a_box_that_leaves_spheres_hardly_room_is_no_hindrance(ways, step):
    """A periodic one, longer than two contact distances by some times the way of a sphere in a step: as in order of time."""
    random, length = np.random.default_rng(3), 2.0 + ways * 0.5 * step
    for _ in range(2):
        angle, place = random.uniform(0.0, 2.0 * np.pi), random.uniform(0.0, length, 2)
        velocity = 0.5 * np.array([np.cos(angle), np.sin(angle)])
        other = (place + 0.5 * length + random.uniform(-0.01, 0.01, 2)) % length
        pair = {"position": [place.tolist(), other.tolist()], "velocity": [velocity.tolist(), (-velocity).tolist()]}
        found = []
        for mode in ("rewind", "event"):
            _, _, sim = run(
                dimension=2,
                box={"lower": [0, 0], "upper": [length] * 2, "periodic": True},
                time={"step": step, "steps": 1000},
                particles=[pair | {"radius": 0.5}],
                effects={"collisions": {"mode": mode}},
            )
            assert sim.measure()["kinetic"] == pytest.approx(0.25, rel=1e-12) and sim.totals["missed"] == 0
            found.append(sim.totals["collisions"])
        assert found[0] == found[1] > 10
