"""Arrays whose rows begin where lines of the cache do, and larger arrays in the place of smaller ones."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

LINE = 8  # float64 in a line of the cache, of 64 bytes


def aligned(rows: int, width: int) -> NDArray[Any]:
    """Room for rows of float64; those of a multiple of LINE numbers all begin with a line of the cache."""
    room = np.empty(rows * width + LINE)
    first = -room.ctypes.data // 8 % LINE
    return room[first : first + rows * width].reshape(rows, width)


def whole_lines(width: int) -> int:
    """The least multiple of LINE that is not below `width`."""
    return -(-width // LINE) * LINE


def doubled(bundle: Any, *names: str) -> Any:
    """The bundle with twice as many rows in the arrays of these names; the new ones are 0."""
    arrays = {name: getattr(bundle, name) for name in names}
    return bundle._replace(**{name: np.concatenate((old, np.zeros_like(old))) for name, old in arrays.items()})


def enlarged(old: NDArray[Any], new: NDArray[Any]) -> NDArray[Any]:
    """The new array, with the rows of the old one in front."""
    new[: len(old)] = old
    return new
