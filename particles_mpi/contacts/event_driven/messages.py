"""What ranks tell one another after a window of mode `event`, and how they check it: kernels of `windows`.

A message is a series of float64 (seen through `words` as int64), each part beginning with what it is and an id:

- TOUCHED: the record (`rollback`) of a row to which something happened, to all who hold it as a ghost.
- NEW: the record, R, 1/m, home, and the acceleration and drag where those differ, of a row that comes near the receiver's region.
- YOURS: rank and place of the particle's fields, home, and who holds it, of a row that the receiver owns from now on.
- DROPPED: a row that has gone away from the receiver's region.
"""

from __future__ import annotations

from math import floor

import numpy as np

from particles_mpi.contacts.event_driven.calendar_queue import take
from particles_mpi.contacts.event_driven.rollback import (
    GHOST,
    HISTORY,
    ID,
    KNOWN,
    MET,
    MINE,
    NOT_HERE,
    OWN,
    STUCK,
    TURNS,
    history_place,
    load_row,
    record_width,
    save_row,
)
from particles_mpi.kernels.jit import inner, kernel, lean, lean_inner, prefetch
from particles_mpi.kernels.markers import NOBODY
from particles_mpi.neighbours.verlet_kernels import level_of, move_in, move_out, neighbours, room_for
from particles_mpi.parallel.decomposition import owners

TOUCHED, NEW, YOURS, DROPPED = range(4)


@inner
def width_of(kind, d, masks, more):
    """Numbers in a part of a message; `more`: of what differs from row to row."""
    record = record_width(d)
    if kind == TOUCHED:
        return 2 + record
    if kind == NEW:
        return 2 + record + 2 + d + more
    if kind == YOURS:
        return 2 + 2 + d + masks
    return 2


@inner
def differing(acceleration, drag):
    """Numbers by which velocities change that differ from row to row: of those that have rows."""
    return (acceleration.shape[1] if len(acceleration) > 0 else 0) + (1 if len(drag) > 0 else 0)


@lean_inner
def dimension(leg):
    """Of space, from what a row of legs holds."""
    return leg.shape[1] // 2 - 1


@inner
def inside(y, length, origin):
    """The coordinate y, in the box if its axis is periodic (length > 0)."""
    return y - floor((y - origin) / length) * length if length > 0.0 else y


@lean_inner
def gap2(at, i, low, high, length, origin):
    """Square of the distance of place at[i] from the box (low, high), or from its nearest periodic image."""
    total = 0.0
    for k in range(len(low)):
        y = inside(at[i, k], length[k], origin[k])
        gap = max(low[k] - y, y - high[k], 0.0)
        if length[k] > 0.0:
            gap = min(gap, max(low[k] - y - length[k], 0.0, y + length[k] - high[k]))
            gap = min(gap, max(low[k] - y + length[k], 0.0, y - length[k] - high[k]))
        total += gap * gap
    return total


@lean_inner
def holds(masks, i, rank):
    """Is the bit of a rank set in row i?"""
    return (masks[i, rank >> 6] >> (rank & 63)) & 1 == 1


@lean_inner
def who(told, i, rank):
    """OWN, or KNOWN if another rank than this one holds row i."""
    others = told[i, rank >> 6] & ~(np.int64(1) << (rank & 63))
    for b in range(told.shape[1]):
        if b != rank >> 6:
            others |= told[i, b]
    return KNOWN if others != 0 else OWN


@kernel
def mark_holders(home, rows, ranks, low, high, length, origin, depth, masks):
    """masks[p]: which of the ranks must know row rows[p]: those whose region is within depth + R + shell of its home."""
    d = len(length)
    for p in range(len(rows)):
        i = np.int64(rows[p])
        reach = depth + home[i, d]
        for b in range(masks.shape[1]):
            masks[p, b] = 0
        for rank in ranks:
            if gap2(home, i, low[rank], high[rank], length, origin) <= reach * reach:
                masks[p, rank >> 6] |= np.int64(1) << (rank & 63)


@kernel
def plan_moves(home, log, rank, ranks, low, high, length, origin, depth, tree, wanted, owner):
    """For the own rows that got new homes: who must know them (`wanted`), and the rank whose region the home is in (`owner`)."""
    d = len(length)
    place = np.empty((1, d))
    moved, movers = log[7][0], log[8]
    for m in range(moved):
        prefetch(home, movers[m])
    for m in range(moved):
        i = np.int64(movers[m])
        owner[m] = rank
        reach = depth + home[i, d]
        deep = True
        for k in range(d):
            deep &= low[rank, k] + reach < home[i, k] < high[rank, k] - reach
        if not deep:
            mark_holders(home, movers[m : m + 1], ranks, low, high, length, origin, depth, wanted[m : m + 1])
            for k in range(d):
                place[0, k] = inside(home[i, k], length[k], origin[k])
            owner[m] = owners(place, *tree)[0]
        wanted[m, rank >> 6] |= np.int64(1) << (rank & 63)  # it stays here for now, as a ghost if not as an own row


@lean
def pack_motion(leg, state, acceleration, told, rank, out, words):
    """(id, x, v, and the acceleration if these differ) of own rows that the rank holds; returns the length.

    `out` has room for all.
    """
    d = dimension(leg)
    each = 1 + (3 * d if len(acceleration) > 0 else 2 * d)
    size = 0
    for i in range(len(leg)):
        if state[i, MINE] == KNOWN and holds(told, i, rank):
            words[size] = state[i, ID]
            for k in range(2 * d):
                out[size + 1 + k] = leg[i, k]
            for k in range(each - 1 - 2 * d):
                out[size + 1 + 2 * d + k] = acceleration[i, k]
            size += each
    return size


@lean
def unpack_motion(leg, state, acceleration, row_of, message, words):
    """What pack_motion wrote: ghosts on legs from time 0."""
    d = dimension(leg)
    each = 1 + (3 * d if len(acceleration) > 0 else 2 * d)
    for at in range(0, len(message), each):
        i = np.int64(row_of[words[at]])
        for k in range(2 * d):
            leg[i, k] = message[at + 1 + k]
        for k in range(each - 1 - 2 * d):
            acceleration[i, k] = message[at + 1 + 2 * d + k]
        leg[i, 2 * d] = 0.0
        state[i, MET], state[i, STUCK], state[i, HISTORY] = NOBODY, 0, 0


@lean_inner
def turned(d, state, i, log, p):
    """Has row i, at place p of the log, got a new leg, or only a new home?"""
    return log[5][p * record_width(d) + history_place(d)] != state[i, HISTORY]


@lean
def pack_news(leg, state, home, acceleration, drag, told, holder, log, wanted, owner, rank, out, words):
    """All that the rank must hear of own rows; returns the length. `wanted`, `owner`: of the movers of the log, in order."""
    d = dimension(leg)
    rows, moved, movers, shared, border = log[2], log[7], log[8], log[10], log[11]
    size = 0
    for p in border[: shared[0]]:
        prefetch(state, rows[p])
        prefetch(told, rows[p])
        prefetch(leg, rows[p])
    for p in border[: shared[0]]:
        i = np.int64(rows[p])
        if state[i, MINE] == KNOWN and holds(told, i, rank) and turned(d, state, i, log, p):
            words[size], words[size + 1] = TOUCHED, state[i, ID]
            size = save_row(d, leg, state, i, out, words, size + 2)
    for m in range(moved[0]):
        i = np.int64(movers[m])
        if holds(wanted, m, rank) and not holds(told, i, rank):
            words[size], words[size + 1] = NEW, state[i, ID]
            size = save_row(d, leg, state, i, out, words, size + 2)
            out[size], out[size + 1] = leg[i, 2 * d + 1], home[i, d + 2]
            for k in range(d):
                out[size + 2 + k] = home[i, k]
            size += 2 + d
            if len(acceleration) > 0:
                for k in range(d):
                    out[size + k] = acceleration[i, k]
                size += d
            if len(drag) > 0:
                out[size] = drag[i]
                size += 1
        if owner[m] == rank:
            words[size], words[size + 1] = YOURS, state[i, ID]
            words[size + 2], words[size + 3] = holder[i, 0], holder[i, 1]
            for k in range(d):
                out[size + 4 + k] = home[i, k]
            for b in range(told.shape[1]):
                words[size + 4 + d + b] = wanted[m, b]
            size += 4 + d + told.shape[1]
    for m in range(moved[0]):
        i = np.int64(movers[m])
        if holds(told, i, rank) and not holds(wanted, m, rank):
            words[size], words[size + 1] = DROPPED, state[i, ID]
            size += 2
    return size


@lean_inner
def matters(leg, i, log, begin, place, low, high, length, origin, reach):
    """May row i, wherever it went in the window that began at `begin`, have met an own row? `place` (1, d) is for scribbling."""
    d = len(length)
    window, mark, saved = log[0], log[1], log[4]
    noted = mark[i, 0] == window[0]
    for k in range(d):
        if noted:
            at = mark[i, 1] * record_width(d)
            place[0, k] = saved[at + k] + saved[at + d + k] * (begin - saved[at + 2 * d])
        else:
            place[0, k] = leg[i, k] + leg[i, d + k] * (begin - leg[i, 2 * d])
    within = reach + leg[i, 2 * d + 1]
    return gap2(place, np.int64(0), low, high, length, origin) <= within * within


@kernel
def check(leg, state, row_of, log, heard, begin, low, high, length, origin, reach, message, words, masks, more):
    """Is there a ghost that matters and had another history at its owner?

    `message`: all that arrived; notes which rows it tells of in `heard`. Of the others nothing happened at their owners.
    """
    d = len(length)
    place = np.empty((1, d))
    window = log[0][0]
    wrong = False
    for step in range(2):  # first to the cache
        at = 0
        while at < len(message):
            if words[at] == TOUCHED:
                if step == 0:
                    prefetch(row_of, words[at + 1])
                else:
                    prefetch(state, row_of[words[at + 1]])
                    prefetch(heard, row_of[words[at + 1]])
            at += width_of(words[at], d, masks, more)
    at = 0
    while at < len(message):
        if words[at] == TOUCHED:
            i = np.int64(row_of[words[at + 1]])
            heard[i] = window
            if words[at + 2 + history_place(d)] != state[i, HISTORY]:
                wrong |= matters(leg, i, log, begin, place, low, high, length, origin, reach)
        at += width_of(words[at], d, masks, more)
    rows, shared, border = log[2], log[10], log[11]
    for p in border[: shared[0]]:
        i = np.int64(rows[p])
        if state[i, MINE] == GHOST and heard[i] != window and turned(d, state, i, log, p):
            wrong |= matters(leg, i, log, begin, place, low, high, length, origin, reach)
    return wrong


@lean
def undo(leg, state, log, todo):
    """All rows as they were before the window; returns how many are to look for their next events anew."""
    rows, count, saved, words = log[2], log[3], log[4], log[5]
    record = record_width(dimension(leg))
    for p in range(count[0]):
        load_row(leg, state, np.int64(rows[p]), saved, words, p * record)
        todo[p] = rows[p]
    return count[0]


@kernel
def correct(leg, state, row_of, log, heard, message, words, more, told, wanted, owner, rank, todo):
    """Ghosts that went another way than at their owners are put right, and movers belong to the rank that their homes are in.

    Returns how many rows are to look for their next events anew.
    """
    d = dimension(leg)
    pending = 0
    at = 0
    while at < len(message):
        if words[at] == TOUCHED:
            i = np.int64(row_of[words[at + 1]])
            if words[at + 2 + history_place(d)] != state[i, HISTORY]:
                load_row(leg, state, i, message, words, at + 2)
                todo[pending] = i
                pending += 1
        at += width_of(words[at], d, told.shape[1], more)
    window, rows, saved, saved_words, shared, border = log[0][0], log[2], log[4], log[5], log[10], log[11]
    for p in border[: shared[0]]:
        i = np.int64(rows[p])
        if state[i, MINE] == GHOST and heard[i] != window and turned(d, state, i, log, p):
            load_row(leg, state, i, saved, saved_words, p * record_width(d))
            todo[pending] = i
            pending += 1
    moved, movers, is_mover = log[7], log[8], log[9]
    for m in range(moved[0]):
        i = np.int64(movers[m])
        is_mover[i] = False
        for b in range(told.shape[1]):
            told[i, b] = wanted[m, b]
        state[i, MINE] = who(told, i, rank) if owner[m] == rank else GHOST
    moved[0] = 0
    return pending


@kernel
def admit(
    leg, state, acceleration, drag, slot, heads, row_of, homes, grid, level, shell, length, told, holder, free,
    free_count, todo, pending, message, words, at,
):  # fmt: skip
    """NEW, YOURS and DROPPED of a message, from place `at` on.

    free[:free_count[0]]: rows that are not in use. todo[:pending[0]]: rows that are to look for their next events. Returns
    (place, short): the end and 0, or the place of the part for which the pool is short of so many places, or for which there
    is no free row (-1); then enlarge and call again from there.

    Kernels of `verlet_kernels` get `length` for their axes, so that this one is compiled for all dimensions at once.
    """
    d = len(length)
    record = record_width(d)
    masks, more = told.shape[1], differing(acceleration, drag)
    home, links, lists, pool, top, head, around = homes
    low, per, cells, corners, caps = grid
    while at < len(message):
        kind, name = words[at], words[at + 1]
        if kind in (NEW, YOURS):
            i = np.int64(row_of[name])
            fresh = kind == NEW and i < 0
            if fresh:
                if free_count[0] == 0:
                    return at, -1
                i = np.int64(free[free_count[0] - 1])
                leg[i, 2 * d + 1] = message[at + 2 + record]
                home[i, d + 2] = message[at + 3 + record]
            begin = at + (4 + record if kind == NEW else 4)
            if fresh or kind == YOURS:
                before = home[i].copy()
                for k in range(d):
                    home[i, k] = message[begin + k]
                if fresh:
                    home[i, d + 1] = shell if home[i, d + 2] > 0.0 else 0.0
                    home[i, d] = leg[i, 2 * d + 1] + home[i, d + 1]
                found = neighbours(length, i, home, links, head, low, per, cells, corners, caps, length, np.bool_(True), around)
                short = top[0] + room_for(i, around, found, lists) - len(pool)
                if short > 0:
                    for k in range(d + 3):
                        home[i, k] = before[k]
                    return at, short
                if fresh:
                    free_count[0] -= 1
                    row_of[name] = i
                    state[i, ID], state[i, MINE] = name, GHOST
                    load_row(leg, state, i, message, words, at + 2)
                    if len(acceleration) > 0:
                        for k in range(d):
                            acceleration[i, k] = message[begin + d + k]
                    if len(drag) > 0:
                        drag[i] = message[begin + d + more - 1]
                    level[i] = level_of(home[i, d], caps)
                else:
                    move_out(length, i, links, pool, lists, head)
                move_in(length, i, home, links, level, around, found, pool, lists, top, head, low, per, cells, corners, length)
                todo[pending[0]] = i
                pending[0] += 1
            if kind == YOURS:
                holder[i, 0], holder[i, 1] = words[at + 2], words[at + 3]
                for b in range(masks):
                    told[i, b] = words[at + 4 + d + b]
                state[i, MINE] = KNOWN  # by the rank that had it, at least
        elif kind == DROPPED:
            i = np.int64(row_of[name])
            take(slot, heads, i)
            move_out(length, i, links, pool, lists, head)
            state[i, MINE] = NOT_HERE
            state[i, TURNS] += 1
            row_of[name] = -1
            free[free_count[0]] = i
            free_count[0] += 1
        at += width_of(kind, d, masks, more)
    return at, 0
