"""What ranks tell one another of the particles that others hold as ghosts: states, choices of a pass, new legs.

After a pass a message holds only the rows to which something happened.
"""

from __future__ import annotations

import numpy as np

from particles_mpi.kernels.jit import kernel
from particles_mpi.kernels.markers import NOBODY
from particles_mpi.neighbours.trajectories import place_of
from particles_mpi.parallel.exchange import Halo
from particles_mpi.particles import Array


def width(dimension: int) -> int:
    """Numbers in the longest row of a message: place, last met, start of the leg, x, v; or x, v, acceleration."""
    return max(3 + 2 * dimension, 3 * dimension)


def refresh(halo: Halo, x: Array, v: Array, a: Array) -> None:
    """Ghost rows of x, v and accelerations a (n, d), as their owners have them; a without rows is the same for all."""
    for first, message in halo.exchange(lambda rows, buffer: pack_state(rows, x, v, a, buffer)):
        unpack_state(first, message, x, v, a)


def tell_choices(halo: Halo, choice: Array, a: Array, b: Array, marked: Array) -> None:
    """The choices of owned rows among the hits (a, b) to all who hold them as ghosts. `marked`: no row, now and after."""
    for first, message in halo.exchange(
        lambda rows, buffer: pack_choices(rows, choice, a, b, halo.owned, marked, buffer.view(np.int64))
    ):
        unpack_choices(first, message.view(np.int64), choice)


def tell_legs(halo: Halo, live: Array, x: Array, v: Array, s: Array, met: Array, touched: Array, count: int) -> int:
    """New legs of the owned ones of the live rows, touched[:count], to all who hold them as ghosts.

    They are live there too if their leg is news. Returns the count with the ghosts that came to it.
    """
    mine = touched[:count]
    for first, message in halo.exchange(lambda rows, buffer: pack_legs(rows, mine, x, v, s, met, buffer, buffer.view(np.int64))):
        count = unpack_legs(first, message, message.view(np.int64), live, x, v, s, met, touched, count)
    return count


@kernel
def any_of(marks, a, b):
    """Is a row of a, or one of b that is no wall (b < 0), marked?"""
    found = False
    for p in range(len(a)):
        found |= marks[a[p]] or (b[p] >= 0 and marks[b[p]])
    return found


@kernel
def pack_state(rows, x, v, a, out):
    """x and v of rows, and a if it has rows, one after the other."""
    d = x.shape[1]
    size = 0
    for i in rows:
        for k in range(d):
            out[size + k] = x[i, k]
            out[size + d + k] = v[i, k]
            if len(a) > 0:
                out[size + 2 * d + k] = a[i, k]
        size += 3 * d if len(a) > 0 else 2 * d
    return size


@kernel
def unpack_state(first, message, x, v, a):
    """What pack_state wrote, to the rows from `first` on."""
    d = x.shape[1]
    each = 3 * d if len(a) > 0 else 2 * d
    for r in range(len(message) // each):
        for k in range(d):
            x[first + r, k] = message[each * r + k]
            v[first + r, k] = message[each * r + d + k]
            if len(a) > 0:
                a[first + r, k] = message[each * r + 2 * d + k]


@kernel
def pack_choices(rows, choice, a, b, owned, marked, out):
    """(place among rows, choice) of the owned rows of the hits that are among them."""
    size = 0
    for told in (True, False):  # each row once, and all unmarked again
        for p in range(len(a)):
            for i in (a[p], b[p]):
                if 0 <= i < owned and marked[i] != told:
                    marked[i] = told
                    place = place_of(i, rows) if told and choice[i] != NOBODY else -1
                    if place >= 0:
                        out[size] = place
                        out[size + 1] = choice[i]
                        size += 2
    return size


@kernel
def unpack_choices(first, message, choice):
    """What pack_choices wrote."""
    for m in range(0, len(message), 2):
        choice[first + message[m]] = message[m + 1]


@kernel
def pack_legs(rows, touched, x, v, s, met, out, words):
    """(place among rows, met, s, x, v) of the touched rows that are among them; `words` is `out` as integers."""
    d = x.shape[1]
    size = 0
    for i in touched:
        place = place_of(i, rows)
        if place >= 0:
            words[size] = place
            words[size + 1] = met[i]
            out[size + 2] = s[i]
            for k in range(d):
                out[size + 3 + k] = x[i, k]
                out[size + 3 + d + k] = v[i, k]
            size += 3 + 2 * d
    return size


@kernel
def unpack_legs(first, message, words, live, x, v, s, met, touched, count):
    """What pack_legs wrote; rows whose leg is news become live and touched.

    Two who overlap may meet again in no time, after one of them met another: then only the velocity tells the legs apart.
    """
    d = x.shape[1]
    for m in range(0, len(message), 3 + 2 * d):
        i = first + words[m]
        news = met[i] != words[m + 1] or s[i] != message[m + 2]
        for k in range(d):
            news |= v[i, k] != message[m + 3 + d + k]
        if news and not live[i]:
            live[i] = True
            touched[count] = i
            count += 1
        met[i] = words[m + 1]
        s[i] = message[m + 2]
        for k in range(d):
            x[i, k] = message[m + 3 + k]
            v[i, k] = message[m + 3 + d + k]
    return count
