"""The closing kick of a step completes the impulses of the contacts in its drift, under forces that depend on the position.

A contact at time t of a drift over h takes place between the velocities that its partners have then. With the accelerations a0 at
the start of the drift and a1 at its end, and the velocity v of its middle, that is

    v(t) = v + a0 (t - h/2) + (a1 - a0) t^2/(2 h),

and it is the same from both ends: the rule is the same backwards in time. But a1 is known only after the drift. So a contact is
computed with a0 (`velocity_flow`), without the last term. The closing kick gives both partners what the impulse lacked,

    -(1 + e) mu (n.u) n,    u = (a1 - a0) t^2/(2 h),    a: of one partner minus that of the other, mu: their reduced mass,

with the unit vector n between their centres. Rough spheres that stick for any impulse also get what it lacked across n, as in
`rough`. Otherwise all bounces would err to one side, and the energy would drift with their number. This impulse acts at the
positions at the end of the drift, so that angular momentum is kept; it is 0 where accelerations do not change. Only a contact
that is the last one of both its partners in the drift is completed.
"""

from __future__ import annotations

from math import inf
from typing import NamedTuple

import numpy as np

from particles_mpi.contacts.rough import BETA_0, FRICTION, plane_of
from particles_mpi.contacts.walls import finish_bounces
from particles_mpi.kernels.geometry import image_shifts
from particles_mpi.parallel.exchange import by_destination, send_rows
from particles_mpi.particles import Array, Particles, row_dot, rows_with
from particles_mpi.scene.active import ActiveEffects
from particles_mpi.scene.effect import Context


class LastContacts(NamedTuple):
    """The last contacts in a drift of rows of this rank, m of them, none of a fixed one."""

    row: Array  # (m,)
    partner: Array  # (m,): an id, or a wall as -1 - wall
    time: Array  # (m,): since the start of the drift
    fixed: dict[str, Array]  # "id" (f,), "place" (f, d) and "radius" (f,) of the fixed particles that are known here


class ClosingKick:
    """Remembers the contacts of a drift until the accelerations at its end are known."""

    def __init__(self, rows: Particles, context: Context, effects: ActiveEffects):
        """`restitution`, `law` (see `contacts.rough.Rough`): of pairs, then of each plane."""
        self.rows, self.ranks, self.length, self.planes = rows, context.ranks, context.length, effects.planes
        self.restitution = np.append(effects.pairs.loss.restitution if effects.pairs else 1.0, self.planes.restitution)
        self.law, self.rough = effects.surfaces, effects.rough
        self.forget()

    def forget(self) -> None:
        """Forget the contacts of the drift: there is nothing to complete."""
        self.last: LastContacts | None = None

    def note(self, last: LastContacts, h: float) -> None:
        """Remember the last contacts of a drift over h, at the end of which the rows are now."""
        self.last, self.h = last, h or 1.0  # in no time nothing is lacking

    def finish(self, a: Array) -> None:
        """Complete the impulses, after the closing kick with accelerations a (n, d). Changes velocities and spins. Collective."""
        if self.last is None:
            return
        p, (row, partner, time, fixed) = self.rows, self.last
        self.forget()
        before = p.arrays.get("free_acceleration", p["total_acceleration"])
        if not self.rough:
            walls, pairs = partner < 0, partner >= 0
            hits = row[walls], partner[walls], time[walls]
            finish_bounces(p.velocity, before, a, *hits, len(hits[0]), self.h, self.planes.normal, self.planes.restitution)
            row, partner, time = row[pairs], partner[pairs], time[pairs]
        if self.ranks.size == 1 and not len(row):  # most steps of few particles, which would take twice as long
            return
        table = self.table(row, partner, time, fixed, a[row] - before[row])
        by, met = self.impulses(table)
        if self.ranks.size > 1:
            by[~met] = self.across_ranks({name: column[~met] for name, column in table.items()})
        p.velocity[row] += by[: len(row), : p.dimension]
        if self.rough:
            p["spin"][row] += by[: len(row), p.dimension :]

    def table(self, row: Array, partner: Array, time: Array, fixed: dict[str, Array], change: Array) -> dict[str, Array]:
        """Return a table of all partners of contacts: first our rows, then partners that are fixed, and walls."""
        p = self.rows
        ours = {
            "id": p.id[row],
            "place": p.position[row],
            "change": change,
            "radius": p.radius[row],
            "inverse_mass": p.inverse_mass[row],
            "inverse_inertia": p.inverse_inertia[row] if self.rough else np.zeros(len(row)),
        }
        at_fixed = np.flatnonzero(np.isin(partner, fixed["id"]))
        where = rows_with(fixed["id"], partner[at_fixed])
        at_wall = np.flatnonzero(partner < 0)
        other = np.append(at_fixed, at_wall)
        theirs = {name: np.zeros_like(column[other]) for name, column in ours.items()} | {
            "id": partner[other],
            "place": np.append(fixed["place"][where], ours["place"][at_wall], axis=0),
            "radius": np.append(fixed["radius"][where], np.zeros(len(at_wall))),
        }
        both = {name: np.append(column, theirs[name], axis=0) for name, column in ours.items()}
        partners, times = np.append(partner, ours["id"][other]), np.append(time, time[other])
        return both | {"low": np.minimum(both["id"], partners), "high": np.maximum(both["id"], partners), "time": times}

    def across_ranks(self, table: dict[str, Array]) -> Array:
        """Return `impulses` of contacts between two ranks: a third one gets both partners and answers. Collective."""
        if not self.ranks.any(len(table["id"]) > 0):
            return np.empty((0, 1))
        rows, counts = by_destination(table["low"] % self.ranks.size, self.ranks.size)
        arrived, arriving = send_rows(self.ranks, table, rows, counts)
        found = self.impulses(arrived)[0]
        answered = send_rows(self.ranks, {"by": found}, np.arange(len(found)), arriving)[0]["by"]
        by = np.empty_like(answered)
        by[rows] = answered
        return by

    def impulses(self, table: dict[str, Array]) -> tuple[Array, Array]:
        """Return changes (m, d + spins) of velocities and spins, and which rows (m,) have their partner in the table."""
        d, ids, w = self.rows.dimension, table["id"], table["inverse_mass"]
        spins = d * (d - 1) // 2 if self.rough else 0
        by, met = np.zeros((len(ids), d + spins)), np.zeros(len(ids), bool)
        names = "low", "high", "time"
        order = np.lexsort((ids, *(table[name] for name in reversed(names))))
        same = [table[name][order[1:]] == table[name][order[:-1]] for name in names]
        both = np.flatnonzero(np.logical_and.reduce(same))
        one, other = order[both], order[both + 1]
        met[one] = met[other] = True
        r = table["place"][one] - table["place"][other]
        r -= image_shifts(r, self.length)
        if d == 1:  # on a line there is one normal even for points
            r[:] = 1.0
        distance = np.sqrt(row_dot(r, r))
        normal = np.divide(r, distance[:, None], out=np.zeros_like(r), where=distance[:, None] > 0.0)
        kind = np.where(table["low"][one] < 0, -table["low"][one], 0)  # a row of `law`
        wall = kind > 0
        normal[wall] = -self.planes.normal[kind[wall] - 1]
        u = (table["change"][one] - table["change"][other]) * (0.5 * table["time"][one] ** 2 / self.h)[:, None]
        along = row_dot(u, normal)
        impulse = (-(1.0 + self.restitution[kind]) * along / (w[one] + w[other]))[:, None] * normal
        if self.rough:
            sizes = table["radius"][one] + table["radius"][other]
            scale = np.divide(distance, sizes, out=np.zeros_like(sizes), where=sizes > 0.0)
            scale[wall] = 1.0
            arm, q = scale * np.stack((table["radius"][one], table["radius"][other])), table["inverse_inertia"]
            mobility = w[one] + w[other] + arm[0] ** 2 * q[one] + arm[1] ** 2 * q[other]
            grip = np.where(self.law[kind, FRICTION] == inf, (1.0 + self.law[kind, BETA_0]) / mobility, 0.0)
            impulse -= grip[:, None] * (u - along[:, None] * normal)
            torque = torques(normal, impulse)
            by[one, d:], by[other, d:] = -(q[one] * arm[0])[:, None] * torque, -(q[other] * arm[1])[:, None] * torque
        by[one, :d], by[other, :d] = w[one][:, None] * impulse, -w[other][:, None] * impulse
        return by, met


def torques(normal: Array, impulse: Array) -> Array:
    """Return n x J (m, d(d-1)/2) of unit vectors and impulses (m, d), in the components of spins."""
    d = normal.shape[1]
    found = np.empty((len(normal), d * (d - 1) // 2))
    for p in range(d):
        for q in range(p + 1, d):
            c, sign = plane_of((0,) * d, p, q)
            found[:, c] = sign * (normal[:, p] * impulse[:, q] - normal[:, q] * impulse[:, p])
    return found
