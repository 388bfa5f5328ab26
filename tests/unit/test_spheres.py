"""The painter of spheres: areas, hiding and the mean of samples are right."""

import sys

import numpy as np
import pytest
from conftest import ROOT

sys.path.insert(0, str(ROOT / "python_viz"))
from spheres import paint_spheres


def painted(center, radius, depth, rgb, outlined=None):
    center, radius, depth, rgb = (np.array(a, float) for a in (center, radius, depth, rgb))
    return paint_spheres(center, radius, depth, 0.1 * radius, rgb, np.array(outlined or [False] * len(radius)), 100, 80)


def test_the_area_is_that_of_the_disc_wherever_it_is():
    for center in ([50.0, 40.0], [33.3, 21.7], [70.1, 50.9]):
        image = painted([center], [12.3], [5.0], [[1.0, 0.0, 0.0]])
        assert image.shape == (80, 100, 4) and image[..., 3].sum() == pytest.approx(np.pi * 12.3**2, rel=0.005)
        middle = (image[..., 3][..., None] * np.stack(np.meshgrid(np.arange(100), np.arange(80)), axis=2)).sum(axis=(0, 1))
        assert middle / image[..., 3].sum() + 0.5 == pytest.approx(center, abs=0.05)
    assert painted([[0.0, 0.0]], [10.0], [5.0], [[1, 0, 0]])[..., 3].sum() == pytest.approx(np.pi * 25, rel=0.01)


def test_the_nearer_one_is_seen_whatever_the_order():
    two = [[50, 40], [55, 40]], [10, 10], [5.0, 4.0], [[1, 0, 0], [0, 0, 1]]
    image = painted(*two)
    assert image[40, 55, 2] > image[40, 55, 0] and image[40, 42, 0] > image[40, 42, 2]
    assert (painted(*(column[::-1] for column in two)) == image).all()


def test_a_fixed_one_has_a_dark_rim_and_colours_stay_colours():
    image = painted([[30, 40], [70, 40]], [15, 15], [5, 5], [[0.2, 0.9, 0.4]] * 2, [True, False])
    assert image[40, 15, :3].max() < 0.1 < image[40, 55, 1] and image.min() >= 0 and image.max() <= 1
