"""The particles of one rank: a struct of arrays, and the ONE table of fields that exchange, output and checkpoint read."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Column:
    """A per-particle quantity.

    dtype: of numpy; vector: one component an axis; rotation: one a plane of two axes, d(d-1)/2; orientation: an angle in the
    plane, a quaternion in space; ghost: partners of a pair must know it; output: written to frames (state that only a restart
    needs is not); default: the value where nothing gives one; least: the smallest value allowed.
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
    # when it last met anyone or a wall, in mode event; -inf: never
    "contacted": Column(ghost=True, output=False, default=-np.inf),
    # sum of r.J of its collisions so far; each counts for the lower id, or for the other one if that is fixed; for observables
    "virial": Column(output=False),
    "supported": Column("uint8", output=False),  # pressed onto something by forces: see contacts/persistent
    # of forces and lasting contacts, in this step
    "total_acceleration": Column(vector=True, ghost=True, output=False),
    "free_acceleration": Column(vector=True, output=False),  # of forces alone, where lasting contacts push too
    "rate": Column(vector=True, output=False),  # dv/dt at the start of a `taylor` step
}
RUN_MADE = tuple(name for name, column in FIELDS.items() if not column.output)  # fields that a run fills by itself
BUILT_IN = tuple(FIELDS)  # those of the program; effects from outside bring more
USER = Column("", output=False)  # any other name: data of the user's, of any type and shape, that goes where its particle goes
# Types of columns that viewers, too, can read: VTK has no others.
IN_FILES = ("float64", "float32", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (64, 32, 16, 8)))
ALWAYS = ("id", "position", "velocity", "radius", "mass", "fixed")
# Fields that decide who meets whom, with what outcome
MEETING = ("position", "velocity", "radius", "mass", "fixed", "drag", "spin", "moment_of_inertia", "contacted", "virial")


OWN = {"dimension", "arrays", "version", "edition"}  # attributes of `Particles` that are no fields
# Names that say something else in a table of a scene or of the start, in a view of the state, or in files of frames and for those
# who read them; so does any that begins with "_", or ends in FULL.
TAKEN = OWN | {"count", "time", "step", "index", "fields", "speed", "energy", "axis", "spinning", "Points"}
TAKEN |= {f"{v}{axis}" for v in ("", "v") for axis in "xyz"}
FULL = "_full"  # after the name of a vector of more than three components, in files of frames


class Particles:
    """Rows of particles as arrays by name: `position[i]`, `mass[i]`, ...; vectors are (n, d), scalars (n,), in the scene's units.

    Row order changes from step to step; `id` tells which particle a row is. `version` counts the times that rows were moved, or
    that a user changed what decides who meets whom: whatever is kept by row is then stale. `edition` counts changes by a user
    (of fields, of effects, of who is there) and the start.
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
        """`particles.velocity *= 0.9`, and any values for a field, go into its array, which others hold too."""
        if name in OWN:
            object.__setattr__(self, name, value)
        elif name in self.arrays:
            self[name] = value
        else:
            raise AttributeError(f"these particles have no field {name!r}")

    def __setitem__(self, name: str, values: Any) -> None:
        column = self.arrays[name]
        if values is not column:  # else they are there already
            column[...] = values

    def select(self, rows: Array) -> Particles:
        """A copy of the rows (indices), in that order."""
        return Particles(self.dimension, rows_of(self.arrays, rows))

    def typed(self) -> Particles:
        """The same rows with each field as numbers of its type, as they are held: `fixed` of a frame, say, is a mask of rows."""
        held = {name: column.astype(field(name).dtype, copy=False) for name, column in self.arrays.items() if name in FIELDS}
        return Particles(self.dimension, self.arrays | held)

    def copy(self) -> Particles:
        """The same rows, in arrays of their own."""
        return self.select(np.arange(len(self)))

    def replace(self, arrays: dict[str, Array]) -> None:
        """Take other rows: same fields, any number of rows, any order."""
        self.arrays = arrays
        self.version += 1

    def change(self, values: dict[str, Array]) -> None:
        """New values (n, ...) of some fields. Fixed particles have no velocity: any that is given to them is taken away."""
        for name, value in values.items():
            self[name] = value
        self.hold_fixed()
        self.edition += 1
        self.version += not values.keys().isdisjoint(MEETING)

    def hold_fixed(self) -> None:
        """Fixed particles neither move nor turn."""
        for name in ("velocity", "spin"):
            if name in self.arrays:
                self.arrays[name][self.fixed != 0] = 0.0

    @property
    def inverse_mass(self) -> Array:
        """1/m, and 0 for fixed particles, which nothing moves; shape (n,)."""
        return np.divide(1.0, self.mass, out=np.zeros(len(self)), where=(self.fixed == 0) & (self.mass > 0.0))

    @property
    def inverse_inertia(self) -> Array:
        """1/I, and 0 for what nothing turns: fixed particles, and points, or nearly so; no row where spheres are smooth."""
        moment = self.arrays.get("moment_of_inertia")
        if moment is None:
            return np.empty(0)
        turns = (self.fixed == 0) & (self.mass > 0.0) & (moment >= np.finfo(float).tiny) & (self.radius > 0.0)
        return np.divide(1.0, moment, out=np.zeros(len(self)), where=turns)

    def __repr__(self) -> str:
        return f"Particles({len(self)} rows in dimension {self.dimension}: {', '.join(self.arrays)})"


def add_column(name: str, column: Column) -> None:
    """Enter a column that an effect brings into the table. ValueError if another one has the name, or it holds no numbers."""
    known = FIELDS.get(name, column)
    taken = name in TAKEN or name.startswith("_") or name.endswith(FULL) or hasattr(Particles, name)
    if taken or not name.isidentifier() or (known != column and name in BUILT_IN):
        raise ValueError(f"column {name!r}: the name is taken, or is no identifier")
    if known != column:
        raise ValueError(
            f"column {name!r}: known otherwise, from another effect or an earlier version of this file: use another name, or"
            " restart Python"
        )
    if str(np.dtype(column.dtype)) not in IN_FILES:
        raise ValueError(f"column {name!r}: {column.dtype} is none of the types that files of frames have: {', '.join(IN_FILES)}")
    if not is_default(column):
        raise ValueError(f"column {name!r}: its default {column.default!r} is no {column.dtype} of at least {column.least:g}")
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
    """What is known of a field; data of the user's own is in no table."""
    return FIELDS.get(name, USER)


def spin_components(dimension: int) -> int:
    """Components of a spin: as many as there are planes to turn in."""
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
    """What a field holds where nothing gives it a value."""
    values = np.full(shape(name, rows, dimension), FIELDS[name].default, FIELDS[name].dtype)
    if FIELDS[name].orientation and dimension == 3:
        values[:, 0] = 1.0
    return values


def part_of(p: Particles, rows: slice) -> Particles:
    """The rows of a slice, in the same memory."""
    return Particles(p.dimension, {name: array[rows] for name, array in p.arrays.items()})


def to_read(p: Particles) -> Particles:
    """The same rows, in the same memory, of which what the program has by itself can only be read."""
    given = Particles(p.dimension, {name: array[:] for name, array in p.arrays.items()})
    for name in given.arrays.keys() & FIELDS.keys() & set(BUILT_IN):
        given.arrays[name].flags.writeable = False
    given.version, given.edition = p.version, p.edition
    return given


def rows_of(arrays: dict[str, Array], rows: Array) -> dict[str, Array]:
    """Copies of the rows of every array, in that order."""
    return {name: array.take(rows, axis=0) for name, array in arrays.items()}


def rows_with(ids: Array, wanted: Array) -> Array:
    """Which of the rows with these ids (n,), all different, have the `wanted` ids, which are among them."""
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
