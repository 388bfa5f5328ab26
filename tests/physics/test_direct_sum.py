"""The direct sum over all pairs: exact to round-off, and with the same bits however its sources are divided."""

import numpy as np
import pytest

from particles_mpi import Scene, Simulation
from particles_mpi.gravity.direct import ONE_SUM, TILE, Attraction, add_potential, in_tiles


def cloud(n, d):
    """Places and masses: a tenth without mass, some at the same place."""
    random = np.random.default_rng(n + d)
    x, mass = random.standard_normal((n, d)), random.random(n)
    mass[::10] = 0.0
    x[n // 2 : n // 2 + 5] = x[n // 2]
    return x, mass


def exact(x, mass, softening):
    """Accelerations and potentials by numpy, in extended precision."""
    r = (x[None] - x[:, None]).astype(np.longdouble)
    r2 = (r**2).sum(axis=2) + np.longdouble(softening) ** 2
    near = np.zeros_like(r2)
    np.divide(1.0, np.sqrt(r2), out=near, where=r2 > 0.0)
    pull = ((mass * near**3)[..., None] * r).sum(axis=1)
    np.fill_diagonal(near, 0.0)
    return pull, -(mass * near).sum(axis=1)


@pytest.mark.parametrize("softening", [0.0, 0.1])
@pytest.mark.parametrize("d", [1, 2, 3])
@pytest.mark.parametrize("n", [2, TILE, ONE_SUM, ONE_SUM + 1, 5 * TILE + 3])
def test_against_extended_precision(n, d, softening):
    """Within some round-offs of what acts on a target, summed without signs."""
    x, mass = cloud(n, d)
    sums, total = Attraction(x, n, softening**2), np.zeros((-(-n // TILE), TILE))
    sums.add(x, mass)
    ids = np.arange(n)
    add_potential(sums.axes, sums.at, in_tiles(ids), x, mass, ids, softening**2, total)
    pull, potential = exact(x, mass, softening)
    strongest = np.sqrt((pull**2).sum(axis=1)).max()
    assert np.abs(sums.accelerations() - pull).max() <= 1e-14 * strongest
    assert np.abs(total.reshape(-1)[:n] - potential).max() <= 1e-14 * np.abs(potential).max()


@pytest.mark.parametrize("d", [1, 2, 3, 4])
@pytest.mark.parametrize("n", [ONE_SUM + 1, 6 * TILE, 6 * TILE + 5])
def test_same_bits_however_sources_are_divided(n, d):
    """All at once; in blocks; and the targets of a rank, which are sources too, in the midst of others, in several calls."""
    x, mass = cloud(n, d)
    together = Attraction(x, n, 0.0)
    together.add(x, mass)
    whole = together.accelerations()

    divided = Attraction(x, n, 0.0)
    for first, last in ((0, 3), (3, 3), (3, TILE + 7), (TILE + 7, n)):
        divided.add(x[first:last], mass[first:last])
    assert divided.accelerations().tobytes() == whole.tobytes()

    for begin, end in ((0, n), (0, TILE + 11), (13, n - 9), (n - TILE, n), (5, 6)):
        own = slice(begin, end)
        sums = Attraction(x[own], n, 0.0)
        sums.add(x[:begin], mass[:begin])
        middle = min(2, len(sums.at))
        for first, last in ((0, middle), (middle, len(sums.at))):
            if last > first:
                sums.add_one_another(mass[own], first, last)
        sums.add(x[end:], mass[end:])
        assert sums.accelerations().tobytes() == whole[own].tobytes()


def test_each_of_a_pair_is_pulled_as_strongly():
    """So the momentum of all is kept to round-off, with masses over twelve orders of magnitude."""
    n = 400
    random = np.random.default_rng(1)
    x, mass = random.standard_normal((n, 3)), 10.0 ** random.uniform(-6.0, 6.0, n)
    sums = Attraction(x, n, 0.0)
    sums.add_one_another(mass, 0, len(sums.at))
    force = mass[:, None] * sums.accelerations()
    assert np.abs(force.sum(axis=0)).max() <= 1e-14 * np.abs(force).sum()


def test_a_particle_less_changes_from_many_to_few():
    """A simulation in which particles were removed has the bits of a new one of those that are left, on both sides of ONE_SUM."""
    x, mass = cloud(ONE_SUM + 2, 3)
    scene = {
        "dimension": 3,
        "G": 1.0,
        "time": {"step": 1e-3, "steps": 10},
        "effects": {"mutual_gravity": {"softening": 0.1}},
        "particles": [{"position": x.tolist(), "mass": mass.tolist()}],
    }
    sim = Simulation(Scene.from_dict(scene))
    for left in (ONE_SUM + 1, ONE_SUM):
        sim.remove([int(sim.particles.id.max())])
        new = Simulation(sim.scene, start=sim.rows.select(np.argsort(sim.rows.id)))
        sim.step()
        new.step()
        assert len(sim.rows) == left
        order = np.argsort(sim.rows.id)
        assert sim.rows.position[order].tobytes() == new.rows.position[np.argsort(new.rows.id)].tobytes()
