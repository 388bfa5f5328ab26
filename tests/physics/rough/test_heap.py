"""The slope of a heap of rough spheres, against LAMMPS; and the measure of the slope, against heaps of known shape."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from heap import HALF_LENGTH, WIDTH, scene, slope, start, surface

from particles_mpi import Scene, Simulation

OF_THE_MEASURE = pytest.mark.slow  # no change of the program can make these fail: they go with the heaps below
REFERENCE = np.genfromtxt(Path(__file__).parent / "reference" / "heap.csv", delimiter=",", names=True, skip_header=4)


@OF_THE_MEASURE
def test_start():
    """The same for the same seed, nobody overlaps, and 2000 are free."""
    one, other = start(3), start(3)
    assert all((a == b).all() for a, b in zip(one, other, strict=True))
    assert (~one.fixed).sum() == 2000 and not (start(4).position == one.position).all()
    apart = one.position[:, None] - one.position[None]
    apart[..., 1] -= WIDTH * np.rint(apart[..., 1] / WIDTH)
    gap = np.linalg.norm(apart, axis=-1) - one.radius[:, None] - one.radius[None]
    np.fill_diagonal(gap, 1.0)
    assert gap.min() > 0.0


@OF_THE_MEASURE
def test_surface_of_one_sphere():
    """The mean height of a sphere's upper half over the disc below it is 2/3 R."""
    x, height = surface(np.array([[0.3, 0.1, 0.0]]), np.array([2.0]), cell=0.02)
    assert height.mean() * 2.0 * HALF_LENGTH * WIDTH == pytest.approx(2.0 / 3.0 * np.pi * 2.0**3, rel=1e-3)
    assert (height[np.abs(x - 0.3) > 2.0] == 0.0).all()


@OF_THE_MEASURE
@pytest.mark.parametrize("degrees", [10.0, 20.0, 30.0])
def test_slope_of_a_wedge(degrees):
    """Small spheres side by side below a wedge's two planes: both angles within half a degree."""
    bare = start(1)
    lean, radius = np.radians(degrees), 0.2
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, 161) * (HALF_LENGTH - 0.05), np.arange(0.0, WIDTH, WIDTH / 80), indexing="ij")
    z = 0.5 + (HALF_LENGTH - np.abs(x)) * np.tan(lean) - radius / np.cos(lean)
    skin = np.column_stack((x.ravel(), y.ravel(), z.ravel()))
    position = np.concatenate((bare.position[bare.fixed], skin))
    found = slope(position, np.concatenate((bare.radius[bare.fixed], np.full(len(skin), radius))))
    assert found.angle == pytest.approx(degrees, abs=0.5)
    assert found.by_volume == pytest.approx(degrees, abs=0.5)
    assert found.spheres == len(skin)


@OF_THE_MEASURE
def test_reference_rises_with_friction():
    """Each step of mu is worth more than three standard errors of the means; the first one more than the scatter of the seeds."""
    heaps = [REFERENCE[REFERENCE["mu"] == mu]["angle"] for mu in (0.1, 0.3, 0.5)]
    for lower, higher in pairwise(heaps):
        error = np.hypot(*(some.std(ddof=1) / np.sqrt(len(some)) for some in (lower, higher)))
        assert higher.mean() - lower.mean() > 3.0 * error
    assert heaps[0].max() < heaps[1].min()


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("mu", [0.1, 0.3, 0.5])
def test_angle_of_repose(mu):
    """One seed against the mean of LAMMPS: the slope within 3 degrees, or three standard errors of that mean, for single heaps
    scatter by 0.5 to 1 about theirs; the wedge of the same volume, which scatters less, within 1.5 degrees. What is left on the
    strip is at rest. Means of several heaps are within 1.4 degrees: tests/README.md."""
    sim = Simulation(Scene.from_dict(scene(1, mu)))
    sim.run()
    rows = np.argsort(sim.particles.id)
    ours = slope(sim.particles.position[rows], sim.particles.radius[rows])
    on_strip = (sim.particles.position[:, 2] > -1.0) & (np.abs(sim.particles.position[:, 0]) < HALF_LENGTH)
    assert np.sqrt((sim.particles.velocity[on_strip] ** 2).sum(axis=1).mean()) < 0.1
    theirs = REFERENCE[REFERENCE["mu"] == mu]
    for name, least in (("angle", 3.0), ("by_volume", 1.5)):
        error = theirs[name].std(ddof=1) / np.sqrt(len(theirs))
        assert getattr(ours, name) == pytest.approx(theirs[name].mean(), abs=max(least, 3.0 * error)), name
