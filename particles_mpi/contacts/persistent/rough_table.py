"""The contacts of rough spheres as a table: what `rough_iterations` needs of each half-edge, and how long its steps may be."""

from math import sqrt

import numpy as np

from particles_mpi.contacts.persistent.problem import IMPULSE, NORMAL, STEP, fourth_power_norm
from particles_mpi.contacts.rough import plane_of
from particles_mpi.kernels.jit import inner, kernel
from particles_mpi.particles import spin_components

# Columns behind the d components of the normal
ARM, OTHER_ARM, MU, RESISTANCE, SPIN_SHARE, SLIDE_STEP, ROLL_STEP, TANGENTIAL = range(8)
# From TANGENTIAL on stand four vectors: the impulse of the contact across its normal, and the same extrapolated; its couple, and
# the same extrapolated.


def impulse_columns(d: int, rough: bool) -> list[int]:
    """The columns of a table that hold the impulses of contacts: along the normal, and, if rough, across it, and couples."""
    across = NORMAL + d + TANGENTIAL
    couple = across + 2 * d
    return [IMPULSE, *range(across, across + d), *range(couple, couple + spin_components(d))] if rough else [IMPULSE]


@inner(inline="always")
def spins_of(axes):
    """Components of a spin."""
    return len(axes) * (len(axes) - 1) // 2


@inner(inline="always")
def arms_of(radius, other_radius, gap):
    """Lengths of the arms of two spheres: radii and shares of the gap, so that an impulse across it does not turn the pair."""
    both = radius + other_radius
    stretched = 1.0 + gap / both if both > 0.0 else 1.0
    return radius * stretched, other_radius * stretched


@kernel
def rough_table(axes, smooth, wall, start, partner, gap, radii, inverse_inertia, w, which, surfaces, tangential):
    """The table of half-edges from that of smooth spheres (m, 5 + d) with the bounds of `bound_rough`.

    wall (m,): which walls are partners, -1 for rows; gap (m,): to the partner; radii (size + 1,); surfaces (2, m): mu and
    resistance; tangential (m, d + s): the impulse across the normal, and the couple. What is not across the normal any longer is
    left out.
    """
    d, s = len(axes), spins_of(axes)
    table = np.zeros((len(partner), NORMAL + d + TANGENTIAL + 2 * d + 2 * s))
    for i in range(len(start) - 1):
        for e in range(start[i], start[i + 1]):
            j = partner[e]
            both, row = w[i] + w[j], table[e]
            row[: NORMAL + d] = smooth[e]
            at = NORMAL + d
            arm, far = arms_of(radii[i], radii[j], gap[e]) if wall[e] < 0 else (radii[i], 0.0)
            row[at + ARM], row[at + OTHER_ARM] = arm, far
            row[at + MU], row[at + RESISTANCE] = surfaces[0, e], surfaces[1, e]
            row[at + SPIN_SHARE] = inverse_inertia[i] / both
            if not which[e]:
                continue
            mobility = both + (arm * arm * inverse_inertia[i] + far * far * inverse_inertia[j])
            row[at + SLIDE_STEP] = both / mobility * row[STEP]
            turns = inverse_inertia[i] + inverse_inertia[j]
            row[at + ROLL_STEP] = both / turns * row[STEP] if turns > 0.0 and surfaces[1, e] > 0.0 else 0.0
            along = 0.0
            for k in range(d):
                along += tangential[e, k] * smooth[e, NORMAL + k]
            for k in range(d):
                row[at + TANGENTIAL + k] = row[at + TANGENTIAL + d + k] = tangential[e, k] - along * smooth[e, NORMAL + k]
            for c in range(s):
                row[at + TANGENTIAL + 2 * d + c] = row[at + TANGENTIAL + 2 * d + s + c] = tangential[e, d + c]
    return table


@kernel
def bound_rough(axes, start, partner, normal, wall, gap, radii, inverse_inertia, w, which, resistance, bound):
    """Of each row a bound of the largest eigenvalue of what its contacts do to its velocity and spin: see `problem.bound_rows`.

    Steps across the normal are shorter by the part that translation has in what such an impulse moves, of couples too.
    """
    d, s = len(axes), spins_of(axes)
    size = d + s
    m, t, lever = np.empty((size, size)), np.empty((size, size)), np.empty((s, d))
    for i in range(len(start) - 1):
        m[:] = 0.0
        for e in range(start[i], start[i + 1]):
            if not which[e]:
                continue
            j = partner[e]
            arm, far = arms_of(radii[i], radii[j], gap[e]) if wall[e] < 0 else (radii[i], 0.0)
            both, turns = w[i] + w[j], inverse_inertia[i] + inverse_inertia[j]
            part = both / (both + (arm * arm * inverse_inertia[i] + far * far * inverse_inertia[j]))
            lever[:] = 0.0  # what an impulse does to the spin: - arm n x
            for p in range(d):
                for q in range(p + 1, d):
                    c, sign = plane_of(axes, p, q)
                    lever[c, q] -= sign * arm * normal[e, p]
                    lever[c, p] += sign * arm * normal[e, q]
            for k in range(d):
                for n in range(d):
                    along = normal[e, k] * normal[e, n]
                    m[k, n] += w[i] * (along + part * ((1.0 if k == n else 0.0) - along))
                for c in range(s):  # levers are across the normal already
                    cross = part * sqrt(w[i] * inverse_inertia[i]) * lever[c, k]
                    m[k, d + c] += cross
                    m[d + c, k] += cross
            for b in range(s):
                for c in range(s):
                    for k in range(d):
                        m[d + b, d + c] += part * inverse_inertia[i] * lever[b, k] * lever[c, k]
                if turns > 0.0 and resistance[e] > 0.0:
                    m[d + b, d + b] += both * inverse_inertia[i] / turns
        trace = 0.0
        for k in range(size):
            trace += m[k, k]
        bound[i] = 0.0
        if not trace > 0.0:
            continue
        m /= trace
        bound[i] = trace * fourth_power_norm(size, m, t)
