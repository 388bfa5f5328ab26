"""Contacts that stay: spheres that forces press onto walls and one another come to rest there, and do not sink or rattle.

A sphere that bounces lower and lower under a force would meet the wall more and more often, and never stop. Here a contact
that is pressed along its normal, and whose next bounce would be over within a step or so, is *kept*: after every kick
velocities become those nearest to them, in kinetic energy, with which no kept contact closes by more than its gap in a step
(`solver`). That takes energy or none, for to be at rest is always allowed; it moves nothing, and all other contacts, with
their restitution, it leaves to the drift: the faster ones, and those that nothing presses, as of balls side by side on a floor.

*Crowds.* A sphere that hits a pile sets all of it rattling, without end: every contact of it would take place hundreds of times
in a step. A drift in which particles have many contacts within a hundredth of it is therefore done again, after `hold`: there
they and all that touch them keep their contacts at any speed, as if e = 0, which is what many contacts with e < 1 come to.

Involved are few, as a rule: those that were supported before, those near walls, and those near these; where forces press free
ones onto one another, all that touch. All ranks work them out together, in the order of ids, so that results do not depend on
the ranks.
"""

from __future__ import annotations

import numpy as np

from particles_mpi.contacts.persistent.detection import (
    HELD,
    SLOW,
    bear,
    close_by_test,
    contacts,
    near_walls,
    pressing,
    slow,
    spread,
    within,
)
from particles_mpi.contacts.persistent.solver import BETTER, project, project_each
from particles_mpi.contacts.walls import Planes
from particles_mpi.kernels.fingerprint import fingerprint
from particles_mpi.kernels.markers import CROWD, PRESSED
from particles_mpi.neighbours.candidates import touching
from particles_mpi.neighbours.halo_region import fetch_near_rows
from particles_mpi.neighbours.trajectories import AT_REST
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import allgather_rows
from particles_mpi.particles import Array, Particles, places_of, row_dot, rows_of
from particles_mpi.timers import Timers

PRECISE = 1e-11  # of the slow speed: approach that does not matter
NOTHING = np.empty(0, np.int64), np.empty(0)
CLOSE = 1.0 + 1e-9  # times the widths, so that ranks agree on who is near the border, whatever the round-off
FEW = 64  # rows: so many look for partners among all others


class Rest:
    """Keeps the slow contacts of particles: with one another if `pairs`, and with those of the planes that take energy.

    `bound`: above all ids. `uniform`: all forces give all particles the same acceleration, so that free ones never press onto
    one another.
    """

    def __init__(
        self, ranks: Communicator, bound: int, length: Array, pairs: bool, planes: Planes, uniform: bool, timers: Timers
    ):
        self.ranks, self.bound, self.length = ranks, bound, length
        self.pairs, self.uniform, self.timers = pairs, uniform, timers
        self.memory = NOTHING
        self.looked: tuple[tuple[int, ...], int] = (), 0
        self.found = np.empty(0, np.int64)  # places, and fingerprint of widths; who is close
        self.walls = planes.lower, planes.upper, planes.oblique, planes.point[planes.lossy], planes.normal[planes.lossy]
        self.given: tuple[Array, Array] = NOTHING  # our rows in the last `keep`, and the velocities that contacts gave them
        self.awake = True  # else particles pass through one another and through walls

    def forget(self) -> None:
        """Nothing is known of what contacts carried."""
        self.memory = NOTHING

    def keep(self, p: Particles, a: Array, h: float) -> None:
        """After a kick by accelerations a (n, d) in a step of h: velocities that keep slow contacts. Collective with pairs."""
        self.given = NOTHING
        if not self.awake:
            return
        with self.timers("rest"):
            state = p.position, p.velocity, a, p.radius, p.fixed, p["supported"]
            involved = near_walls(*state, h, *self.walls)
            if self.pairs and not self.uniform:
                involved = np.union1d(involved, self.close(p, a, h))
            if not (self.ranks.allreduce_sum(len(involved))[0] if self.pairs else len(involved)):
                return
            rows = self.rows(p, a, h, involved)
            rows["supported"] = np.minimum(rows["supported"], PRESSED)
            if self.pairs:
                rows = allgather_rows(self.ranks, rows)
                while self.uniform:
                    joining = allgather_rows(self.ranks, self.joining(p, a, h, rows, involved))
                    rows = {name: np.concatenate((column, joining[name])) for name, column in rows.items()}
                    if len(self.memory[0]) or not len(joining["id"]):
                        break
                    involved = np.sort(rows["row"][rows["rank"] == self.ranks.rank])
                rows = rows_of(rows, np.argsort(rows["id"]))
            self.memory = self.solve(p, rows, h, self.near(rows, self.pairs))

    def hold(self, p: Particles, a: Array, h: float) -> None:
        """As `keep`, but contacts with those that are CROWD, and with all who touch them, are kept at any speed. Collective."""
        with self.timers("rest"):
            rows = self.rows(p, a, h, np.arange(len(p)))
            rows = allgather_rows(self.ranks, rows)
            rows = rows_of(rows, np.argsort(rows["id"]))
            touch = rows["wide"]
            fast = rows["radius"] + h * np.sqrt(row_dot(rows["velocity"], rows["velocity"]))
            first, second = self.near(rows | {"wide": np.maximum(touch, fast)}, True)
            spread(rows["position"], touch, first, second, self.length, rows["supported"])
            self.solve(p, rows, h, (first, second), again=True)

    def rows(self, p: Particles, a: Array, h: float, which: Array) -> dict[str, Array]:
        """What all must know of our rows `which`; `wide` is the radius and the widest slow gap."""
        chosen = p.select(which)
        rows = {name: chosen[name] for name in ("id", "position", "velocity", "radius", "supported")}
        push = SLOW * h * a[which]
        return rows | {
            "push": push,
            "wide": widths(rows["radius"], push, h),
            "w": chosen.inverse_mass,
            "row": which,
            "rank": np.full(len(which), self.ranks.rank),
        }

    def close(self, p: Particles, a: Array, h: float) -> Array:
        """Our rows that are no further from another, ours or not, than their widths. Collective."""
        wide, w = widths(p.radius, SLOW * h * a, h), p.inverse_mass
        here = places_of(p), fingerprint(np.stack((wide, w)))
        if self.ranks.allreduce_min(float(here == self.looked))[0]:  # as at the end of the last step
            return self.found
        known = {"id": p.id, "position": p.position, "wide": wide, "w": w}
        if self.ranks.size > 1:
            still = p.position, np.zeros_like(p.position), CLOSE * wide
            _, _, _, theirs, _ = fetch_near_rows(self.ranks, known, still, AT_REST, self.length)
            known = {name: np.concatenate((column, theirs[name])) for name, column in known.items()}
        first, second = touching(known["position"], known["wide"], known["w"], known["id"], self.length)
        rows = np.concatenate((first, second))
        self.looked, self.found = here, np.unique(rows[rows < len(p)])
        return self.found

    def joining(self, p: Particles, a: Array, h: float, rows: dict[str, Array], known: Array) -> dict[str, Array]:
        """Those of our rows, but for the `known`, that touch one of `rows`, give or take a slow gap."""
        low, high = np.full(len(self.length), -np.inf), np.full(len(self.length), np.inf)
        for k in np.flatnonzero(self.length == 0.0):
            low[k] = (rows["position"][:, k] - rows["wide"]).min()
            high[k] = (rows["position"][:, k] + rows["wide"]).max()
        near = self.rows(p, a, h, within(p.position, p.radius, a, h, low, high, known))
        first, second = self.near(
            {name: np.concatenate((rows[name], near[name])) for name in ("id", "position", "wide", "w")}, True
        )
        n = len(rows["id"])
        joins = np.concatenate((second[(first < n) & (second >= n)], first[(second < n) & (first >= n)]))
        return rows_of(near, np.unique(joins - n))

    def near(self, rows: dict[str, Array], pairs: bool) -> tuple[Array, Array]:
        """Pairs of rows that are no further apart than their widths, in order."""
        if not pairs:
            return np.empty(0, np.int32), np.empty(0, np.int32)
        if len(rows["id"]) <= FEW:
            return close_by_test(rows["position"], rows["wide"], rows["w"], self.length)
        first, second = touching(rows["position"], rows["wide"], rows["w"], rows["id"], self.length)
        order = np.lexsort((second, first))
        return first[order], second[order]

    def solve(
        self, p: Particles, rows: dict[str, Array], h: float, near: tuple[Array, Array], again: bool = False
    ) -> tuple[Array, Array]:
        """Velocities of rows (in order of ids) that keep their contacts, into p. What these took, the next `memory`.

        `again`: these velocities have been through it since the last kick, so that contacts take little more.
        """
        v = rows["velocity"]
        a, b, normal, gap, share, inertia, widest, closing, crowd = contacts(
            rows["position"], v, rows["push"], rows["radius"], rows["w"], rows["supported"] == CROWD, *near, h,
            self.length, *self.walls[3:],
        )  # fmt: skip
        walls = len(self.walls[3])
        others = np.where(b >= 0, rows["id"][np.maximum(b, 0)] + walls, -1 - b)
        names = rows["id"][a] * (self.bound + walls) + others
        took = recall(names, self.memory)
        supported = (rows["supported"] != 0) & (rows["w"] > 0.0)
        held = (took > 0.0) | supported[a] | ((b >= 0) & supported[np.maximum(b, 0)])
        pressed, borne = self.pressed(rows["push"], a, b, normal, gap <= widest * h, share, inertia, widest, took)
        of, may_close, speed = slow(pressed, held, widest, gap, closing, crowd, h)
        a, b, normal, share, inertia, names = a[of], b[of], normal[of], share[of], inertia[of], names[of]
        if not self.pairs:  # each rank by itself, and nothing to remember
            closing = project_each(v, a, b, normal, may_close, share, inertia, PRECISE * speed)
            self.give_back(p, rows, v, a, b, closing > 0.0)
            return NOTHING
        tolerance = PRECISE * float(speed.max(initial=0.0))
        if again:
            guess, better = np.zeros(len(a)), BETTER
        elif len(self.memory[0]):
            guess, better = took[of], BETTER
        else:
            guess, better = borne[of] / (2.0 * SLOW), 0.0
        closing = project(v, a, b, normal, may_close, share, inertia, tolerance, guess, better)
        kept = closing > 0.0
        self.give_back(p, rows, v, a, b, kept)
        order = np.argsort(names[kept])
        return names[kept][order], closing[kept][order]

    def pressed(
        self,
        push: Array,
        a: Array,
        b: Array,
        normal: Array,
        touch: Array,
        share: Array,
        inertia: Array,
        widest: Array,
        took: Array,
    ) -> tuple[Array, Array]:
        """(the speed that presses each contact, by pushes of rows and what contacts bear or `took` last; what it bears).

        Those that `touch` bear what they must for nobody to be pushed on. That is found from what they took, by a few sweeps;
        without memory (the first step, or the state was changed) as exactly as velocities are.
        """
        before = 2.0 * SLOW * took  # a step's with SLOW, from half a step's
        of = touch | (took > 0.0)
        that = push.copy(), a[of], b[of], normal[of], np.zeros(np.count_nonzero(of)), share[of]
        borne = before.copy()
        if not self.pairs:
            borne[of] = project_each(*that, inertia[of], PRECISE * widest[of])
        elif len(self.memory[0]):
            borne[of] = bear(*that, before[of])
        else:
            borne[of] = project(*that, inertia[of], PRECISE * float(widest.max(initial=0.0)), before[of], 0.0)
        return np.maximum(before, pressing(push, a, b, normal, share, borne)), borne

    def give_back(self, p: Particles, rows: dict[str, Array], v: Array, a: Array, b: Array, pressed: Array) -> None:
        """To our particles: velocities v of `rows`, and who is supported, having one of the pressed contacts."""
        held = np.zeros(len(v), np.uint8)
        held[a[pressed]] = PRESSED
        held[b[pressed & (b >= 0)]] = PRESSED
        mine = rows["rank"] == self.ranks.rank
        row = rows["row"][mine]
        self.given = row, v[mine] - p.velocity[row]
        p.velocity[row] = v[mine]
        p["supported"][row] = held[mine]


def widths(radius: Array, push: Array, h: float) -> Array:
    """Of rows: two with a slow contact are no further apart than the sum of theirs."""
    return np.asarray(radius + HELD * h * np.sqrt(row_dot(push, push)))


def recall(names: Array, memory: tuple[Array, Array]) -> Array:
    """What contacts of these names took when last remembered, 0 for new ones."""
    known, closing = memory
    if not len(known):
        return np.zeros(len(names))
    at = np.minimum(np.searchsorted(known, names), len(known) - 1)
    return np.where(known[at] == names, closing[at], 0.0)
