"""Who can meet whom until a horizon: straight paths, tubes around them, and the pairs of tubes that touch.

Every row has a *path*: a straight line x0 + v0 (t - t0) that it is expected to follow until the horizon `end`, give or take
`half`, the radius of its tube. A pair can touch only if, at some moment from now to the horizon, its paths come nearer than
R_i + R_j + 2 half: those are the candidates. They hold for as long as rows stay in their tubes. A row that leaves its
own (a contact turned it, a force bent its way) gets a new path, and partners are sought for that row alone.

A row of `path` (n, 2d + 2) is (x0, v0, t0, R). `seen` (n, d) is the middle of a row's path at the last search, where the cells
hold it; `reach` (n,) bounds R + half + the distance of a row from there, until the horizon. Everything here is a superset:
how tight it is costs time, and never changes a result.
"""

from math import inf, sqrt

import numpy as np
from numba import njit

from particles_mpi.collide.contact import nearest
from particles_mpi.neighbours.cells import GRIDDED, cell_along

AT_ONCE = 8


@njit(cache=True)
def fastest(axes, x, v):
    """Largest speed of the rows of v; not a number if a coordinate or velocity is not finite."""
    most = 0.0
    wrong = 0.0  # or nan
    for i in range(len(v)):
        v2 = 0.0
        for k in range(len(axes)):
            v2 += v[i, k] * v[i, k]
            wrong += x[i, k] * 0.0
        wrong += v2 * 0.0
        most = max(most, v2)
    return most**0.5 + wrong


@njit(cache=True)
def set_out(axes, x, v, radius, end, half):
    """(path, seen, reach) of rows that all start now, at time 0."""
    d = len(axes)
    path, seen = np.empty((len(x), 2 * d + 2)), np.empty((len(x), d))
    reach = np.empty(len(x))
    for i in range(len(x)):
        v2 = 0.0
        for k in range(d):
            path[i, k] = x[i, k]
            path[i, d + k] = v[i, k]
            seen[i, k] = x[i, k] + 0.5 * end * v[i, k]
            v2 += v[i, k] * v[i, k]
        path[i, 2 * d] = 0.0
        path[i, 2 * d + 1] = radius[i]
        reach[i] = radius[i] + half + sqrt(v2) * 0.5 * end
    return path, seen, reach


@njit(cache=True)
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


@njit(cache=True)
def leaves(axes, x, v, s, path, i, time, until, half, length):
    """Does the leg of row i, from time + s_i on, leave its tube before `until`? Both are straight: the ends decide."""
    d = len(axes)
    outside = False
    for t in (time + s[i], until):
        r2 = 0.0
        for k in range(d):
            at = x[i, k] + v[i, k] * (t - time - s[i])
            r = nearest(at - (path[i, k] + path[i, d + k] * (t - path[i, 2 * d])), length[k])
            r2 += r * r
        outside |= not r2 <= half * half
    return outside


@njit(cache=True)
def turned(axes, x, v, s, path, rows, time, until, half, length):
    """Those of `rows` whose present leg leaves the tube before `until`; to the front of `rows`, returns how many."""
    found = 0
    for i in rows:
        if leaves(axes, x, v, s, path, i, time, until, half, length):
            rows[found] = i
            found += 1
    return found


@njit(cache=True, error_model="numpy")
def set_out_anew(axes, rows, x, v, s, seen, path, reach, length, time, h, end, half, bound, cap, giants, known):
    """New paths for `rows` along their present legs, in the drift over h from `time`. In place on path, reach, giants.

    Returns (how far from `seen` a row gets in this drift if that is more than `bound`, else 0; horizon; number of giants).
    Rows that could get further than `bound` until the horizon bring it nearer. Those with a reach beyond `cap` are giants.
    """
    d = len(axes)
    needed = 0.0
    for i in rows:
        start = time + s[i]
        now = 0.0
        soon = 0.0
        late = 0.0
        speed = 0.0
        for k in range(d):
            r = nearest(x[i, k] - seen[i, k], length[k])
            path[i, k] = seen[i, k] + r
            path[i, d + k] = v[i, k]
            now += r * r
            soon += (r + v[i, k] * (time + h - start)) ** 2
            late += (r + v[i, k] * (end - start)) ** 2
            speed += v[i, k] * v[i, k]
        path[i, 2 * d] = start
        now, soon, late = sqrt(now) + half, sqrt(soon) + half, sqrt(late) + half
        if not max(now, soon) <= bound:
            needed = max(needed, now, soon) if soon == soon else inf
            continue
        if late > bound:
            end = max(time + h, start + (bound - now) / sqrt(speed))
            late = bound
        if reach[i] <= cap:
            reach[i] = path[i, 2 * d + 1] + max(now, late)
            if reach[i] > cap:
                giants[known] = i
                known += 1
    return needed, end, known


@njit(cache=True)
def drop_pairs(rows, marked, first, second, count):
    """Forget the pairs of `rows` among the first `count`; marks the rows, returns how many pairs stay."""
    for i in rows:
        marked[i] = True
    kept = 0
    for p in range(count):
        i = first[p]
        j = second[p]
        first[kept] = i
        second[kept] = j
        kept += not (marked[np.uint64(i)] | marked[np.uint64(j)])
    return kept


@njit(cache=True)
def cover(low, high, lowest, highest, length, origin, per, cells, cell_low, cell_high, shift):
    """The cells of one axis that [low, high] and its periodic images meet: intervals and shifts, returns how many."""
    count = 0
    for image in range(3 if length > 0.0 else 1):
        by = 0.0 if image == 0 else (length if image == 1 else -length)
        if high + by >= lowest and low + by <= highest:
            cell_low[count] = cell_along(low + by, origin, per, cells)
            cell_high[count] = cell_along(high + by, origin, per, cells)
            shift[count] = by
            count += 1
    return count


@njit(cache=True, error_model="numpy", inline="always")
def may_meet(axes, y, path, i, j, window, half, length):
    """Do the paths of i, at y at its start, and of j come nearer than R_i + R_j + 2 half within `window` from then?

    With a margin for round-off. On the gridded axes y is the image that is meant.
    """
    d = len(axes)
    passed = path[i, 2 * d] - path[j, 2 * d]
    r2 = 0.0
    ru = 0.0
    u2 = 0.0
    for k in range(d):
        r = y[k] - (path[j, k] + path[j, d + k] * passed)
        if k >= GRIDDED:
            r = nearest(r, length[k])
        u = path[i, d + k] - path[j, d + k]
        r2 += r * r
        ru += r * u
        u2 += u * u
    t = -ru / (u2 + 1e-300)
    t = t if t > 0.0 else 0.0  # not max and min: those branch
    t = t if t < window else window
    size = path[i, 2 * d + 1] + path[j, 2 * d + 1]
    cut = size + 2.0 * half
    return (size > 0.0) & (r2 + t * (2.0 * ru + t * u2) <= cut * cut + 1e-12 * r2)


@njit(cache=True, error_model="numpy")
def find_partners(
    axes, rows, marked, path, reach, end, half, widest, cap, giants, order, place, entry, start, origin, per, cells,
    lowest, highest, length, owned, ids, w, first, second, found,
):  # fmt: skip
    """Candidate pairs of `rows` (all of them marked) with all rows, each once, behind the first `found` pairs.

    Nearly every test is a coin toss, so little branches on one: runs are short, and AT_ONCE places are listed whatever
    their length; each place is written, and the next one over it if it does not count.

    Returns (number of pairs then: more than len(first): enlarge, call again; number of tests). Kept are pairs with an owned
    partner (row < owned) and a movable one (w > 0), the lower id first. Of two marked rows the one that reaches further
    finds the other. So if all rows are marked a search need not look further than its own reach (widest < 0), and one
    giant costs no more than the pairs it has. Else others reach up to `widest`, and those beyond `cap`, in `giants`, are
    tried one by one. `order`, `place`, `start`, ... are the cells and `entry` their rows (seen, reach), in their order;
    `lowest`, `highest` (d,) the bounds of what they hold.
    """
    d = len(axes)
    axis0 = max(0, 3 - d)
    cell_low, cell_high = np.zeros((3, 3), np.int64), np.zeros((3, 3), np.int64)
    shift, images = np.zeros((3, 3)), np.ones(3, np.int64)
    y, middle = np.empty(d), np.empty(d)
    around = np.empty(len(order) + AT_ONCE, np.int32)
    tests = 0
    for i in rows:
        entry[place[i], min(d, 3)] = reach[i]
    for i in rows:
        self = np.uint64(place[i])
        window = end - path[i, 2 * d]
        own = 0.0
        for k in range(d):
            own += path[i, d + k] ** 2
        own = path[i, 2 * d + 1] + half + 0.5 * sqrt(own) * window
        margin = path[i, 2 * d + 1] + half + (reach[i] if widest < 0.0 else widest)
        limit = reach[i] if widest < 0.0 else cap
        for m in range(axis0, 3):
            k = m - axis0
            begin = path[i, k]
            stop = begin + path[i, d + k] * window
            images[m] = cover(
                min(begin, stop) - margin, max(begin, stop) + margin, lowest[k], highest[k], length[k],
                origin[m], per[m], cells[m], cell_low[m], cell_high[m], shift[m],
            )  # fmt: skip
        for k in range(d):
            y[k] = path[i, k]
        for g in range(len(giants)):
            j = giants[g]
            for k in range(min(d, 3)):
                r = path[i, k] - (path[j, k] + path[j, d + k] * (path[i, 2 * d] - path[j, 2 * d]))
                y[k] = path[i, k] + nearest(r, length[k]) - r
            if wanted(axes, i, j, marked, reach, owned, ids, w) and may_meet(axes, y, path, i, np.int64(j), window, half, length):
                if found < len(first):
                    first[found], second[found] = (i, j) if ids[i] < ids[j] else (j, i)
                found += 1
        tests += len(giants)
        for p0 in range(images[0]):
            for p1 in range(images[1]):
                for p2 in range(images[2]):
                    for m in range(axis0, 3):
                        p = p0 if m == 0 else (p1 if m == 1 else p2)
                        y[m - axis0] = path[i, m - axis0] + shift[m, p]
                        middle[m - axis0] = y[m - axis0] + 0.5 * path[i, d + m - axis0] * window
                    listed = 0
                    for c0 in range(cell_low[0, p0], cell_high[0, p0] + 1):
                        for c1 in range(cell_low[1, p1], cell_high[1, p1] + 1):
                            c = (c0 * cells[1] + c1) * cells[2]
                            begin_run = start[np.uint64(c + cell_low[2, p2])]
                            end_run = start[np.uint64(c + cell_high[2, p2] + 1)]
                            for p in range(AT_ONCE):
                                around[np.uint64(listed + p)] = begin_run + p
                            for p in range(AT_ONCE, end_run - begin_run):
                                around[np.uint64(listed + p)] = begin_run + p
                            listed += end_run - begin_run
                    tests += listed
                    near = 0
                    for p in range(listed):
                        e = np.uint64(around[np.uint64(p)])
                        r2 = 0.0
                        for k in range(min(d, 3)):
                            r2 += (middle[k] - entry[e, k]) ** 2
                        others = entry[e, min(d, 3)]
                        around[np.uint64(near)] = e
                        near += (r2 <= (own + others) ** 2) & (others <= limit) & (e != self)
                    for p in range(near):
                        j = order[np.uint64(around[p])]
                        if may_meet(axes, y, path, i, np.uint64(j), window, half, length):
                            if wanted(axes, i, j, marked, reach, owned, ids, w):
                                if found < len(first):
                                    first[found], second[found] = (i, j) if ids[i] < ids[j] else (j, i)
                                found += 1
    return found, tests


@njit(cache=True)
def wanted(axes, i, j, marked, reach, owned, ids, w):
    """Is this a pair to keep, found from i?"""
    if i == j or not (i < owned or j < owned) or (w[i] == 0.0 and w[j] == 0.0):
        return False
    return not (marked[j] and (reach[j] > reach[i] or (reach[j] == reach[i] and ids[j] > ids[i])))


@njit(cache=True)
def find_near_walls(axes, rows, path, end, half, owned, point, normal, marked, near, count):
    """Owned ones of `rows` whose tubes touch a wall until `end`; behind the first `count` of `near` that are not marked.

    Returns the number then.
    """
    d = len(axes)
    kept = 0
    for p in range(count):
        near[kept] = near[p]
        kept += not marked[near[p]]
    for i in rows:
        if i >= owned:
            continue
        window = end - path[i, 2 * d]
        touches = False
        for m in range(len(point)):
            begin = 0.0
            speed = 0.0
            for k in range(d):
                begin += (path[i, k] - point[m, k]) * normal[m, k]
                speed += path[i, d + k] * normal[m, k]
            touches |= not min(begin, begin + speed * window) > path[i, 2 * d + 1] + half * 1.000001
        if touches:
            near[kept] = i
            kept += 1
    return kept


@njit(cache=True)
def unmark(rows, marked):
    """Take the marks off."""
    for i in rows:
        marked[i] = False
