"""The parts of a step in the loops of `compiled_steps`: forces, kick, drift, contacts with walls. Scalars and arrays only."""

from typing import Any, NamedTuple

from particles_mpi.contacts.clearance import all_clear
from particles_mpi.contacts.persistent.on_walls import settle_on_walls
from particles_mpi.contacts.persistent.rows import hand_over
from particles_mpi.contacts.persistent.walls import near_walls, near_walls_among
from particles_mpi.contacts.rough import Rough
from particles_mpi.contacts.velocity_flow import Rates
from particles_mpi.contacts.walls import drift_with_walls
from particles_mpi.gravity.direct import attract_few
from particles_mpi.kernels.geometry import wrap
from particles_mpi.kernels.jit import in_place, kernel, lean_inner
from particles_mpi.kernels.motion import free_drift, kick, kick_with_drag, press, release
from particles_mpi.kernels.sliding import kick_with_friction
from particles_mpi.kernels.validity import find_invalid
from particles_mpi.particles import Array


class Bodies(NamedTuple):
    """Rows of particles; vectors are (n, d). Where they attract one another all of them, in the order of their ids."""

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


class StepLosses(NamedTuple):
    """What happens in a kick besides forces: `Damping` and `ConstantFriction`."""

    decay: Array  # (kicks, n), no row without either
    force_time: Array
    friction: bool
    strength: float
    coasts: bool  # does nothing but friction act?


class OnWalls(NamedTuple):
    """Contacts with walls that last, as of `PersistentContacts`; and room for what they give to rows."""

    kept: bool  # are there any?
    axes: tuple[float, ...]  # a 0.0 for each axis: these kernels begin sums with them
    supported: Array  # (n,) field of the rows
    point: Array  # of the walls that take energy
    normal: Array
    faces: tuple[Array, Array, bool]
    near: Array  # (n,): rows near walls
    pushed: Array  # (n,): rows that contacts push
    given: Array  # (n, d): velocities given to them
    had: Array  # (n,): rows whose rates have that in them
    alone: Array  # (n, d): accelerations of rows without what contacts give


class Space(NamedTuple):
    """Where the bodies move."""

    planes: tuple[Any, ...]  # `Planes`
    bounded: bool  # are there walls?
    rates: Array  # (n, d), (1, d) or (0, d): `Rates.a`
    own_rates: bool  # is it the sum of all forces, row by row?
    lower: Array  # (d,): of the box
    upper: Array
    length: Array
    notes: tuple[Any, ...]  # `WallNotes`, with room for hits only where the closing kick finishes bounces
    smooth: Rough  # for walls, which are not rough here
    reach: float  # rows that may be so near to walls are found, if contacts with walls last
    on_walls: OnWalls


@in_place
def sum_forces(axes, x, mass, fixed, forces, total):
    """total (n, d) = all forces at x, in the order of `Accelerations.sum`."""
    first, attracts, G, softening2, others, _ = forces
    if not attracts:  # they are the same everywhere
        return
    attract_few(axes, x, mass, softening2, total)
    for i in range(len(x)):
        for k in range(len(axes)):
            total[i, k] = first[i, k] + G * total[i, k]
            for other in range(len(others)):
                total[i, k] += others[other, i, k]
            if fixed[i] != 0:
                total[i, k] = 0.0


@kernel(_nrt=True)  # also where a @lean kernel calls it
def keep_on_walls(axes, bodies, losses, part, space, h, kicked, near):
    """Keep contacts with walls, as `PersistentContacts.keep` does, after kick number `part` over a time `kicked`.

    near: how many rows of `on_walls.near` are filled, with the rows near walls; -1 if they are not known. Returns (how many rows
    contacts push, for how many rows contacts were solved).
    """
    on_walls = space.on_walls
    x, v, a, radius, supported = bodies.x, bodies.v, bodies.total, bodies.radius, on_walls.supported
    planes = on_walls.point, on_walls.normal
    if near >= 0:
        rows = near_walls_among(on_walls.axes, on_walls.near[:near], x, v, a, radius, supported, h, planes)
    else:
        rows = near_walls(on_walls.axes, x, v, a, radius, bodies.fixed, supported, h, on_walls.faces, planes)
    if len(rows) == 0:
        return 0, 0
    fields = x, v, radius, bodies.mass, bodies.fixed, supported
    settled, held = settle_on_walls(on_walls.axes, rows, fields, a, h, space.length, on_walls.faces, planes)
    changed, by = hand_over(rows, settled, held, v, supported)
    for r in range(len(changed)):
        on_walls.pushed[r] = changed[r]
        undamped = losses.force_time[part][changed[r]] / kicked if len(losses.force_time) > 0 else 1.0
        for k in range(len(axes)):
            on_walls.given[r, k] = by[r, k] / undamped
    return len(changed), len(rows)


@in_place
def set_rates(axes, bodies, space, before, pushed, t_mid):
    """Set the rates of rows, as `Drift.rates`: accelerations, and what contacts add for the first `pushed` of `on_walls.pushed`.

    before: for how many rows, those in `on_walls.had`, rates still have such an addition from the last drift; -1 if there are
    none yet.
    """
    rates, on_walls, total = space.rates, space.on_walls, bodies.total
    for i in range(len(total) if before < 0 else before):
        row = i if before < 0 else on_walls.had[i]
        for k in range(len(axes)):
            rates[row, k] = total[row, k]
    for r in range(pushed):
        on_walls.had[r] = on_walls.pushed[r]
        for k in range(len(axes)):
            rates[on_walls.pushed[r], k] += on_walls.given[r, k] / t_mid


@in_place
def move(axes, bodies, space, strength, h, t_mid):
    """Drift as `Drift.advance` does without pairs; returns what `drift_with_walls` does, with near rows in `on_walls.near`."""
    hits, missed, near, noted = 0, 0, 0, 0
    if space.bounded:
        rates = Rates(space.rates, bodies.drag, strength, t_mid)
        fields = bodies.x, bodies.v, bodies.radius, bodies.inverse_mass
        walls = space.planes, rates, space.smooth, space.reach, space.on_walls.near
        hits, missed, near, noted = drift_with_walls(axes, *fields, space.notes, h, *walls)
    else:
        free_drift(bodies.x, bodies.v, h)
    wrap(bodies.x, space.lower, space.upper, space.length)
    return hits, missed, near, noted


@in_place
def kick_bodies(bodies, forces, losses, space, part, h, drift):
    """The kick of `Kick.force_and_losses`, number `part` of a step; `drift`: length of the drift that follows."""
    if len(losses.decay) == 0:
        if forces.any:
            kick(bodies.v, bodies.total, h)
    elif losses.friction:
        coast = drift if losses.coasts else 0.0
        decay, force_time, on_walls = losses.decay[part], losses.force_time[part], space.on_walls
        if on_walls.kept:
            press(bodies.total, bodies.fixed, on_walls.supported, space.rates, on_walls.alone)
        kick_with_friction(bodies.v, bodies.total, bodies.mass, decay, force_time, losses.strength, h, coast)
        if on_walls.kept:
            release(bodies.v, bodies.total, bodies.fixed, on_walls.supported, space.rates, on_walls.alone, force_time)
    else:
        kick_with_drag(bodies.v, bodies.total, losses.decay[part], losses.force_time[part])


@in_place
def may_meet(axes, bodies, space, h):
    """May a particle meet another one or a wall in a drift over h?"""
    return not all_clear(axes, bodies.x, bodies.v, bodies.radius, h, space.length, space.bounded, space.planes)


@lean_inner
def invalid(axes, bodies, space):
    """Would the watchdog stop the run here?"""
    numbers, astray, _ = find_invalid(axes, bodies.x, bodies.v, bodies.fixed, space.planes, space.lower, space.length)
    return numbers >= 0 or astray >= 0
