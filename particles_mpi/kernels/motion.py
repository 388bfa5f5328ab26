"""Kicks, and motion on straight lines: the kernels that every step is made of. Arrays only."""

from typing import Any, NamedTuple

from numpy.typing import NDArray

from particles_mpi.kernels.jit import in_place, lean, lean_in_place, lean_inner


class Segments(NamedTuple):
    """The straight segments of all rows in a drift: row i is at x + v (t - start) at time t after the drift began.

    x, v (n, d): place and velocity at the start of the row's present segment. start (n,): the time of that, 0 or that of the
    row's last contact. last_partner (n,) int64: whom that contact was with, an id, a wall as -1 - wall, or `NO_PARTNER`.
    """

    x: NDArray[Any]
    v: NDArray[Any]
    start: NDArray[Any]
    last_partner: NDArray[Any]


@lean_in_place
def kick(v, a, h):
    """v += a h, in place on v (n, d); as `free_drift` x += v h."""
    changed, rate = v.reshape(-1), a.reshape(-1)  # as one loop: the compiler can use vectors, whatever d is
    for m in range(len(changed)):
        changed[m] += rate[m] * h


free_drift = kick


@in_place
def copy_rows(given, into):
    """into (n, d) = given."""
    for i in range(given.shape[0]):
        for k in range(given.shape[1]):
            into[i, k] = given[i, k]


@lean
def kick_with_drag(v, a, decay, force_time):
    """v = v decay + a force_time, in place on v (n, d)."""
    for i in range(v.shape[0]):
        for k in range(v.shape[1]):
            v[i, k] = v[i, k] * decay[i] + a[i, k] * force_time[i]


@lean_inner
def move_to(axes, x, v, start, i, t):
    """Bring row i along its segment to time t, where a new segment begins."""
    for k in range(len(axes)):
        x[i, k] += v[i, k] * (t - start[i])
    start[i] = t


@lean
def end_segments(axes, x, v, start, h):
    """Move each row from the start of its last segment to the end of the drift: x += v (h - start), in place."""
    for i in range(len(x)):
        for k in range(len(axes)):
            x[i, k] += v[i, k] * (h - start[i])


@lean
def press(a, fixed, held, pressed, alone):
    """Set accelerations a (n, d) of `held` rows to `pressed`, those by forces and contacts; `alone` (n, d) keeps the old ones.

    So a particle that lies on something does not fall, and friction does not act as if it fell.
    """
    for i in range(len(held)):
        if held[i] != 0 and fixed[i] == 0:
            for k in range(a.shape[1]):
                alone[i, k] = a[i, k]
                a[i, k] = pressed[i, k]


@lean
def release(v, a, fixed, held, pressed, alone, force_time):
    """Undo `press`: remove from velocities v (n, d) what contacts gave in the kick, because it is computed again after it.

    force_time (n,): the times for which accelerations acted.
    """
    for i in range(len(held)):
        if held[i] != 0 and fixed[i] == 0:
            for k in range(a.shape[1]):
                v[i, k] -= (pressed[i, k] - alone[i, k]) * force_time[i]
                a[i, k] = alone[i, k]
