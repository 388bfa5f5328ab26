"""The particles at one time, as a file has them or a simulation that is shown."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from particles_mpi.particles import Array, as_shown


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
        if name in self.fields:
            values = self._read(name)
        elif name == "fixed":  # stored only if a particle is
            values = np.zeros(self.count, np.uint8)
        else:
            raise AttributeError(f"frame {self.index} has no field {name!r}; stored are {', '.join(self.fields)}")
        vars(self)[name] = shown = as_shown(name, values)
        return shown

    def __getitem__(self, name: str) -> Array:
        if name not in self.fields and name != "fixed":
            raise KeyError(f"frame {self.index} has no field {name!r}; stored are {', '.join(self.fields)}")
        values: Array = getattr(self, name)
        return values

    @property
    def speed(self) -> Array:
        """Lengths of the velocities, (N,)."""
        speed: Array = np.linalg.norm(self.velocity, axis=1)
        return speed

    def __repr__(self) -> str:
        return f"Frame({self.index}: t = {self.time:g}, {self.count} particles; {', '.join(self.fields)})"
