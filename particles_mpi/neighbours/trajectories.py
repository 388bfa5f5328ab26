"""Where particles will be until a horizon: straight paths, and tubes around them. `pair_search` finds which tubes touch.

Every row has a *path*: a straight line x0 + v0 (t - t0) that it is expected to follow until the horizon `end`, give or take
`half`, the radius of its tube. A pair can touch only if, at some moment from now to the horizon, its paths come nearer than
R_i + R_j + 2 half: those are the candidates. They hold for as long as rows stay in their tubes. A row that leaves its
own (a contact turned it, a force bent its way) gets a new path, and partners are sought for that row alone.

A row of `path` (n, 2d + 2) is (x0, v0, t0, R). `seen` (n, d) is the middle of its path, where the cells hold it, and `reach` (n,)
bounds R + half + its distance from there, until the horizon. Everything here is a superset: how tight it is costs time,
never changes a result.
"""

from math import inf, sqrt

import numpy as np

from particles_mpi.kernels.geometry import nearest
from particles_mpi.kernels.jit import inner, kernel


@kernel
def fastest(x, v):
    """Largest speed of the rows of v; not a number if a coordinate or velocity is not finite."""
    most = 0.0
    wrong = 0.0  # or nan
    for i in range(len(v)):
        v2 = 0.0
        for k in range(x.shape[1]):
            v2 += v[i, k] * v[i, k]
            wrong += x[i, k] * 0.0
        wrong += v2 * 0.0
        most = most if most >= v2 else v2
    return most**0.5 + wrong


@kernel
def set_out(axes, x, v, radius, end, half, owned):
    """Of rows that all start now, at time 0: path, seen, reach, mean reach, bounds of seen (2, d), those of the first `owned`."""
    d = len(axes)
    path, seen = np.empty((len(x), 2 * d + 2)), np.empty((len(x), d))
    reach = np.empty(len(x))
    box = np.empty((2, d))
    box[0], box[1] = inf, -inf
    own_box = box.copy()
    total = 0.0
    for i in range(len(x)):
        v2 = 0.0
        if i == owned:
            own_box = box.copy()
        for k in range(d):
            path[i, k] = x[i, k]
            path[i, d + k] = v[i, k]
            seen[i, k] = x[i, k] + 0.5 * end * v[i, k]
            box[0, k] = box[0, k] if box[0, k] <= seen[i, k] else seen[i, k]
            box[1, k] = box[1, k] if box[1, k] >= seen[i, k] else seen[i, k]
            v2 += v[i, k] * v[i, k]
        path[i, 2 * d] = 0.0
        path[i, 2 * d + 1] = radius[i]
        reach[i] = radius[i] + half + sqrt(v2) * 0.5 * end
        total += reach[i]
    if owned == len(x):
        own_box = box.copy()
    return path, seen, reach, total / max(len(x), 1), box, own_box


@kernel
def strayed(axes, x, v, path, time, h, half, length, rows):
    """Rows that a drift over h from `time` takes out of their tubes; into `rows`, returns how many."""
    d = len(axes)
    found = 0
    for i in range(len(x)):
        passed = time + h - path[i, 2 * d]
        r2 = 0.0
        for k in range(d):
            r = nearest(x[i, k] + v[i, k] * h - (path[i, k] + path[i, d + k] * passed), length[k])
            r2 += r * r
        if not r2 <= half * half:
            rows[found] = i
            found += 1
    return found


@inner
def leaves(x, v, s, path, i, time, until, half, length):
    """Does the leg of row i, from time + s_i on, leave its tube before `until`? Both are straight: the ends decide."""
    d = x.shape[1]
    outside = False
    for t in (time + s[i], until):
        r2 = 0.0
        for k in range(d):
            at = x[i, k] + v[i, k] * (t - time - s[i])
            r = nearest(at - (path[i, k] + path[i, d + k] * (t - path[i, 2 * d])), length[k])
            r2 += r * r
        outside |= not r2 <= half * half
    return outside


@kernel
def turned(x, v, s, path, rows, time, until, half, length):
    """Those of `rows` whose present leg leaves the tube before `until`; to the front of `rows`, returns how many."""
    found = 0
    for i in rows:
        if leaves(x, v, s, path, i, time, until, half, length):
            rows[found] = i
            found += 1
    return found


@kernel
def tubes_box(x, v, radius, end, half):
    """The box (2, d) around the tubes, spheres and all, of rows that set out now; (inf, -inf) if there are none."""
    d = x.shape[1]
    box = np.empty((2, d))
    box[0], box[1] = inf, -inf
    for i in range(len(x)):
        margin = radius[i] + half
        for k in range(d):
            then = x[i, k] + v[i, k] * end
            low = (x[i, k] if x[i, k] <= then else then) - margin
            high = (x[i, k] if x[i, k] >= then else then) + margin
            box[0, k] = box[0, k] if box[0, k] <= low else low
            box[1, k] = box[1, k] if box[1, k] >= high else high
    return box


@kernel
def tubes_near(x, v, radius, end, half, low, high, length):
    """Rows, ascending, whose tubes may touch the box [low, high] or an image of it: judged axis by axis."""
    d = x.shape[1]
    rows = np.empty(len(x), np.int32)
    found = 0
    for i in range(len(x)):
        margin = radius[i] + half
        near = True
        for k in range(d):
            then = x[i, k] + v[i, k] * end
            begin = (x[i, k] if x[i, k] <= then else then) - margin
            finish = (x[i, k] if x[i, k] >= then else then) + margin
            touches = (finish >= low[k]) & (begin <= high[k])
            if length[k] > 0.0:
                touches |= (finish + length[k] >= low[k]) & (begin + length[k] <= high[k])
                touches |= (finish - length[k] >= low[k]) & (begin - length[k] <= high[k])
            near &= touches
        rows[found] = i
        found += near
    return rows[:found]


@inner
def leaves_box(path, i, margin, low, high):
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


@inner
def enters_box(path, i, margin, low, high, length):
    """When the path of row i comes within `margin` of the box [low, high] or an image of it, at the earliest; inf if never."""
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
def place_of(row, rows):
    """Where `row` is among ascending rows, or -1."""
    low, high = 0, len(rows)
    while low < high:
        middle = (low + high) // 2
        if rows[middle] < row:
            low = middle + 1
        else:
            high = middle
    return low if low < len(rows) and rows[low] == row else -1


@kernel(error_model="numpy")
def set_out_anew(rows, x, v, s, home, path, seen, reach, length, time, h, end, half, bound, owned, fence):
    """New paths for `rows` along their present legs, in the drift over h from `time`. In place on path, seen, reach.

    Returns (how far from `home`, where the last search saw it, a row gets in this drift if it may not, else 0; horizon).
    Rows that could get further than `bound`, or out of their fence, until the horizon bring it nearer. See `pairs.Fence`.
    """
    d = x.shape[1]
    own, others, sent, known = fence
    needed = 0.0
    for i in rows:
        start = time + s[i]
        now = 0.0
        soon = 0.0
        late = 0.0
        speed = 0.0
        for k in range(d):
            r = nearest(x[i, k] - home[i, k], length[k])
            path[i, k] = home[i, k] + r
            path[i, d + k] = v[i, k]
            now += r * r
            soon += (r + v[i, k] * (time + h - start)) ** 2
            late += (r + v[i, k] * (end - start)) ** 2
            speed += v[i, k] * v[i, k]
        path[i, 2 * d] = start
        now, soon, late = sqrt(now) + half, sqrt(soon) + half, sqrt(late) + half
        speed = sqrt(speed)
        until = max(time + h, start + (bound - now) / speed) if late > bound else inf
        if i < owned:
            margin = path[i, 2 * d + 1] + half
            until = min(until, start + leaves_box(path, i, margin, own[0], own[1]))
            for p in range(len(others)):
                if place_of(i, known[sent[p] : sent[p + 1]]) < 0:
                    until = min(until, start + enters_box(path, i, margin, others[p, 0], others[p, 1], length))
        if not (max(now, soon) <= bound and until >= time + h):
            needed = max(needed, now, soon) if soon == soon else inf
            continue
        end = min(end, until)
        for k in range(d):
            seen[i, k] = path[i, k] + 0.5 * v[i, k] * (end - start)
        reach[i] = path[i, 2 * d + 1] + half + 0.5 * speed * (end - start)
    return needed, end


@kernel
def find_near_walls(rows, path, end, half, owned, point, normal, marked, near, count):
    """Owned ones of `rows` whose tubes touch a wall until `end`; behind the first `count` of `near` that are not marked.

    Returns the number then.
    """
    d = normal.shape[1]
    kept = 0
    for p in range(count):
        near[kept] = near[p]
        kept += not marked[near[p]]
    for i in rows:
        if i >= owned:
            continue
        window = end - path[i, 2 * d]
        size = path[i, 2 * d + 1] + half * 1.000001
        travel = 0.0
        for k in range(d):
            travel += path[i, d + k] ** 2
        travel = sqrt(travel) * window
        touches = False
        for m in range(len(point)):
            begin = 0.0
            for k in range(d):
                begin += (path[i, k] - point[m, k]) * normal[m, k]
            if not begin - travel > size:  # most are too far to ask which way they go
                speed = 0.0
                for k in range(d):
                    speed += path[i, d + k] * normal[m, k]
                touches |= not min(begin, begin + speed * window) > size
        if touches:
            near[kept] = i
            kept += 1
    return kept
