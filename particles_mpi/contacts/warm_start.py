"""What lasting contacts took in the last solution: plain columns, for those who save them without loading the solver."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from particles_mpi.particles import Array


class Memory(NamedTuple):
    """Contacts that took something, once for each of their rows: id (m,) of the row; partner (m,), wall or walls + id; taken."""

    id: Array
    partner: Array
    taken: Array


NOTHING = Memory(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0))
