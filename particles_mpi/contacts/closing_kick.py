"""What the closing kick of a step gives to elastic contacts in its drift, under forces that depend on the place.

A contact at time t of a drift over h reflects the velocity that its partners have then. With the accelerations a0 at the start of
the drift and a1 at its end, and the velocity v of its middle, that is

    v(t) = v + a0 (t - h/2) + (a1 - a0) t^2/(2 h),

and so it is seen from both ends: the rule is the same backwards in time. But a1 is known after the drift only. So a contact is
computed with a0 (`velocity_flow`), and lacks the last term; an elastic one along the unit normal n, that reverses the velocity of
one partner relative to the other, lacks twice as much of its impulse,

    -mu (n.(a1 - a0) t^2/h) n,    a: of one partner minus that of the other, mu: their reduced mass.

Both get it in the closing kick. Without it all bounces err to one side, and the energy drifts with their number. Nothing is given
where accelerations do not change. What gets it is the last contact of a particle in a drift, if it is the last one of its partner
too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from particles_mpi.contacts.walls import finish_bounces
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import by_destination, send_rows
from particles_mpi.particles import Array, Particles, row_dot


class LastContacts(NamedTuple):
    """The last contacts in a drift of rows of this rank, m of them, none of a fixed one."""

    row: Array  # (m,)
    partner: Array  # (m,): an id, or a wall as -1 - wall
    time: Array  # (m,): since the start of the drift
    fixed_ids: Array  # (f,) of the fixed particles that are known here
    fixed_places: Array  # (f, d)


class ClosingKick:
    """Remembers the contacts of a drift until the accelerations at its end are known."""

    def __init__(self, rows: Particles, ranks: Communicator, length: Array, normal: Array):
        """length (d,): of the box on periodic axes, 0 on others; normal (walls, d): of walls."""
        self.rows, self.ranks, self.length, self.normal = rows, ranks, length, normal
        self.forget()

    def forget(self) -> None:
        """There was no contact."""
        self.on_walls: tuple[Array, ...] | None = None

    def note(self, last: LastContacts, h: float) -> None:
        """These were the last contacts of a drift over h, at the end of which the rows are now."""
        p, (row, partner, time, fixed_ids, fixed_places) = self.rows, last
        self.h, walls, pairs = h or 1.0, partner < 0, partner >= 0  # in no time nothing is lacking
        self.on_walls = row[walls], partner[walls], time[walls]
        self.in_pairs, partner, time = row[pairs], partner[pairs], time[pairs]
        ids, place = p.id[self.in_pairs], p.position[self.in_pairs] - p.velocity[self.in_pairs] * (h - time)[:, None]
        at_fixed = np.flatnonzero(np.isin(partner, fixed_ids))
        where = np.argsort(fixed_ids)
        where = where[np.searchsorted(fixed_ids, partner[at_fixed], sorter=where)]
        ids, partner = np.append(ids, partner[at_fixed]), np.append(partner, ids[at_fixed])
        self.table = {
            "id": ids,
            "low": np.minimum(ids, partner),
            "high": np.maximum(ids, partner),
            "time": np.append(time, time[at_fixed]),
            "place": np.append(place, fixed_places[where], axis=0),
        }

    def finish(self, a: Array) -> None:
        """The velocities after the closing kick, with accelerations a (n, d), get what they lack. Collective."""
        if self.on_walls is None:
            return
        p, before = self.rows, self.rows["total_acceleration"]
        finish_bounces(p.velocity, before, a, *self.on_walls, len(self.on_walls[0]), self.h, self.normal)
        n, rows = len(self.table["id"]), self.in_pairs
        change, w = np.zeros((n, p.dimension)), np.zeros(n)
        change[: len(rows)], w[: len(rows)] = a[rows] - before[rows], p.inverse_mass[rows]
        table = self.table | {"change": change, "inverse_mass": w}
        by, met = self.impulses(table)
        if self.ranks.size > 1:
            by[~met] = self.across_ranks({name: column[~met] for name, column in table.items()})
        p.velocity[rows] += by[: len(rows)]
        self.forget()

    def across_ranks(self, table: dict[str, Array]) -> Array:
        """`impulses` of contacts whose partners are on different ranks, which meet on a third one. Collective."""
        if not self.ranks.any(len(table["id"]) > 0):
            return np.empty_like(table["change"])
        rows, counts = by_destination(table["low"] % self.ranks.size, self.ranks.size)
        arrived, arriving = send_rows(self.ranks, table, rows, counts)
        by = np.empty_like(table["change"])
        answers = {"by": self.impulses(arrived)[0]}
        by[rows] = send_rows(self.ranks, answers, np.arange(len(answers["by"])), arriving)[0]["by"]
        return by

    def impulses(self, table: dict[str, Array]) -> tuple[Array, Array]:
        """By how much velocities change (m, d), and whose contact is the last one of both partners (m,)."""
        ids, low, high, time = (table[name] for name in ("id", "low", "high", "time"))
        by, met = np.zeros_like(table["change"]), np.zeros(len(ids), bool)
        order = np.lexsort((ids, time, high, low))
        same = [column[order[1:]] == column[order[:-1]] for column in (low, high, time)]
        both = np.flatnonzero(np.logical_and.reduce(same))
        one, other = order[both], order[both + 1]
        r = table["place"][one] - table["place"][other]
        for k in np.flatnonzero(self.length):
            r[:, k] -= self.length[k] * np.rint(r[:, k] / self.length[k])
        if r.shape[1] == 1:  # on a line there is one normal even for points
            r[:] = 1.0
        w = table["inverse_mass"]
        weight = row_dot(r, r) * (w[one] + w[other])
        lacking = row_dot(table["change"][one] - table["change"][other], r) * time[one] ** 2 / self.h
        impulse = np.divide(lacking, weight, out=np.zeros(len(one)), where=weight > 0.0)[:, None] * r
        by[one], by[other] = -impulse * w[one][:, None], impulse * w[other][:, None]
        met[one] = met[other] = True
        return by, met
