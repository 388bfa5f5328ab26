"""Boxes around the rows of ranks, and which rows come into them: the geometry for `halo_region` and `trajectories.renew_paths`.

A box is (2, d), its lower and upper corner. Rows that start now are at x + v t; a row of `path` is as in `trajectories.Paths`.
"""

from math import inf

import numpy as np

from particles_mpi.kernels.jit import in_place, inner, kernel


@in_place
def swept(x, v, i, k, margin, until):
    """The interval (low, high) that row i covers on axis k, from now until then, and `margin` on each side."""
    then = x[i, k] + v[i, k] * until
    return (x[i, k] if x[i, k] <= then else then) - margin, (x[i, k] if x[i, k] >= then else then) + margin


@kernel
def swept_box(x, v, radius, horizon):
    """The box (2, d) around all that rows starting now may cover, spheres and all; (inf, -inf) if there are no rows."""
    d = x.shape[1]
    box = np.empty((2, d))
    box[0], box[1] = inf, -inf
    for i in range(len(x)):
        margin = radius[i] + horizon.tolerance
        for k in range(d):
            low, high = swept(x, v, i, k, margin, horizon.valid_until)
            box[0, k] = box[0, k] if box[0, k] <= low else low
            box[1, k] = box[1, k] if box[1, k] >= high else high
    return box


@kernel
def rows_near_box(x, v, radius, horizon, low, high, length):
    """Return rows, ascending, that start now and may touch the box [low, high] or an image of it, judged axis by axis."""
    d = x.shape[1]
    rows = np.empty(len(x), np.int32)
    found = 0
    for i in range(len(x)):
        margin = radius[i] + horizon.tolerance
        near = True
        for k in range(d):
            begin, end = swept(x, v, i, k, margin, horizon.valid_until)
            touches = (end >= low[k]) & (begin <= high[k])
            if length[k] > 0.0:
                touches |= (end + length[k] >= low[k]) & (begin + length[k] <= high[k])
                touches |= (end - length[k] >= low[k]) & (begin - length[k] <= high[k])
            near &= touches
        rows[found] = i
        found += near
    return rows[:found]


@in_place
def time_in_box(path, i, margin, low, high):
    """How long the path of row i stays `margin` inside the box [low, high]; below 0 if it does not start there."""
    d = len(low)
    stay = inf
    for k in range(d):
        at = path[i, k]
        speed = path[i, d + k]
        gap = min(high[k] - margin - at, at - margin - low[k])
        if gap < 0.0:
            return -1.0
        if speed > 0.0:
            stay = min(stay, (high[k] - margin - at) / speed)
        elif speed < 0.0:
            stay = min(stay, (low[k] + margin - at) / speed)
    return stay


@in_place
def time_to_box(path, i, margin, low, high, length):
    """Return when the path of row i first comes within `margin` of the box [low, high] or an image of it; inf if never."""
    d = len(low)
    begin = 0.0
    finish = inf
    for k in range(d):
        speed = path[i, d + k]
        first = inf
        last = -inf
        for image in range(3 if length[k] > 0.0 else 1):
            at = path[i, k] + (0.0 if image == 0 else (length[k] if image == 1 else -length[k]))
            left = low[k] - margin - at
            right = high[k] + margin - at
            if speed == 0.0:
                if left <= 0.0 <= right:
                    first = 0.0
                    last = inf
                continue
            out = max(left / speed, right / speed)
            if out >= 0.0:  # it is not behind
                first = min(first, left / speed, right / speed)
                last = max(last, out)
        begin = max(begin, first)
        finish = min(finish, last)
    return begin if begin <= finish else inf


@inner
def index_of(row, rows):
    """Where `row` is among ascending rows, or -1."""
    low, high = 0, len(rows)
    while low < high:
        middle = (low + high) // 2
        if rows[middle] < row:
            low = middle + 1
        else:
            high = middle
    return low if low < len(rows) and rows[low] == row else -1
