"""The particles at one time, as a file has them or a simulation that is shown."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import prod

import numpy as np

from particles_mpi.particles import Array, as_shown


def one_number_each(values: Array) -> Array:
    """Return one number (N,) for each row of values (N, ...): a single component with its sign, or the length of the vector."""
    rows = values.reshape(len(values), prod(values.shape[1:])).astype(float, copy=False)
    numbers: Array = rows[:, 0] if rows.shape[1] == 1 else np.linalg.norm(rows, axis=1)
    return numbers


class Frame:
    """The N particles at one time, in the order of their ids: `frame.position` (N, d), `frame.velocity`, `frame.mass` (N,).

    index: number of the frame; time; step: of the run; fields: names of all that there is. A field is read when it is asked for,
    as `frame.mass` or `frame["mass"]`.
    """

    def __init__(self, index: int, time: float, step: int, count: int, fields: Sequence[str], read: Callable[[str], Array]):
        self.index, self.time, self.step, self.count = index, time, step, count
        self.fields, self._read = tuple(fields), read

    def __len__(self) -> int:
        return self.count

    def __getattr__(self, name: str) -> Array:
        if name.startswith("_"):
            raise AttributeError(name)
        try:
            return self[name]
        except KeyError as error:
            raise AttributeError(*error.args) from None

    def __getitem__(self, name: str) -> Array:
        if name not in (*self.fields, "fixed"):  # the latter is stored only if a particle is
            raise KeyError(f"frame {self.index} has no field {name!r}; stored are {', '.join(self.fields)}")
        if name not in vars(self):
            stored = self._read(name) if name in self.fields else np.zeros(self.count, np.uint8)
            vars(self)[name] = as_shown(name, stored)
        values: Array = vars(self)[name]
        return values

    def __dir__(self) -> list[str]:
        """The fields too, for completion in a notebook."""
        return [*super().__dir__(), *self.fields, "fixed"]

    @property
    def speed(self) -> Array:
        """Lengths of the velocities, (N,)."""
        speed: Array = np.linalg.norm(self.velocity, axis=1)
        return speed

    def __repr__(self) -> str:
        return f"Frame({self.index}: t = {self.time:g}, {self.count} particles; {', '.join(self.fields)})"
