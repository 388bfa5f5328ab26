"""Many steps in one compiled loop; scalars and arrays only. See `many_steps`.

The kernels of a step are those that `Composition`, `Taylor` and `Adaptive` call, in the same order.
"""

from typing import NamedTuple

from particles_mpi.contacts.walls import finish_bounces
from particles_mpi.integrators.collocation import END, FORCES, STUCK, begin, copy, go_on
from particles_mpi.integrators.step_parts import invalid, keep_on_walls, kick_bodies, may_meet, move, set_rates, sum_forces
from particles_mpi.kernels.jit import lean
from particles_mpi.kernels.motion import copy_rows, kick
from particles_mpi.kernels.validity import WATCH_EVERY
from particles_mpi.particles import Array

HIT, ON_WALLS = 100.0, 3000.0  # ns of a hit of a wall, and of a row whose contacts with walls last, at most


class Scheme(NamedTuple):
    """The lengths of kicks, and of the drift after each, as parts of a step. Taylor's rule has one drift."""

    kicks: Array
    drifts: Array
    taylor: bool


@lean
def fixed_steps(axes, bodies, forces, losses, space, scheme, h, steps, watch, budget, begun):
    """Compute up to `steps` steps, as `Composition` or `Taylor` does. From step `watch` on, end where the watchdog would stop the
    run.

    Where particles collide, it ends before a step in which two may meet, or one a wall. `begun` (n, d): room for the velocities
    at the start of a step; None where particles do not collide: the kernel is then compiled without that test, which would slow
    it down. budget: about how many nanoseconds a step takes in which no particle meets a wall, and after how many the call ends:
    a particle that rests on a wall takes a hundred times as long as one that flies.

    Returns (steps done, wall hits, how often a row had no room, sums of forces, are the forces in `bodies.total` those at the
    present positions?).
    """
    hits, missed, sums, known, noted = 0, 0, 0, True, 0
    before, near, pushed = -1, -1, 0
    resting = 0
    step_ns, most_ns = budget
    for step in range(1, steps + 1):
        if begun is not None:
            copy_rows(bodies.v, begun)
        for part in range(len(scheme.kicks)):
            kicked, drifted = scheme.kicks[part] * h, scheme.drifts[part] * h
            if not known:
                sum_forces(axes, bodies.x, bodies.mass, bodies.fixed, forces, bodies.total)
                sums, known, before = sums + 1, True, -1
            if scheme.taylor:
                rate = bodies.rate
                for i in range(len(rate)):
                    for k in range(len(axes)):
                        rate[i, k] = bodies.total[i, k]
                        if len(bodies.drag) > 0:
                            rate[i, k] -= bodies.drag[i] * bodies.v[i, k]
                kick(bodies.v, rate, kicked)
            else:
                kick_bodies(bodies, forces, losses, space, part, kicked, drifted)
                if space.on_walls.kept:
                    pushed, rows = keep_on_walls(axes, bodies, losses, part, space, h, kicked, near)
                    resting += rows
            if drifted != 0.0:
                if begun is not None and may_meet(axes, bodies, space, drifted):
                    copy_rows(begun, bodies.v)
                    return step - 1, hits, missed, sums, known
                if space.own_rates:
                    set_rates(axes, bodies, space, before, pushed, 0.5 * h)
                    before = pushed
                hit, stuck, near, noted = move(axes, bodies, space, losses.strength, drifted, 0.5 * h)
                hits, missed = hits + hit, missed + stuck
                known = not forces.attracts
            if scheme.taylor:
                kick(bodies.v, rate, kicked)
        if noted > 0:
            finish_bounces(bodies.v, space.rates, bodies.total, *space.notes[1:], noted, h, space.planes[1], space.planes[2])
        spent = step_ns * step + HIT * hits + ON_WALLS * resting
        if spent >= most_ns or (step >= watch and (step - watch) % WATCH_EVERY == 0 and invalid(axes, bodies, space)):
            return step, hits, missed, sums, known
    return steps, hits, missed, sums, known


@lean
def adaptive_steps(axes, bodies, flat, forces, space, tables, work, begun, need, done, h, until):
    """Compute further steps, as `Adaptive` does, after `done` of them.

    until: (how many steps to compute in all, the first step after which the watchdog looks, about how many sums of forces at
    most). need: END at first, and between two steps; else what `go_on` returned. flat: x, v and total of the bodies as vectors (n
    d,). begun (2, n d): x and v at the start of the present step. Returns (need, steps done, sums of forces). If need is END, and
    fewer steps are done than asked for, the watchdog would stop the run there.
    """
    x, v, total = flat
    steps, watch, most = until
    sums = 0
    while sums < most:
        if need == END:
            copy(x, begun[0])
            copy(v, begun[1])
            begin(x, h, work)
            need = FORCES
        if need == FORCES:
            sum_forces(axes, bodies.x, bodies.mass, bodies.fixed, forces, bodies.total)
            sums += 1
        need = go_on(x, v, len(axes), total, work, tables)
        if need == STUCK:
            return need, done, sums
        if need == END:
            move(axes, bodies, space, 0.0, 0.0, 0.5 * h)
            done += 1
            if done == steps or (done >= watch and (done - watch) % WATCH_EVERY == 0 and invalid(axes, bodies, space)):
                return need, done, sums
    return need, done, sums
