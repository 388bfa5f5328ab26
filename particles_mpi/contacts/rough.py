"""The contact of rough spheres: friction and spin. Scalars and arrays only.

Three parameters say what happens (O. Walton and R. Braun, J. Rheol. 30, 949 (1986); S. Foerster, M. Louge, H. Chang and K. Allia,
Phys. Fluids 6, 1108 (1994)). With k the unit vector from j to i, a = |x_i - x_j| R/(R_i + R_j) the arm of each, w = 1/m and
q = 1/I, the surfaces meet with the velocity

    u = v_i - v_j - (a_i s_i + a_j s_j) x k       (s: the spins, angular velocities).

The impulse on i is J = J_n k + J_t: J_n = -(1 + e) u.k / (w_i + w_j) as for smooth spheres, and, with u_t the part of u across k,

    J_t = -(1 + beta_0) u_t / (w_i + w_j + a_i^2 q_i + a_j^2 q_j)     where that is at most mu J_n (the surfaces stick),
    J_t = -mu J_n u_t/|u_t|                                           otherwise (they slide).

Then v_i += w_i J, v_j -= w_j J, s_i -= a_i q_i k x J and s_j -= a_j q_j k x J, which keeps linear and angular momentum.
A wall has no w and no q. A point, R = 0, does not turn: no a, and q = 0; a small sphere does, for its a^2 q is as that of a large
one. Spins have d(d-1)/2 components: one in the plane, three in space.
"""

from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from particles_mpi.contacts.velocity_flow import change_of, row_of
from particles_mpi.kernels.jit import inner, lean_inner
from particles_mpi.particles import Array

FRICTION, BETA_0 = 0, 1  # columns of `law`
PAIRS = 0  # row of `law`; that of wall w is 1 + w


class Rough(NamedTuple):
    """What contacts of rough spheres need to know of n particles. In a smooth scene `spin` and `inverse_inertia` have no rows."""

    spin: Array  # (n, d(d-1)/2) angular velocities
    inverse_inertia: Array  # (n,) inverse moments of inertia, 0 for what does not turn
    law: Array  # (1 + walls, 2): FRICTION mu, 0 where contacts are smooth, and BETA_0 restitution beta_0
    normal: Array  # (d,) scratch
    impulse: Array  # (d,) scratch


def takes_energy(surface: tuple[float, float]) -> bool:
    """Does a contact of surfaces with (mu, beta_0) take energy? Not if it sticks for any impulse and reverses the whole slip."""
    return surface[0] > 0.0 and surface != (inf, 1.0)


def no_spins(dimension: int, law: Array) -> Rough:
    """Return the `Rough` of a smooth scene."""
    return Rough(np.empty((0, 1)), np.empty(0), law, np.empty(dimension), np.empty(dimension))


@inner(inline="always")
def plane_of(axes, p, q):
    """(component, sign) of the rotation in the plane of the axes p < q: spin x k has there -sign spin k_q, and sign spin k_p."""
    return 2 * len(axes) - 3 - p - q, (-1.0 if q - p == 2 else 1.0)


@lean_inner
def strike_pair(axes, v, column, rough, r, i, j, spheres, t, restitution, rates):
    """Apply the law of a contact of rows i and j, r = x_i - x_j (d,) apart, at time t; in place.

    Returns (1+e) r.u before the impulse, as `law.apply_impulse` does, with v and column as there. `spheres`: inverse masses and
    radii of i and j.
    """
    w_i, w_j, radius_i, radius_j = spheres
    r2 = 0.0
    for k in range(len(axes)):
        r2 += r[k] * r[k]
    distance = sqrt(r2)
    if distance == 0.0:  # spheres smaller than round-off of their places: there is no normal
        return 0.0
    for k in range(len(axes)):
        rough.normal[k] = r[k] / distance
    part = distance / (radius_i + radius_j) if radius_i + radius_j > 0.0 else 0.0
    bodies = w_i, w_j, part * radius_i, part * radius_j
    return distance * strike(axes, v, column, rough, np.int64(PAIRS), i, j, bodies, t, restitution, rates)


@lean_inner
def strike_wall(axes, v, column, rough, i, wall, normal, w, radius, t, restitution, rates):
    """Apply the law of a contact of row i with a wall at time t; in place. See `walls.bounce`."""
    for k in range(len(axes)):
        rough.normal[k] = normal[wall, k]
    bodies = w, 0.0, radius, 0.0
    strike(axes, v, column, rough, 1 + wall, i, np.int64(-1), bodies, t, restitution, rates)


@lean_inner
def strike(axes, v, column, rough, which, i, j, bodies, t, restitution, rates):
    """Apply the law of a contact along the unit vector `rough.normal`; j < 0 is a wall; `bodies`: w and arms of i and j.

    It takes place between the velocities of its own moment (see `velocity_flow`). Partners so slow that they would have moved
    apart at that moment, or would approach after it, collide with the velocities of their segments. Returns (1+e) u.k before the
    impulse, which is minus the change of u.k by it; 0 if they do not approach.
    """
    if len(rates.a) > 0:
        change = strike_at(axes, v, column, rough, which, i, j, bodies, t - rates.t_mid, restitution, rates)
        if change != 0.0:
            return change
    return strike_at(axes, v, column, rough, which, i, j, bodies, 0.0, restitution, rates)


@lean_inner
def strike_at(axes, v, column, rough, which, i, j, bodies, tau, restitution, rates):
    """`strike` a time tau after the middle of the step; returns 0, and changes nothing, where there is no contact then."""
    w_i, w_j, _, _ = bodies
    impulse, normal, a = rough.impulse, rough.normal, rates.a
    moved = tau != 0.0
    at, to = (row_of(i, rates), row_of(j, rates)) if moved else (i, j)
    decay_i, force_time_i = change_of(i, speed2(axes, v, column, i), w_i, tau, rates) if moved else (1.0, 0.0)
    decay_j, force_time_j = change_of(j, speed2(axes, v, column, j), w_j, tau, rates) if moved and j >= 0 else (1.0, 0.0)
    approach, offset = 0.0, 0.0
    for k in range(len(axes)):
        impulse[k] = decay_i * v[i, column + k] - (decay_j * v[j, column + k] if j >= 0 else 0.0)
        if moved:
            gained = force_time_i * a[at, k] - (force_time_j * a[to, k] if j >= 0 else 0.0)
            impulse[k] += gained
            offset += gained * normal[k]
        approach += impulse[k] * normal[k]
    if not approach < 0.0:
        return 0.0
    to_impulse(axes, rough, which, i, j, bodies, approach, restitution)
    if not moved:
        for k in range(len(axes)):
            v[i, column + k] += w_i * impulse[k]
            if j >= 0:
                v[j, column + k] -= w_j * impulse[k]
        turn_both(axes, rough, i, j, bodies)
        return (1.0 + restitution) * approach
    v2_i, v2_j = 0.0, 0.0
    for k in range(len(axes)):
        v2_i += (decay_i * v[i, column + k] + force_time_i * a[at, k] + w_i * impulse[k]) ** 2
        if j >= 0:
            v2_j += (decay_j * v[j, column + k] + force_time_j * a[to, k] - w_j * impulse[k]) ** 2
    back_i, pull_i = change_of(i, v2_i, w_i, -tau, rates)
    back_j, pull_j = change_of(j, v2_j, w_j, -tau, rates) if j >= 0 else (1.0, 0.0)
    left_i, left_j = back_i * force_time_i + pull_i, back_j * force_time_j + pull_j  # 0 without a loss
    leaving = 0.0
    for k in range(len(axes)):
        after = back_i * decay_i * v[i, column + k] + back_i * w_i * impulse[k] + left_i * a[at, k]
        if j >= 0:
            after -= back_j * decay_j * v[j, column + k] - back_j * w_j * impulse[k] + left_j * a[to, k]
        leaving += after * normal[k]
    if leaving < 0.0 and (offset != 0.0 or decay_i != decay_j):  # else it is round-off
        return 0.0
    for k in range(len(axes)):
        v[i, column + k] = back_i * decay_i * v[i, column + k] + back_i * w_i * impulse[k] + left_i * a[at, k]
        if j >= 0:
            v[j, column + k] = back_j * decay_j * v[j, column + k] - back_j * w_j * impulse[k] + left_j * a[to, k]
    turn_both(axes, rough, i, j, bodies)
    return (1.0 + restitution) * approach


@lean_inner
def speed2(axes, v, column, i):
    """The square of the speed of row i."""
    total = 0.0
    for k in range(len(axes)):
        total += v[i, column + k] * v[i, column + k]
    return total


@lean_inner
def to_impulse(axes, rough, which, i, j, bodies, approach, restitution):
    """Turn rough.impulse (d,), which is v_i - v_j, into the impulse J on i; `approach`: u.k."""
    w_i, w_j, arm_i, arm_j = bodies
    spin, inverse_inertia, normal, u = rough.spin, rough.inverse_inertia, rough.normal, rough.impulse
    mobility = w_i + w_j + (arm_i * arm_i * inverse_inertia[i] + (arm_j * arm_j * inverse_inertia[j] if j >= 0 else 0.0))
    for p in range(len(axes)):
        for q in range(p + 1, len(axes)):
            c, sign = plane_of(axes, p, q)
            rim = sign * (arm_i * spin[i, c] + (arm_j * spin[j, c] if j >= 0 else 0.0))
            u[p] += rim * normal[q]
            u[q] -= rim * normal[p]
    slip2 = 0.0
    for k in range(len(axes)):
        u[k] -= approach * normal[k]
        slip2 += u[k] * u[k]
    slip = sqrt(slip2)
    normal_impulse = -(1.0 + restitution) * approach / (w_i + w_j)
    grip = (1.0 + rough.law[which, BETA_0]) * slip / mobility
    most = rough.law[which, FRICTION] * normal_impulse
    held = (grip if grip <= most else most) / slip if slip > 0.0 else 0.0
    for k in range(len(axes)):
        u[k] = normal_impulse * normal[k] - held * u[k]


@lean_inner
def turn_both(axes, rough, i, j, bodies):
    """Change the spins of i and j by the impulse `rough.impulse`."""
    _, _, arm_i, arm_j = bodies
    spin, inverse_inertia, normal, impulse = rough.spin, rough.inverse_inertia, rough.normal, rough.impulse
    for p in range(len(axes)):
        for q in range(p + 1, len(axes)):
            c, sign = plane_of(axes, p, q)
            torque = sign * (normal[p] * impulse[q] - normal[q] * impulse[p])
            spin[i, c] -= inverse_inertia[i] * arm_i * torque
            if j >= 0:
                spin[j, c] -= inverse_inertia[j] * arm_j * torque
