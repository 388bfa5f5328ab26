"""Nearest images: the three forms agree to the bit, and places come back into the box."""

import numpy as np
import pytest

from particles_mpi.kernels.geometry import boxes_per_length, image_shift, image_shifts, nearest, some_nearest, wrap

LENGTHS = 0.0, 1.0, 0.3, 7.1


@pytest.mark.parametrize("length", LENGTHS)
def test_all_forms_of_the_nearest_image_are_the_same_bits(length):
    random = np.random.default_rng(1)
    near = np.concatenate([(random.random(2000) - 0.5) * 2.9 * length, [0.0, 0.5 * length, -0.5 * length, length, -length]])
    far = (random.random(2000) - 0.5) * 100.0
    shifts = image_shifts(far, length)
    assert np.array_equal(shifts, [image_shift(r, length) for r in far])
    if length:
        assert (np.abs(far - shifts) <= 0.5 * length * (1.0 + 1e-12)).all()
    else:
        assert not shifts.any()
    assert np.array_equal(near - image_shifts(near, length), [nearest(r, length) for r in near])
    per_length = boxes_per_length(np.array([length]))[0]
    screened = np.array([some_nearest(r, length, per_length) for r in far])
    same_image = np.abs(np.abs(far - shifts) - 0.5 * length) > 1e-12 * np.abs(far)
    assert np.allclose(screened[same_image], (far - shifts)[same_image], rtol=0.0, atol=1e-12)


def test_shifts_of_vectors_leave_open_axes_alone():
    r, length = np.array([[2.6, 2.6], [-0.6, 100.0]]), np.array([1.0, 0.0])
    assert np.array_equal(image_shifts(r, length), [[3.0, 0.0], [-1.0, 0.0]])


def test_places_come_back_into_the_box():
    lower, upper = np.array([-1.0, 0.0]), np.array([1.0, 1.0])
    x = np.array([[1.0, 5.0], [-1.0 - 1e-17, -3.0], [np.nextafter(-1.0, -2.0), 0.5], [7.5, 0.5]])
    wrap(x, lower, upper, np.array([2.0, 0.0]))
    assert ((x[:, 0] >= -1.0) & (x[:, 0] < 1.0)).all()
    assert x[3, 0] == -0.5
    assert x[:, 1].tolist() == [5.0, -3.0, 0.5, 0.5]
