"""Many steps of a few bodies in one compiled loop; scalars and arrays only. See `few_bodies`.

The kernels of a step are those that `Composition`, `Taylor` and `Adaptive` call, in the same order.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from particles_mpi.contacts.velocity_flow import Rates
from particles_mpi.contacts.walls import drift_with_walls
from particles_mpi.gravity.direct import attract_few
from particles_mpi.integrators.collocation import END, FORCES, STUCK, begin, copy, go_on
from particles_mpi.kernels.geometry import wrap
from particles_mpi.kernels.jit import lean, lean_inner
from particles_mpi.kernels.motion import free_drift, kick, kick_with_drag
from particles_mpi.kernels.sliding import kick_with_friction
from particles_mpi.kernels.validity import WATCH_EVERY, find_invalid
from particles_mpi.particles import Array


class Bodies(NamedTuple):
    """All particles, in the order of their ids; n rows, vectors (n, d)."""

    id: Array
    x: Array
    v: Array
    mass: Array
    radius: Array
    inverse_mass: Array  # no row without friction
    drag: Array  # no row without drag
    fixed: Array
    total: Array  # the sum of all forces at x
    rate: Array  # of Taylor's rule: dv/dt at the start of the step; no row for other rules


class Forces(NamedTuple):
    """The forces on n bodies, in the order in which a scene adds them."""

    first: Array  # (n, d): the sum of those before the attraction that do not depend on places
    attracts: bool
    G: float
    softening2: float
    others: Array  # (m, n, d): each of those after it
    any: bool


class Losses(NamedTuple):
    """What happens in a kick besides forces: `Damping` and `ConstantFriction`."""

    decay: Array  # (kicks, n), no row without either
    push: Array
    friction: bool
    strength: float
    coasts: bool  # does nothing but friction act?


class Space(NamedTuple):
    """Where the bodies move."""

    planes: tuple[Any, ...]  # `Planes`
    bounded: bool  # are there walls?
    rates: Array  # (n, d), (1, d) or (0, d): `Rates.a`
    own_rates: bool  # is it the sum of all forces, row by row?
    lower: Array  # (d,): of the box
    upper: Array
    length: Array
    start: Array  # (n,): room for the times at which segments start
    nobody: Array  # (0,)


class Scheme(NamedTuple):
    """Kicks, and the drift after each, as parts of a step; Taylor's rule has one drift."""

    kicks: Array
    drifts: Array
    taylor: bool


@lean_inner
def sum_forces(axes, x, mass, fixed, forces, total):
    """total (n, d) = all forces at x, in the order of `Accelerations.sum`."""
    first, attracts, G, softening2, others, _ = forces
    if attracts:
        attract_few(axes, x, mass, softening2, total)
    for i in range(len(x)):
        for k in range(len(axes)):
            total[i, k] = first[i, k] + G * total[i, k] if attracts else first[i, k]
            for other in range(len(others)):
                total[i, k] += others[other, i, k]
            if fixed[i] != 0:
                total[i, k] = 0.0


@lean_inner
def move(axes, bodies, space, strength, h, t_mid):
    """The drift of `Drift.advance`, without pairs; returns the number of wall hits."""
    hits = 0
    if space.bounded:
        if space.own_rates:
            for i in range(len(bodies.total)):
                for k in range(len(axes)):
                    space.rates[i, k] = bodies.total[i, k]
        rates = Rates(space.rates, bodies.drag, strength, t_mid)
        fields = bodies.x, bodies.v, bodies.radius, bodies.inverse_mass
        hits, _ = drift_with_walls(axes, *fields, space.start, h, space.planes, rates, 0.0, space.nobody)
    else:
        free_drift(bodies.x, bodies.v, h)
    wrap(bodies.x, space.lower, space.upper, space.length)
    return hits


@lean_inner
def kick_bodies(axes, bodies, forces, losses, part, h, drift):
    """The kick of `Kick.force_and_losses`, number `part` of a step; `drift`: length of the drift that follows."""
    if len(losses.decay) == 0:
        if forces.any:
            kick(bodies.v, bodies.total, h)
    elif losses.friction:
        coast = drift if losses.coasts else 0.0
        decay, push = losses.decay[part], losses.push[part]
        kick_with_friction(bodies.v, bodies.total, bodies.mass, decay, push, losses.strength, h, coast)
    else:
        kick_with_drag(bodies.v, bodies.total, losses.decay[part], losses.push[part])


@lean_inner
def invalid(bodies, space):
    """Would the watchdog stop the run here?"""
    point, normal, _, _, _, _, _ = space.planes
    numbers, astray, _ = find_invalid(bodies.x, bodies.v, bodies.fixed, point, normal, space.lower, space.length)
    return numbers >= 0 or astray >= 0


@lean
def fixed_steps(axes, bodies, forces, losses, space, scheme, h, steps, watch):
    """Up to `steps` steps as of `Composition` or `Taylor`; from step `watch` on, they end where the watchdog would stop the run.

    Returns (steps done, wall hits, sums of forces, are the forces in `bodies.total` those of the present places?).
    """
    hits, sums, known = 0, 0, True
    for step in range(1, steps + 1):
        for part in range(len(scheme.kicks)):
            kicked, drifted = scheme.kicks[part] * h, scheme.drifts[part] * h
            if not known:
                sum_forces(axes, bodies.x, bodies.mass, bodies.fixed, forces, bodies.total)
                sums, known = sums + 1, True
            if scheme.taylor:
                rate = bodies.rate
                for i in range(len(rate)):
                    for k in range(len(axes)):
                        rate[i, k] = bodies.total[i, k]
                        if len(bodies.drag) > 0:
                            rate[i, k] -= bodies.drag[i] * bodies.v[i, k]
                kick(bodies.v, rate, kicked)
                hits += move(axes, bodies, space, losses.strength, drifted, 0.5 * h)
                kick(bodies.v, rate, kicked)
            else:
                kick_bodies(axes, bodies, forces, losses, part, kicked, drifted)
                if drifted != 0.0:
                    hits += move(axes, bodies, space, losses.strength, drifted, 0.5 * h)
            known = known and not (forces.attracts and drifted != 0.0)
        if step >= watch and (step - watch) % WATCH_EVERY == 0 and invalid(bodies, space):
            return step, hits, sums, known
    return steps, hits, sums, known


@lean
def adaptive_steps(axes, bodies, flat, forces, space, tables, work, begun, need, done, steps, h, watch, most):
    """Go on to `steps` steps as of `Adaptive`, of which so many are `done`, for at most about `most` sums of forces.

    need: END at first, and between two steps; else as `go_on` returned it. flat: x, v and total of the bodies as vectors (n d,).
    begun (2, n d): x and v at the start of the present step. Returns (need, steps done, sums of forces); need is END, with fewer
    steps than asked for, where the watchdog would stop the run.
    """
    x, v, total = flat
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
        need = go_on(x, v, bodies.id, total, work, tables)
        if need == STUCK:
            return need, done, sums
        if need == END:
            move(axes, bodies, space, 0.0, 0.0, 0.5 * h)
            done += 1
            if done == steps or (done >= watch and (done - watch) % WATCH_EVERY == 0 and invalid(bodies, space)):
                return need, done, sums
    return need, done, sums
