"""Spheres that fill a box exactly, with no room to move: they meet one another and the walls without end, in no time.

Real gaps of such scenes are round-off. Nothing may run for ever, overlap, leave the box, or lose energy that it should keep.
And clusters of spheres that stick together, which meet as often.
"""

import itertools

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from particles_mpi import Scene, Simulation

R = 0.2
GRAVITY = {"uniform_gravity": {"acceleration": [0.0, -9.81]}}


def full_box(d, n, mode, e, friction=0.0, forces=None):
    """n^d spheres of radius R that touch one another and the walls, thrown in all directions."""
    surface = {"restitution": e} | ({"friction": friction} if friction else {})
    places = [[R + 2.0 * R * k for k in cell] for cell in itertools.product(range(n), repeat=d)]
    return Simulation(
        Scene(
            dimension=d,
            seed=1,
            box={"lower": [0.0] * d, "upper": [2.0 * R * n] * d},
            time={"step": 0.01, "steps": 20},
            particles=[{"position": places, "radius": R, "mass": {"min": 1.0, "max": 2.0}, "velocity": {"speed": 1.0}}],
            effects={"collisions": {"mode": mode} | surface, "walls": surface} | (forces or {}),
        )
    )


def assert_in_place(sim, n, within=1e-12):
    """No sphere overlaps another one or a wall."""
    x = sim.particles.position
    assert pdist(x).min() >= 2.0 * R - within
    assert x.min() >= R - within and x.max() <= (2.0 * n - 1.0) * R + within


@pytest.mark.parametrize(("d", "n", "friction"), [(1, 4, 0.0), (2, 3, 0.0), (3, 2, 0.0), (2, 3, 0.5), (3, 2, 0.5)])
def test_elastic_spheres_without_room_stay_where_they_are(d, n, friction):
    """Smooth ones keep the energy to the round-off of 50 000 contacts; each has a thousand contacts a step that get nowhere."""
    sim = full_box(d, n, "event", 1.0, friction)
    energy = sim.measure()["kinetic"]
    for _ in range(20):
        before = sim.totals["collisions"] + sim.totals["wall_hits"]
        sim.step()
        assert sim.totals["collisions"] + sim.totals["wall_hits"] - before <= 1100 * n**d
        assert_in_place(sim, n)
    now = sim.measure()["kinetic"]
    assert now <= energy * (1.0 + 1e-10)
    if not friction:
        assert now == pytest.approx(energy, rel=1e-10)


def test_a_full_box_whose_contacts_are_not_kept_ends_its_step():
    """With `taylor`, which keeps none: one step took more than a minute."""
    places = [[R + 2.0 * R * k for k in cell] for cell in itertools.product(range(3), repeat=2)]
    discs = {"position": places, "radius": R, "mass": {"min": 0.1, "max": 5.0}, "velocity": [-0.143, -0.58]}
    discs["acceleration"] = [[float(k), float(-k)] for k in range(9)]
    box = {"lower": [0.0, 0.0], "upper": [6.0 * R, 6.0 * R], "periodic": True}
    effects = {"user_acceleration": {}, "collisions": {"mode": "event", "restitution": 0.3}}
    time = {"step": 0.003, "steps": 2, "integrator": "taylor"}
    sim = Simulation(Scene(dimension=2, seed=995, box=box, time=time, particles=[discs], effects=effects))
    sim.steps(2)
    assert sim.totals["collisions"] <= 2 * 15_000 * 9 and sim.totals["missed"] > 0


@pytest.mark.parametrize(("mode", "friction"), [("event", 0.0), ("rewind", 0.1)])
@pytest.mark.parametrize("n", [3, 6])
def test_what_friction_presses_together_without_room_ends_its_step(n, mode, friction):
    """Discs fly side by side, and `friction` slows light ones more. There were up to a million contacts of each in a step."""
    places = [[R + 2.0 * R * k for k in cell] for cell in itertools.product(range(n), repeat=2)]
    sim = Simulation(
        Scene(
            dimension=2,
            seed=995,
            box={"lower": [0.0, 0.0], "upper": [2.0 * R * n] * 2, "periodic": True},
            time={"step": 0.003, "steps": 3},
            particles=[{"position": places, "radius": R, "mass": {"min": 0.1, "max": 5.0}, "velocity": [-0.143, -0.58]}],
            effects={"friction": {"strength": 0.5}, "collisions": {"mode": mode, "restitution": 0.3, "friction": friction}},
        )
    )
    energy = sim.measure()["kinetic"]
    for _ in range(3):
        before = sim.totals["collisions"]
        sim.step()
        assert sim.totals["collisions"] - before <= 15_000 * n**2
    assert sim.measure()["kinetic"] < energy and sim.totals["missed"] > 0 and "had no room" in " ".join(sim.remarks())


@pytest.mark.parametrize("e", [0.0, 0.5])
@pytest.mark.parametrize(("d", "n"), [(1, 4), (2, 3), (3, 2)])
def test_lossy_spheres_without_room_lose_energy(d, n, e):
    sim = full_box(d, n, "event", e)
    energy = [sim.measure()["kinetic"]]
    for _ in range(20):
        sim.step()
        assert_in_place(sim, n)
        energy.append(sim.measure()["kinetic"])
    assert (np.diff(energy) <= 1e-12 * energy[0]).all() and energy[-1] < 0.5 * energy[0]


@pytest.mark.parametrize("friction", [0.0, 0.5])
@pytest.mark.parametrize("mode", ["rewind", "event"])
@pytest.mark.parametrize("e", [0.0, 0.5])
@pytest.mark.parametrize("n", [3, 16])
def test_a_full_box_under_gravity_comes_to_rest(n, mode, e, friction):
    """Also where so many keep a gap elsewhere, for which here is no room."""
    sim = full_box(2, n, mode, e, friction, GRAVITY)
    for _ in range(20):
        sim.step()
        assert_in_place(sim, n, within=1e-3 * R)
    assert sim.measure()["kinetic"] < 1e-20 and sim.totals["unconverged"] == 0


@pytest.mark.parametrize("mode", ["event", "rewind"])
@pytest.mark.parametrize("surface", [{"restitution": 0.95}, {"restitution": 0.5, "friction": 0.3}])
@pytest.mark.parametrize(("across", "up"), [(3, 3), (10, 12)])
def test_what_fills_a_box_from_side_to_side_has_thousands_of_contacts_not_millions(across, up, surface, mode):
    """Gravity leans to one side, and there is room above: nine discs had eight million collisions in a step."""
    places = [[R + 2.0 * R * i, R + 2.0 * R * k] for i in range(across) for k in range(up)]
    scene = Scene(
        dimension=2,
        seed=1,
        box={"lower": [0.0, 0.0], "upper": [2.0 * R * across, 2.0 * R * up + 1.0]},
        time={"step": 0.01, "steps": 3},
        particles=[{"position": places, "radius": R, "velocity": {"temperature": 4.0}}],
        effects={"collisions": {"mode": mode, **surface}, "walls": surface, "uniform_gravity": {"acceleration": [1.0, -10.0]}},
    )
    sim, energy = Simulation(scene), []
    for _ in range(3):
        sim.step()
        energy.append(sim.measure()["total_energy"])
    contacts = sim.totals["collisions"] + sim.totals["wall_hits"]
    assert contacts < 3 * 3200 * len(places)  # in a step at most MOST_QUICK each, and few others
    assert all(after <= before + 1e-3 for before, after in itertools.pairwise(energy))  # 0.1 m (g h)^2
    x = sim.particles.position
    assert pdist(x).min() > 2.0 * R * (1.0 - 1e-9) and (x > R * (1.0 - 1e-9)).all()


def test_a_sphere_that_comes_to_a_jam_does_not_enter_it():
    """Four spheres fill the ground of a box; a fifth one is thrown at them, and leaves again with the energy that there is."""
    places = [[R + 2.0 * R * k, R] for k in range(4)]
    sim = Simulation(
        Scene(
            dimension=2,
            box={"lower": [0.0, 0.0], "upper": [8.0 * R, 4.0]},
            time={"step": 0.05, "steps": 200},
            particles=[
                {"position": places, "radius": R, "velocity": [[1.0, -0.3], [-0.5, -1.0], [0.8, -0.1], [-1.0, -0.7]]},
                {"position": [[0.9, 2.0]], "radius": R, "velocity": [0.0, -3.0]},
            ],
            effects={"collisions": {"mode": "event"}, "walls": {}},
        )
    )
    energy, highest = sim.measure()["kinetic"], []
    for _ in range(200):
        sim.step()
        x = sim.particles.position
        assert pdist(x).min() >= 2.0 * R - 1e-12 and (x >= R - 1e-12).all()
        highest.append(x[4, 1])
    assert min(highest) < 3.2 * R and max(highest[highest.index(min(highest)) :]) > 1.0
    assert sim.measure()["kinetic"] == pytest.approx(energy, rel=1e-10)


@pytest.mark.parametrize("e", [0.0, 0.3])
@pytest.mark.parametrize(("d", "n", "side"), [(1, 20, 16.0), (2, 64, 4.0), (3, 125, 3.0)])
def test_clusters_that_stick_together_are_in_order_without_forces_too(d, n, side, e):
    """A gas that cools in mode rewind: passes do not suffice for clusters, whose steps are done in order of time."""
    sim = Simulation(
        Scene(
            dimension=d,
            seed=3,
            box={"lower": [0.0] * d, "upper": [side] * d, "periodic": True},
            time={"step": 0.02, "steps": 300},
            particles=[{"count": n, "position": "lattice", "radius": 0.15, "velocity": {"temperature": 1.0}}],
            effects={"collisions": {"mode": "rewind", "restitution": e}},
        )
    )
    momentum = sim.particles.velocity.sum(axis=0)
    deepest = 0.0
    for _ in range(300):
        sim.step()
        x = sim.particles.position
        apart = x[:, None] - x[None]
        apart -= side * np.round(apart / side)
        distance = np.sqrt((apart**2).sum(axis=-1))[np.triu_indices(n, 1)]
        deepest = max(deepest, 0.3 - distance.min())
    assert sim.totals["missed"] == 0 and deepest < 0.01 * 0.15
    np.testing.assert_allclose(sim.particles.velocity.sum(axis=0), momentum, atol=1e-12)
