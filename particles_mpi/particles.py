"""The particles of one rank: a struct of arrays, and the ONE table of fields that exchange, output and checkpoint read."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Column:
    """A per-particle quantity, by default one number.

    dtype: a numpy type; vector: it has d components, one for each axis; rotation: d(d-1)/2, one for each plane of two axes;
    orientation: an angle in the plane, a quaternion in space; ghost: ghosts have it, because partners of a pair need it; output:
    it is written to frames (state that only a restart needs is not); default: the value if none is given; least: the smallest
    allowed.
    """

    dtype: str = "float64"
    vector: bool = False
    rotation: bool = False
    orientation: bool = False
    ghost: bool = False
    output: bool = True
    default: float = 0.0
    least: float = -np.inf


# Every field a particle can have. A scene holds the first six, and of the others those that its effects, integrator
# and output need (`scene.active.fields_of`).
FIELDS = {
    "id": Column("int64", ghost=True),
    "position": Column(vector=True, ghost=True),
    "velocity": Column(vector=True, ghost=True),
    "radius": Column(ghost=True, least=0.0),
    "mass": Column(ghost=True, least=0.0, default=1.0),
    "fixed": Column("uint8", ghost=True),
    "drag": Column(ghost=True, least=0.0),
    "acceleration": Column(vector=True),
    "spin": Column(rotation=True, ghost=True),  # angular velocity, of rough spheres
    "moment_of_inertia": Column(ghost=True, least=0.0),
    "orientation": Column(orientation=True),  # from that at the start
    # time of its last contact with a particle or a wall, in mode event; -inf: it had none
    "contacted": Column(ghost=True, output=False, default=-np.inf),
    # sum of r.J of its collisions so far; each counts for the lower id, or for the other one if that is fixed; for observables
    "virial": Column(output=False),
    "supported": Column("uint8", output=False),  # pressed onto something by forces: see contacts/persistent
    # by forces and lasting contacts, in this step
    "total_acceleration": Column(vector=True, ghost=True, output=False),
    "free_acceleration": Column(vector=True, output=False),  # by forces alone, where lasting contacts push too
    "rate": Column(vector=True, output=False),  # dv/dt at the start of a `taylor` step
}
RUN_MADE = tuple(name for name, column in FIELDS.items() if not column.output)  # fields that a run fills by itself
BUILT_IN = tuple(FIELDS)  # those of the program; effects from outside bring more
USER = Column("", output=False)  # data of the user's own, of any type and shape, which moves with its particle
# Types of columns that viewers, too, can read: VTK has no others.
IN_FILES = ("float64", "float32", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (64, 32, 16, 8)))
ALWAYS = ("id", "position", "velocity", "radius", "mass", "fixed")
# Fields that decide which particles meet, and with what outcome
MEETING = ("position", "velocity", "radius", "mass", "fixed", "drag", "spin", "moment_of_inertia", "contacted", "virial")


OWN = {"dimension", "arrays", "version", "edition"}  # attributes of `Particles` that are no fields
# Names that have another meaning in a table of a scene or of the start, in a view of the state, or in files of frames and for
# programs that read these. Names that begin with "_" or end in FULL are taken, too.
TAKEN = OWN | {"count", "time", "step", "index", "fields", "speed", "energy", "axis", "spinning", "Points"}
TAKEN |= {f"{v}{axis}" for v in ("", "v") for axis in "xyz"}
FULL = "_full"  # after the name of a vector of more than three components, in files of frames


class Particles:
    """Rows of particles as arrays by name: `position[i]`, `mass[i]`, ...; vectors are (n, d), scalars (n,), in the scene's units.

    The order of rows changes from step to step; `id` tells which particle a row is. `version` is raised when rows were moved, or
    a user changed a field of MEETING: data that was kept for each row is then out of date. `edition` is raised when a user
    changed anything (fields, effects, which particles there are), and at the start.
    """

    def __init__(self, dimension: int, arrays: dict[str, Array]):
        self.dimension = dimension
        self.arrays = arrays
        self.version = self.edition = 0

    def __len__(self) -> int:
        return len(self.arrays["id"])

    def __getitem__(self, name: str) -> Array:
        return self.arrays[name]

    def __getattr__(self, name: str) -> Array:
        try:
            return self.__dict__["arrays"][name]
        except KeyError:
            raise AttributeError(f"these particles have no field {name!r}") from None

    def __setattr__(self, name: str, value: Any) -> None:
        """Write values into the array of a field, as in `particles.velocity *= 0.9`; other objects refer to the same array."""
        if name in OWN:
            object.__setattr__(self, name, value)
        elif name in self.arrays:
            self[name] = value
        else:
            raise AttributeError(f"these particles have no field {name!r}")

    def __setitem__(self, name: str, values: Any) -> None:
        column = self.arrays[name]
        if values is not column:  # else it is the array itself
            column[...] = values

    def select(self, rows: Array) -> Particles:
        """A copy of the rows (indices), in that order."""
        return Particles(self.dimension, rows_of(self.arrays, rows))

    def typed(self) -> Particles:
        """Return the same rows, with each field in its own type: `fixed` of a frame, for instance, is a mask of rows."""
        held = {name: column.astype(field(name).dtype, copy=False) for name, column in self.arrays.items() if name in FIELDS}
        return Particles(self.dimension, self.arrays | held)

    def copy(self) -> Particles:
        """The same rows, in arrays of their own."""
        return self.select(np.arange(len(self)))

    def replace(self, arrays: dict[str, Array]) -> None:
        """Take other rows in place of the present ones: the same fields, any number of rows, any order."""
        self.arrays = arrays
        self.version += 1

    def change(self, values: dict[str, Array]) -> None:
        """Set some fields to new values (n, ...). Velocities and spins that are given to fixed particles are set back to 0."""
        for name, value in values.items():
            self[name] = value
        self.hold_fixed()
        self.edition += 1
        self.version += not values.keys().isdisjoint(MEETING)

    def hold_fixed(self) -> None:
        """Set the velocities and spins of fixed particles to 0."""
        for name in ("velocity", "spin"):
            if name in self.arrays:
                self.arrays[name][self.fixed != 0] = 0.0

    @property
    def inverse_mass(self) -> Array:
        """1/m, and 0 for fixed particles, which nothing moves; shape (n,)."""
        return np.divide(1.0, self.mass, out=np.zeros(len(self)), where=(self.fixed == 0) & (self.mass > 0.0))

    @property
    def inverse_inertia(self) -> Array:
        """1/I (n,), 0 for fixed particles and for points, which nothing turns; an array without rows where spheres are smooth."""
        moment = self.arrays.get("moment_of_inertia")
        if moment is None:
            return np.empty(0)
        turns = (self.fixed == 0) & (self.mass > 0.0) & (moment >= np.finfo(float).tiny) & (self.radius > 0.0)
        return np.divide(1.0, moment, out=np.zeros(len(self)), where=turns)

    def __repr__(self) -> str:
        return f"Particles({len(self)} rows in dimension {self.dimension}: {', '.join(self.arrays)})"


def add_column(name: str, column: Column) -> None:
    """Enter the column of an effect into FIELDS. ValueError if its name is taken, or its type or default cannot be used."""
    known = FIELDS.get(name, column)
    taken = name in TAKEN or name.startswith("_") or name.endswith(FULL) or hasattr(Particles, name)
    if taken or not name.isidentifier() or (known != column and name in BUILT_IN):
        raise ValueError(f"column {name!r}: the name is taken, or is not an identifier")
    if known != column:
        raise ValueError(
            f"column {name!r}: another effect, or an earlier version of this file, defines it otherwise: use another name, or"
            " restart Python"
        )
    if str(np.dtype(column.dtype)) not in IN_FILES:
        raise ValueError(f"column {name!r}: {column.dtype} is not a type that files of frames can have: {', '.join(IN_FILES)}")
    if not is_default(column):
        raise ValueError(
            f"column {name!r}: its default {column.default!r} is not of type {column.dtype} and at least {column.least:g}"
        )
    FIELDS[name] = column


def is_default(column: Column) -> bool:
    """Is the default of a column a number of its type, and not below its least?"""
    value: Any = column.default
    with suppress(TypeError, ValueError, OverflowError):
        stored = np.array(value, column.dtype)
        whole = stored.dtype.kind == "f" or np.array_equal(stored, value)
        return not isinstance(value, str) and bool(whole and not np.any(np.less(value, column.least)))
    return False


def field(name: str) -> Column:
    """Return the column of a field; USER for data of the user's own, which FIELDS does not have."""
    return FIELDS.get(name, USER)


def spin_components(dimension: int) -> int:
    """Return the number of components of a spin: one for each plane of two axes."""
    return dimension * (dimension - 1) // 2


def components(column: Column, dimension: int) -> int:
    """Components of a column, 0 of a scalar."""
    if column.orientation:
        return 4 if dimension == 3 else 1
    if column.rotation:
        return spin_components(dimension)
    return dimension if column.vector else 0


def shape(name: str, rows: int, dimension: int) -> tuple[int, ...]:
    """Shape of a field's array."""
    width = components(FIELDS[name], dimension)
    return (rows, width) if width else (rows,)


def as_shown(name: str, array: Array) -> Array:
    """A view of a field: of `fixed`, which is held as 0 or 1, as truth values, so that it can be a mask of rows."""
    return array.view(bool) if name == "fixed" else array[:]


def row_bytes(*columns: Array) -> int:
    """Bytes of a row of these columns together."""
    return sum(column.itemsize * prod(column.shape[1:]) for column in columns)


def moment_of_sphere(mass: Array, radius: Array, dimension: int) -> Array:
    """Moments of inertia (n,) of solid spheres, 2/5 m R^2, and of discs, 1/2 m R^2, in the plane."""
    return np.asarray((0.5 if dimension == 2 else 0.4) * mass * radius**2)


def default_values(name: str, rows: int, dimension: int) -> Array:
    """Return an array with the default value of a field in each of so many rows."""
    values = np.full(shape(name, rows, dimension), FIELDS[name].default, FIELDS[name].dtype)
    if FIELDS[name].orientation and dimension == 3:
        values[:, 0] = 1.0
    return values


def part_of(p: Particles, rows: slice) -> Particles:
    """The rows of a slice, in the same memory."""
    return Particles(p.dimension, {name: array[rows] for name, array in p.arrays.items()})


def to_read(p: Particles, names: Iterable[str] = BUILT_IN) -> Particles:
    """Return the same rows in the same memory, with the named fields read-only; columns that effects bring stay writable."""
    given = Particles(p.dimension, {name: array[:] for name, array in p.arrays.items()})
    for name in given.arrays.keys() & FIELDS.keys() & set(names):
        given.arrays[name].flags.writeable = False
    given.version, given.edition = p.version, p.edition
    return given


def rows_of(arrays: dict[str, Array], rows: Array) -> dict[str, Array]:
    """Copies of the rows of every array, in that order."""
    return {name: array.take(rows, axis=0) for name, array in arrays.items()}


def rows_with(ids: Array, wanted: Array) -> Array:
    """Return the rows of the `wanted` ids, among rows with these `ids` (n,), which are all different and contain them."""
    order = np.argsort(ids)
    rows: Array = order[np.searchsorted(ids, wanted, sorter=order)]
    return rows


def same_bits(one: Array, other: Array) -> bool:
    """Have two arrays the same type, shape and bits? -0.0 is not 0.0, and the same NaN is the same.

    For few numbers a twentieth of the time of numpy's `array_equal`.
    """
    return one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes()


def row_dot(rows: Array, vectors: Array) -> Array:
    """Dot products (n,) of rows (n, d) with `vectors`, (n, d) or one (d,) for all.

    Axes are summed in order: the same bits whatever the number of rows (a BLAS product promises no such thing).
    """
    total = rows[:, 0] * vectors[..., 0]
    for k in range(1, rows.shape[1]):
        total += rows[:, k] * vectors[..., k]
    return total
