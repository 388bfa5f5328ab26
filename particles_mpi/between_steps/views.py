"""What a user sees of the particles of a rank between two steps.

A user gets copies of the arrays of `Particles`. At the beginning of the next step each copy is compared with the original, and
taken over if a bit differs. No copies are made of fields that the user does not read.
"""

import weakref
import zlib
from collections.abc import Callable, Mapping

import numpy as np

from particles_mpi.errors import StateError
from particles_mpi.particles import Array, Particles, as_shown, moment_of_sphere, same_bits

READ_ONLY = ("id", "rate", "total_acceleration", "free_acceleration")
GUARDED = 8  # arrays of earlier steps that are checked, in case the user writes into them


class ParticleView:
    """`view.position[i]`, `view["charge"]`, `len(view)`: the rows of this rank; `view.id[i]` tells which particle row i is.

    A user may change every field but `id` and those that each step computes anew: `view.velocity *= -1`, `view.mass[3] = 2.0`.
    The change counts from the next step on. After that step the array can only be read, and the field must be read again from the
    view; writing into a part of the old array that was kept raises StateError. `view.arrays` holds all fields, read-only.
    """

    _rows: Particles
    _check: Callable[[dict[str, Array]], None]
    _copies: dict[str, Array]
    _shown: dict[str, Array]  # views of the copies, so that a copy is known to be held by the user if it outlives its view
    _open: bool  # may the user change the state? Not within a step
    _earlier: list[tuple[str, weakref.ref[Array], int]]  # copies of earlier steps that the user holds, and their CRC-32

    def __init__(self, rows: Particles, check: Callable[[dict[str, Array]], None]):
        """`rows`: the particles shown; `check` raises an error for values (by name of the field) that cannot be used."""
        vars(self).update(_rows=rows, _check=check, _copies={}, _shown={}, _open=True, _earlier=[])

    def __len__(self) -> int:
        return len(self._rows)

    def __getattr__(self, name: str) -> Array:
        if name.startswith("_") or name not in self._rows.arrays:
            raise AttributeError(f"these particles have no field {name!r}")
        if not self._open:
            return read_only(as_shown(name, self._rows.arrays[name]))
        if name not in self._shown:
            self._copies[name] = self._rows.arrays[name].copy()
            self._shown[name] = as_shown(name, self._copies[name])
            self._shown[name].flags.writeable = name not in READ_ONLY
        return self._shown[name]

    def __setattr__(self, name: str, value: Array) -> None:
        if hasattr(type(self), name) or name.startswith("_"):
            raise AttributeError(f"{name} is not a field: it cannot be set")
        shown = getattr(self, name)  # an unknown name is an error: data of one's own come by `attach`
        if value is not shown:
            shown[...] = value

    def __getitem__(self, name: str) -> Array:
        try:
            return self.__getattr__(name)
        except AttributeError:
            raise KeyError(name) from None

    def __setitem__(self, name: str, value: Array) -> None:
        setattr(self, name, value)

    def __repr__(self) -> str:
        return repr(self._rows)

    @property
    def dimension(self) -> int:
        return self._rows.dimension

    @property
    def inverse_mass(self) -> Array:
        """1/m, and 0 for fixed particles; (n,)."""
        self.collect()
        return read_only(self._rows.inverse_mass)

    @property
    def arrays(self) -> dict[str, Array]:
        """All fields by name, as they are held, to read only."""
        self.collect()
        return {name: read_only(array[:]) for name, array in self._rows.arrays.items()}

    def select(self, rows: Array) -> Particles:
        """A copy of the rows (indices), in that order."""
        self.collect()
        return self._rows.select(rows)

    def collect(self) -> None:
        """Take over what the user wrote since the last call. The copies then hold the values of the state."""
        held = self._rows.arrays
        changed = {name: copy for name, copy in self._copies.items() if not same_bits(copy, held[name])}
        if changed:
            self._check(changed)
            self._rows.change(moments_with(self._rows, changed) | changed)
            self.show()

    def show(self) -> None:
        """Copy the fields of the state into the arrays that the user has."""
        for name, copy in self._copies.items():
            copy[...] = self._rows.arrays[name]

    def forget(self, name: str) -> None:
        """Make the arrays of this field that the user has read-only, because they are out of date."""
        for arrays in (self._copies, self._shown):
            if name in arrays:
                arrays.pop(name).flags.writeable = False

    def open(self) -> None:
        """Let the user change the state from now on."""
        vars(self)["_open"] = True

    def close(self) -> None:
        """End the time in which the user may change the state: until `open`, fields can only be read.

        Arrays that the user has become those of an earlier step, and read-only. Raises StateError if one of an earlier step was
        written to nevertheless.
        """
        vars(self)["_open"] = False
        if not self._copies and not self._earlier:
            return
        for name, reference, crc in self._earlier:
            if (array := reference()) is not None and zlib.crc32(array.data) != crc:
                raise StateError(
                    f"particles.{name}: an array of an earlier step was written to, which has no effect;"
                    " read it from sim.particles again after each step"
                )
        while self._shown:
            self._shown.popitem()[1].flags.writeable = False
        kept = [(name, weakref.ref(copy), zlib.crc32(copy.data)) for name, copy in self._copies.items()]
        self._copies.clear()
        self._earlier[:] = [one for one in self._earlier + kept if one[1]() is not None][-GUARDED:]  # held by the user


def moments_with(rows: Particles, changed: Mapping[str, Array]) -> dict[str, Array]:
    """Return moments of inertia for changed masses or radii: new ones for solid spheres, the old ones for others."""
    if "moment_of_inertia" not in rows.arrays or not changed.keys() & {"mass", "radius"}:
        return {}
    old, mass, radius = rows["moment_of_inertia"], changed.get("mass", rows.mass), changed.get("radius", rows.radius)
    solid = old == moment_of_sphere(rows.mass, rows.radius, rows.dimension)
    return {"moment_of_inertia": np.where(solid, moment_of_sphere(mass, radius, rows.dimension), old)}


def read_only(view: Array) -> Array:
    """A view that cannot be written to."""
    view.flags.writeable = False
    return view
