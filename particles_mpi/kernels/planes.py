"""Walls as arrays, for the kernels that need to know where they are."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class Planes(NamedTuple):
    """Walls as arrays. A particle whose drift ends between the faces met none of them, so most need no further test."""

    point: NDArray[Any]  # (w, d)
    normal: NDArray[Any]  # (w, d)
    restitution: NDArray[Any]  # (w,) as in `law.Loss`
    velocity_factor: NDArray[Any]  # (w,)
    lower: NDArray[Any]  # (d,) innermost faces normal to an axis, -inf and inf where there are none
    upper: NDArray[Any]
    oblique: bool  # are there other planes too?

    @property
    def lossy(self) -> NDArray[Any]:
        """Which of them take energy, (w,)."""
        return (self.restitution < 1.0) | (self.velocity_factor < 1.0)


def no_planes(dimension: int) -> Planes:
    """No walls at all, for kernels that always take some."""
    none, open_ = np.empty(0), np.full(dimension, np.inf)
    return Planes(np.empty((0, dimension)), np.empty((0, dimension)), none, none, -open_, open_, False)
