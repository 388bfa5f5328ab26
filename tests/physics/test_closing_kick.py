"""The energy of elastic bounces stays as it is, however many there are, where forces depend on the place."""

import numpy as np
import pytest
from with_all import with_all

from particles_mpi import Scene, Simulation


def body(*places, **more):
    """A table of particles of mass 1, at rest if nothing else is given."""
    return {"position": [list(place) for place in places], "mass": 1.0} | more


FALLING = {"velocity": [0.0, 0.1], "radius": 0.3}  # onto what lies to its left, past its middle
FLOOR = {"planes": [{"point": [-0.2, 0.0], "normal": [1.0, 0.1]}, {"point": [5.0, 0.0], "normal": [-1.0, 0.0]}]}
# particles, walls, and by how much the energy may be off: at most half of what it is without the closing kick, mostly a fifth
BOUNCES = {
    "of two": ([body((-1.0, 0.0), velocity=[0.0, -0.1], radius=0.3), body((1.0, 0.0), **FALLING)], None, 2.5e-3),
    "of a light one": ([body((-1.0, 0.0), radius=0.3), body((1.0, 0.0), **FALLING | {"mass": 0.1})], None, 1e-4),
    "off a fixed one": ([body((-1.0, 0.0), fixed=True, radius=0.3), body((1.0, 0.0), **FALLING)], None, 6e-4),
    "off a wall": ([body((-1.0, 0.0), fixed=True), body((1.0, 0.0), **FALLING)], FLOOR, 6e-5),
    "on a line": ([body((-1.0,), (1.0,), radius=0.2), body((2.0,), velocity=[-0.3], radius=0.1)], None, 0.1),
}
CASES = [
    *((name, "rewind") for name in BOUNCES),
    ("off a fixed one", "event"),
    ("off a wall", None),
    *with_all(*((name, "event") for name in BOUNCES if name != "off a fixed one")),
]


@pytest.mark.parametrize(("name", "mode"), CASES)
def test_energy_does_not_drift(name, mode):
    """Twenty bounces, and more than a hundred on a line; without collisions, many steps are computed at once."""
    particles, walls, bound = BOUNCES[name]
    effects = {"mutual_gravity": {"softening": 0.05}} | ({"walls": walls} if walls else {})
    effects |= {"collisions": {"mode": mode}} if mode else {}
    d = len(particles[0]["position"][0])
    time = {"step": 0.01, "steps": 10_000}
    sim = Simulation(Scene.from_dict({"dimension": d, "G": 1.0, "time": time, "particles": particles, "effects": effects}))
    assert bool(sim.many_steps) == (mode is None)
    energies, momenta = [], []
    for _ in range(41):
        measured, p = sim.measure(), sim.particles
        energies.append(measured["kinetic"] + measured["potential"])
        momenta.append((p.mass[:, None] * p.velocity).sum(axis=0))
        sim.steps(250)
    assert sim.totals["collisions"] + sim.totals["wall_hits"] > 15
    np.testing.assert_allclose(energies, energies[0], rtol=0.0, atol=bound)
    if not walls and not sim.particles.fixed.any():
        np.testing.assert_allclose(momenta, [momenta[0]] * 41, rtol=0.0, atol=1e-13)


def test_a_step_that_ends_with_its_first_moment():
    """Spheres that touch and approach meet at once; a drift in no time gives nothing to a closing kick."""
    touching = [body((0.0, 0.0), (2.0, 0.0), velocity=[[1.0, 0.0], [-1.0, 0.0]], radius=1.0)]
    effects = {"mutual_gravity": {}, "collisions": {"mode": "event"}}
    tables = {"dimension": 2, "G": 1.0, "time": {"step": 0.01, "steps": 1}, "particles": touching, "effects": effects}
    sim = Simulation(Scene.from_dict(tables))
    assert sim.step_to_collision() == (0, 1)
    assert sim.time == 0.0
    np.testing.assert_array_equal(sim.particles.velocity, [[-1.0, 0.0], [1.0, 0.0]])
