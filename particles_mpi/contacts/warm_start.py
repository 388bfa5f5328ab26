"""The impulses of lasting contacts in the last solution, as columns that can be saved without loading the solver."""

from typing import NamedTuple

import numpy as np

from particles_mpi.particles import Array, spin_components


class Memory(NamedTuple):
    """Contacts that had an impulse, once for each of their rows: id (m,) of the row; partner (m,), wall or walls + id; taken
    (m,), the impulse as `problem.IMPULSE` has it, or, of rough spheres, (m, columns), also where there are none: ranks send them
    to one another."""

    id: Array
    partner: Array
    taken: Array


def rough_columns(dimension: int) -> tuple[int, ...]:
    """The shape of the impulse of a contact of rough spheres: along its normal, across it, and a couple."""
    return (1 + dimension + spin_components(dimension),)


def nothing(columns: tuple[int, ...] = ()) -> Memory:
    """No contacts; `columns`: the shape of an impulse."""
    return Memory(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, *columns)))


NOTHING = nothing()
