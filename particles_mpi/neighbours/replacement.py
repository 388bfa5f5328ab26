"""One compiled call that replaces candidates: those of all rows, or of the few that left their paths."""

import numpy as np

from particles_mpi.kernels.jit import kernel
from particles_mpi.neighbours.pair_search import drop_pairs, find_partners
from particles_mpi.neighbours.search_index import move_rows
from particles_mpi.neighbours.trajectories import find_near_walls, renew_paths, rows_turned

ALL, LEAVING, TURNED = 0, 1, 2  # why candidates are replaced


@kernel(error_model="numpy")
def replace_candidates(axes, rows, begin, why, segments, drift, horizon, holding, pairs, found, walls):
    """Replace the candidates of `rows`: drop theirs among the first `found` of `pairs` and `walls` rows near walls, find others.

    why: ALL rows have got paths; the segments of these rows, in the drift over h from `time` (drift = (time, h)), were TURNED
    by contacts, or are LEAVING their paths by forces. Of rows that were turned those that leave their paths come first in
    `rows` then. holding, pairs: `Holding` and `Pairs` as plain tuples. begin: -1, or how many rows were done when there was no
    more room for pairs.

    Returns, in this order,
    needed: 0, or how far a row gets if that is further than candidates may reach: nothing was replaced then;
    until: the time until which candidates are valid;
    found, walls: how many pairs and rows near walls there are now;
    tests: how many rows were looked at as partners;
    count: how many of `rows` left their paths;
    done: how many of these have found their partners, before there was no more room.
    """
    paths, cells, spheres, planes, region, length, marked, _, wall_rows = holding
    until, (time, h), owned = horizon[0], drift, spheres[3]
    count = np.int64(len(rows))
    if why == TURNED and begin < 0:
        count = rows_turned(segments[0], segments[1], segments[2], paths[0], rows, time, horizon, length)
    asking = rows[:count]
    if begin < 0:
        begin = 0
        if why != ALL and count > 0:
            needed, until = renew_paths(asking, segments, owned, paths, region, horizon, length, time, h)
            if needed != 0.0:
                return needed, until, found, walls, 0, count, 0
            move_rows(asking, paths, owned, cells)
        found = drop_pairs(asking, marked, pairs, found)
    valid = (until, horizon[1], horizon[2])
    found, tests, done = find_partners(axes, asking, begin, why == ALL, valid, holding, pairs, found)
    if done == count:
        if len(planes[0]) > 0:
            walls = find_near_walls(asking, paths[0], valid, owned, planes, marked, wall_rows, walls)
        for i in asking:
            marked[i] = False
    return 0.0, until, found, walls, tests, count, done
