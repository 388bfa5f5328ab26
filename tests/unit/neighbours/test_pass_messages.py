"""What ranks must tell one another in a pass over contacts."""

import numpy as np
import pytest

from particles_mpi.neighbours.pass_messages import ACROSS, OWN_ONLY, SHARED_ROWS, rows_concerned

SHARED = np.array([False, False, True, False, True, True])  # rows 0 to 3 are own ones, 4 and 5 ghosts
WALL = -1


@pytest.mark.parametrize(
    ("hits", "concerned"),
    [
        ([], OWN_ONLY),
        ([(0, 1), (3, WALL), (0, WALL - 5)], OWN_ONLY),
        ([(0, 1), (1, 2)], SHARED_ROWS),
        ([(2, 3), (0, 1)], SHARED_ROWS),
        ([(2, WALL)], SHARED_ROWS),
        ([(2, 3), (0, 4)], ACROSS),
        ([(5, 2), (2, WALL)], ACROSS),
    ],
)
def test_rows_concerned(hits, concerned):
    first, second = np.array(hits, np.int32).reshape(-1, 2).T.copy()
    assert rows_concerned(SHARED, 4, first, second) == concerned
