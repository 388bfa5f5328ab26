"""Periodic boxes: nearest images of distances, and places brought back into the box. Scalars and arrays only.

`length` is the box length of a periodic axis, and 0 of any other, whose coordinates then stay as they are. A distance has one
component an axis, and each takes the nearest image by itself. Of the forms below `nearest` is the fast one, for two places in
the box; `image_shift` and its copy for whole arrays, `image_shifts`, are right for any number of boxes between them, and
`some_nearest` is too where exactness does not matter.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from particles_mpi.kernels.jit import lean_in_place, lean_inner, screening


class Box(NamedTuple):
    """A box: corners `lower`, `upper` (d,), infinite where it is open; `length` (d,), upper - lower on periodic axes, else 0."""

    lower: NDArray[Any]
    upper: NDArray[Any]
    length: NDArray[Any]


@lean_inner
def nearest(r, length):
    """The component r of a distance, by the nearest periodic image; r is at most 1.5 lengths long."""
    if length > 0.0:
        if r > 0.5 * length:
            r -= length
        elif r < -0.5 * length:
            r += length
    return r


@lean_inner
def image_shift(r, length):
    """What to take from the component r of a distance to get the nearest periodic image, however many boxes away."""
    return length * np.rint(r / length) if abs(r) > 0.5 * length > 0.0 else 0.0


@screening
def some_nearest(r, length, boxes_per_length):
    """The component r by the nearest periodic image, however many boxes away; at half a box round-off decides which. No branch.

    For tests that only screen, several at once; `boxes_per_length`: the function of this name, of `length`.
    """
    return r - length * np.rint(r * boxes_per_length)


def boxes_per_length(length: NDArray[Any]) -> NDArray[Any]:
    """Boxes in a unit of length, 1/length, for box lengths (d,); 0 on axes that are not periodic."""
    return np.divide(1.0, length, out=np.zeros_like(length), where=length > 0.0)


def image_shifts(r: NDArray[Any], length: NDArray[Any] | float) -> NDArray[Any]:
    """`image_shift` for arrays: distances r (..., d), lengths (d,) or one for all axes. Shape of r."""
    return length * np.rint(np.divide(r, length, out=np.zeros_like(r), where=np.greater(length, 0.0)))


@lean_inner
def into_box(y, lower, upper, length):
    """The coordinate y, which is outside of [lower, upper), inside, `length` > 0 being that of the periodic axis."""
    y = lower + (y - lower) % length
    return y if y < upper else lower


@lean_in_place
def wrap(x, lower, upper, length):
    """Places back into [lower, upper) on the periodic axes, in place on x (n, d)."""
    for k in range(x.shape[1]):
        if length[k] > 0.0:
            for i in range(x.shape[0]):
                if x[i, k] < lower[k] or x[i, k] >= upper[k]:
                    x[i, k] = into_box(x[i, k], lower[k], upper[k], length[k])
