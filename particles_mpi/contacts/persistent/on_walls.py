"""Smooth rows that nothing but walls can hold: each by itself, in one kernel, for calls from Python would take longer."""

from math import inf

import numpy as np

from particles_mpi.contacts.persistent.detection import PRECISE, SLOW_PUSH, find_half_edges
from particles_mpi.contacts.persistent.iterations import solve_each
from particles_mpi.contacts.persistent.problem import IMPULSE, bound_rows, table_of
from particles_mpi.contacts.persistent.rows import gather
from particles_mpi.contacts.persistent.slow import approach, carried, loads, pressing, slow
from particles_mpi.kernels.jit import kernel


@kernel
def settle_on_walls(axes, rows, fields, a, h, length, faces, planes):
    """(velocities (n, d) of `rows` that keep slow contacts with walls, which of them these contacts hold (n,) uint8).

    fields: position, velocity, radius, mass, fixed, supported of all rows of the rank; `faces` and `planes`: see
    `find_half_edges`. These are the steps of `SlowContacts.solved`.
    """
    position, velocity, radii, mass, fixed, supported = fields
    n, d = len(rows), len(axes)
    x, v, push, was = np.empty((n + 1, d)), np.empty((n + 1, d)), np.empty((n + 1, d)), np.empty(n + 1)
    gather(rows, position, velocity, a, supported, SLOW_PUSH * h, x, v, push, was)
    radius, w, held = np.full(n + 1, inf), np.zeros(n + 1), np.zeros(n + 1, np.bool_)
    for r in range(n):
        i = rows[r]
        radius[r] = radii[i]
        if fixed[i] == 0:  # whatever the mass is: walls take what comes
            w[r] = 1.0 / mass[i] if mass[i] > 0.0 else 1.0
        held[r] = was[r] != 0.0 and w[r] > 0.0
    no_neighbours, all_rows = (np.zeros(n + 1, np.int64), np.empty(0, np.int32)), np.ones(n + 1, np.bool_)
    state = x, v, push, radius, w, np.zeros(n + 1, np.bool_)
    contacts = find_half_edges(axes, state, no_neighbours, all_rows, h, length, faces, planes, np.ones(len(planes[0]), np.bool_))
    start, partner, _, normal, gap, larger_push, _ = contacts
    nothing, bound = np.zeros(len(gap)), np.zeros(n + 1)
    touch = gap <= larger_push * h
    bound_rows(axes, start, normal, w, touch, bound)
    table = table_of(axes, start, partner, normal, w, touch, bound, nothing, nothing)
    per_round_off = 1.0 / (PRECISE * larger_push)
    solve_each(axes, (start, partner, table, per_round_off, per_round_off), w, push.copy())
    load = table[:, IMPULSE].copy()
    net_push, stress = np.zeros((n + 1, d)), np.zeros((n + 1, d, d))
    loads(axes, start, partner, normal, w, load, push, net_push, stress)
    pressed = pressing(axes, start, partner, normal, load, nothing, push, net_push, stress)
    closing = approach(axes, start, partner, normal, v)
    chosen, may_close, per_allowed, per_round_off = slow(contacts, closing, nothing, (held, radius), pressed, h, 0.0, 0.0, 0.0)
    bound[:] = 0.0
    bound_rows(axes, start, normal, w, chosen, bound)
    table = table_of(axes, start, partner, normal, w, chosen, bound, may_close, nothing)
    solve_each(axes, (start, partner, table, per_allowed, per_round_off), w, v)
    return v[:n], carried(start, table[:, IMPULSE].copy())
