"""Contacts that last: spheres that forces press onto walls and one another come to rest there, and do not sink or rattle.

A sphere that bounces lower and lower under a force would meet the wall more and more often, and never stop. Here a contact
that is pressed along its normal, and whose next bounce would be over within a step or so, is *kept*: after every kick
velocities become those nearest to them, in kinetic energy, with which no kept contact closes by more than its gap in a step
(`solver`). That takes energy or none, for to be at rest is always allowed; it moves nothing, and all other contacts, with
their restitution, it leaves to the drift: the faster ones, and those that nothing presses, as of balls side by side on a floor.

*Crowds.* A sphere that hits a pile sets all of it rattling, without end: every contact of it would take place hundreds of times
in a step. A drift in which particles have many contacts within a hundredth of it is therefore done again, after `keep_crowds`:
there they and all that touch them keep their contacts at any speed, as if e = 0, which is what many contacts with e < 1 come to.

Involved are few, as a rule: those that were supported before, those near walls, and those near these (the *zone*); where forces
press free ones onto one another, all that touch. Each rank solves for its own rows, and gets those next to them as ghosts.
"""

from typing import NamedTuple

import numpy as np

from particles_mpi.contacts.persistent.detection import (
    HELD,
    NEAR,
    NEAR_IN_CROWDS,
    PRECISE,
    SLOW,
    Contacts,
    find_contacts,
    widths,
)
from particles_mpi.contacts.persistent.graph import ContactGraph, Exchange, rows_in
from particles_mpi.contacts.persistent.memory import along_normals, carry_over, recall, remember, send_home
from particles_mpi.contacts.persistent.problem import Targets
from particles_mpi.contacts.persistent.rows import Local, gather, hand_over
from particles_mpi.contacts.persistent.slow import approach, carried, loads, pressing, slow
from particles_mpi.contacts.persistent.solver import EFFORT, EXACT, OUTLIER, Solver
from particles_mpi.contacts.persistent.surfaces import Pile, RoughContacts, SmoothContacts, Surfaces
from particles_mpi.contacts.persistent.walls import Walls
from particles_mpi.contacts.persistent.zone import inside_zone, spread, zone_around
from particles_mpi.contacts.warm_start import Memory, nothing
from particles_mpi.kernels.markers import CROWD
from particles_mpi.kernels.planes import Planes
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Array, Particles, same_bits
from particles_mpi.timers import Timers

SKIN = 0.3  # of the smallest radius: so far rows may move, two together, before the graph is made anew
DILUTE = 1.0  # the same, in a gas: few pairs come near, but rows move far
ROUND_UP = 1.000001  # times a width: so the graph has all that `inside_zone` finds, whatever is rounded
OUTWARDS = np.array([[-1.0], [1.0]])  # the signs of the ends of a box
UNKNOWN = 10  # times the effort where nothing is remembered


class Found(NamedTuple):
    """Contacts of a graph, and what they were found for: x, push, who is inside, the step."""

    graph: ContactGraph
    for_these: tuple[Array, ...]
    contacts: Contacts


class Solution(NamedTuple):
    """What contacts and rows as in `for_these` come to: velocities (n, columns), who is held, what half-edges of a graph took."""

    contacts: Contacts
    for_these: tuple[Array, ...]
    v: Array
    held: Array
    taken: Array


class PersistentContacts:
    """Keeps the slow contacts of particles: with one another if `pairs`, and with those of the planes that are `taking` energy.

    `uniform`: all forces give all particles the same acceleration, so that free ones never press onto
    one another. `tolerance`: by which part of a radius contacts may close in a step. `points`: do points touch one another?
    """

    def __init__(
        self, ranks: Communicator, length: Array, pairs: bool, planes: Planes, taking: Array, surfaces: Surfaces, uniform: bool,
        tolerance: float, timers: Timers, points: bool = False,
    ):  # fmt: skip
        self.ranks, self.length = ranks if pairs else Communicator.alone(), length
        self.pairs, self.uniform, self.tolerance, self.timers = pairs, uniform, tolerance, timers
        self.points = points
        self.axes = (0.0,) * len(length)
        self.everywhere = OUTWARDS * np.full((2, len(length)), np.inf)
        surfaces = surfaces._replace(walls=surfaces.walls[taking])
        self.law = RoughContacts(self.axes, surfaces) if surfaces.rough else SmoothContacts(self.axes)
        self.walls = Walls(planes, taking)
        self.nothing = nothing(self.law.columns)
        self.memory = self.nothing  # of contacts that the graph does not hold
        self.graph: ContactGraph | None = None
        self.taken: Array = np.empty((0, *self.law.columns))  # by half-edges of the graph
        self.solver = Solver(self.ranks, self.axes)
        self.found: Found | None = None
        self.solution: Solution | None = None  # the last one, if its errors are allowed
        self.given: tuple[Array, Array] = np.empty(0, np.int64), np.empty(0)  # our rows, velocities given to them, but for drag
        self.undamped: Array | None = None  # see `keep`
        self.awake = True  # else particles pass through one another and through walls
        self.totals = {"unconverged": 0}  # of this rank, which are counted for all by rank 0
        self.effort = EFFORT  # see there; with 0 any pile is solved as a large one
        self.dilute = False  # has the graph few half-edges?

    def forget(self) -> None:
        """Nothing is known of what contacts took."""
        self.memory, self.graph = self.nothing, None

    def remembered(self) -> Memory:
        """What our rows' contacts took in the last solution."""
        if self.graph is not None:
            self.memory = remember(self.graph, self.taken, len(self.walls))
        return self.memory

    def restore(self, memory: Memory) -> None:
        """Begin with what contacts of our rows took."""
        self.memory, self.graph = (memory if len(memory.id) else self.nothing), None

    def keep(self, p: Particles, a: Array, h: float, undamped: Array | None = None) -> None:
        """After a kick by accelerations a (n, d) in a step of h: velocities that keep slow contacts. Collective with pairs.

        undamped (n,): which part drag has left of what constant forces gave in the kick (`Kick.undamped`). Contacts push all
        through the kick, as those do: so drag takes as much of what they give, as if masses were larger.
        """
        self.given, self.undamped = (self.given[0][:0], self.given[1][:0]), undamped
        if not self.awake:
            return
        with self.timers("rest"):
            involved = self.walls.involved(p, a, h)
            if not self.pairs:
                self.keep_on_walls(p, a, h, involved)
                return
            remembers = bool(self.taken.any()) if self.graph else len(self.memory.id) > 0
            some, known = self.ranks.largest(len(involved) > 0, remembers)
            if not some and self.uniform:
                self.forget()
                return
            wide = slow_widths(p, a, h)
            zone = self.zone(p, wide, involved, bool(known))
            graph = self.graph_of(p, wide, zone)
            local = self.local(p, a, h, graph)
            inside = inside_zone(local.x, widths(local.radius, local.push, HELD * h, NEAR), zone)
            self.taken[:] = self.solve(p, local, graph, inside, h, self.taken, bool(known))

    def keep_crowds(self, p: Particles, a: Array, h: float) -> None:
        """As `keep`, but contacts with those that are CROWD, and with all who touch them, are kept at any speed. Collective."""
        self.undamped = None
        with self.timers("rest"):
            touch = slow_widths(p, a, h)
            wide = np.maximum(touch, widths(p.radius, p.velocity, h, NEAR_IN_CROWDS))
            graph = ContactGraph(self.ranks, p, np.arange(len(p)), wide, 0.0, self.length, points=self.points)
            local = self.local(p, a, h, graph)
            ghost_touch = np.zeros(graph.size + 1)
            ghost_touch[: len(p)] = touch
            marked = local.crowd.astype(np.float64)
            graph.exchange(ghost_touch)
            while True:
                local.crowd[:] = marked > 0.0
                new = spread(graph.start, graph.other, local.x, ghost_touch, self.length, local.crowd)
                if not self.ranks.largest(new)[0]:
                    break
                marked[:] = local.crowd
                graph.exchange(marked)
            took = self.taken_before(p, graph)
            self.solve(p, local, graph, np.ones(graph.size + 1, np.bool_), h, took, True, again=True)

    def zone(self, p: Particles, wide: Array, involved: Array, known: bool) -> Array:
        """The box (2, d) in which contacts are sought: around those involved, or all space. Collective."""
        if not self.uniform or not known:
            return self.everywhere
        ends = self.ranks.allreduce_max(zone_around(p.position, wide, involved))
        return np.where(self.length > 0.0, self.everywhere, ends.reshape(self.everywhere.shape) * OUTWARDS)

    def graph_of(self, p: Particles, wide: Array, zone: Array) -> ContactGraph:
        """The graph of all who are near one another in the zone, new or as before. Collective."""
        good = self.graph is not None and self.graph.holds(p, ROUND_UP * wide, zone)
        if self.ranks.largest(not good)[0] or self.graph is None:
            least = p.radius.min(initial=np.inf, where=p.radius > 0.0)
            skin = (DILUTE if self.dilute else SKIN) * float(self.ranks.allreduce_min(least)[0])
            skin = skin if skin < np.inf else 0.0
            rows = rows_in(p.position, ROUND_UP * wide + skin, zone)
            graph = ContactGraph(self.ranks, p, rows, wide, skin, self.length, points=self.points)
            self.taken = self.taken_before(p, graph)
            self.graph = graph
            many = len(self.graph.other) - (4 if self.dilute else 1) * len(rows)
            self.dilute = bool(self.ranks.allreduce_sum(many)[0] < 0)
        return self.graph

    def taken_before(self, p: Particles, graph: ContactGraph) -> Array:
        """What half-edges of a new graph took in the last solution. Collective."""
        old = self.graph
        if old is not None and not np.array_equal(old.ids, p.id):  # rows have changed their rank, or their order
            old = None
        memory = send_home(self.ranks, self.nothing if old else self.remembered(), p)
        walls = len(self.walls)
        return carry_over(old, self.taken, graph, walls) if old else recall(memory, graph, walls)

    def local(self, p: Particles, a: Array, h: float, graph: ContactGraph) -> Local:
        """The state of the graph's rows, and of ghosts as their owners have them. Collective."""
        size, d = graph.size + 1, p.dimension
        x, v, push, supported = np.empty((size, d)), np.empty((size, d)), np.empty((size, d)), np.empty(size)
        gather(graph.rows, p.position, p.velocity, a, p["supported"], SLOW * h, x, v, push, supported)
        w, spin = graph.inverse_mass, self.law.spins(p, graph)
        columns = [x, v, push, supported, *([spin] if self.law.rough else [])]
        if self.undamped is not None:
            w = w.copy()
            w[: len(graph.rows)] *= self.undamped[graph.rows]
            columns.append(w)
        graph.exchange(*columns)
        return Local(x, v, push, graph.radius, w, supported == CROWD, (supported != 0) & (w > 0.0), spin)

    def solve(
        self, p: Particles, local: Local, graph: ContactGraph, inside: Array, h: float, took: Array, known: bool,
        again: bool = False,
    ) -> Array:  # fmt: skip
        """Velocities that keep slow contacts, into p; returns what half-edges of the graph took now, `took` being that of before.

        `again`: these velocities have been through it since the last kick, so that contacts take little more.
        """
        contacts = self.contacts(local, graph, inside, h)
        before, last = took[contacts.slot], self.solution
        for_these = before, local.v, local.w, local.supported, local.spin, np.array(known)
        same = last and not again and last.contacts is contacts and all(map(same_bits, last.for_these, for_these))
        count, new = self.ranks.total(len(before), not same)
        if not count:
            p["supported"][graph.rows] = 0
            return np.zeros_like(took)
        if new or not last:  # else it is that of the kick before: a pile at rest
            last = self.solved(local, graph, contacts, for_these, h, took, count, again)
        self.give_back(p, graph.rows, last.v, last.held)
        return last.taken

    def solved(
        self, local: Local, graph: ContactGraph, contacts: Contacts, for_these: tuple[Array, ...], h: float, took: Array,
        count: int, again: bool,
    ) -> Solution:  # fmt: skip
        """See `solve`. `count`: half-edges of all ranks."""
        before, known = for_these[0], bool(for_these[-1])
        effort = max(self.effort // count * (1 if known else UNKNOWN), self.law.least) if self.pairs else EXACT
        bore = 2.0 * SLOW * before
        borne = bore if known else self.borne(local, graph, contacts, h, bore, effort)
        pressed = self.pressed(local, contacts, borne, along_normals(bore), graph.exchange)
        chosen, targets = self.chosen(local, contacts, before, pressed, h, effort)
        if again:  # the way back to a margin is in these velocities already; given twice it would lift spheres
            np.maximum(targets.may_close, 0.0, out=targets.may_close)
        taken = np.where(chosen, (before if known else borne / (2.0 * SLOW)).T, 0.0).T * (not again)
        problem = self.law.problem(local, graph, contacts, chosen, targets, taken)
        w, v = self.law.motion(local, graph, local.v, local.spin)
        pile = Pile(contacts, local, self.tolerance / h if effort < EXACT else 0.0)

        def asleep(v: Array) -> bool:
            return self.law.asleep(self.ranks, pile, along_normals(self.law.taken(problem)), v)

        look = None if again else asleep
        v, good, sleeps = self.solver.solve(problem, w, v, graph.id, graph.exchange, effort, self.pairs, look)
        self.totals["unconverged"] += self.ranks.is_root and not good
        taken = taken if sleeps else self.law.taken(problem)  # who is asleep bears what they bore
        bears = along_normals(np.maximum(taken, before) if again else taken)
        held = carried(contacts.start, bears)
        all_taken = np.zeros_like(took)
        all_taken[contacts.slot] = np.where(along_normals(taken) != 0.0, taken.T, 0.0).T  # all that `remember` keeps
        at_rest = self.law.at_rest(self.ranks, pile, bears, held, v)
        solution = Solution(contacts, for_these, at_rest, held, all_taken)
        self.solution = solution if good else None
        return solution

    def contacts(self, local: Local, graph: ContactGraph, inside: Array, h: float) -> Contacts:
        """The half-edges of rows `inside` that may be slow: as last time, where nothing but velocities has changed since.

        The last kick of a step and the first one of the next take place at the same positions.
        """
        for_these = local.x, local.push, inside, np.array(h)
        crowd, found = bool(local.crowd.any()), self.found  # velocities decide what contacts a crowd has
        if found and not crowd and found.graph is graph and all(map(same_bits, found.for_these, for_these)):
            return found.contacts
        near = graph.start, graph.other
        columns = find_contacts(self.axes, tuple(local[:6]), near, inside, h, self.length, self.walls.faces, self.walls.planes)
        contacts = Contacts(*columns)
        self.found = None if crowd else Found(graph, for_these, contacts)
        return contacts

    def borne(self, local: Local, graph: ContactGraph, contacts: Contacts, h: float, bore: Array, effort: int) -> Array:
        """What all contacts that touch bear if nothing but the pushes acts, beginning with what they `bore`. Collective."""
        touch = contacts.gap <= contacts.widest * h
        problem = self.law.problem(local, graph, contacts, touch, exactly(contacts), bore)
        w, push = self.law.motion(local, graph, local.push, np.zeros_like(local.spin))
        self.solver.solve(problem, w, push, graph.id, graph.exchange, effort, self.pairs)
        return self.law.taken(problem)

    def chosen(
        self, local: Local, contacts: Contacts, before: Array, pressed: Array, h: float, effort: int
    ) -> tuple[Array, Targets]:  # fmt: skip
        """Which contacts are slow, and how fast each of them may close, of those that took `before` and are `pressed` now."""
        closing = approach(self.axes, contacts.start, contacts.partner, contacts.normal, local.v)
        which, *targets = slow(
            tuple(contacts), closing, along_normals(before), (local.supported, local.radius), pressed, h,
            self.tolerance, OUTLIER * (effort < EXACT), PRECISE, self.law.slight,
        )  # fmt: skip
        return which, Targets(*targets)

    def pressed(
        self, local: Local, contacts: Contacts, borne: Array, before: Array, exchange: Exchange
    ) -> Array:  # fmt: skip
        """The speed that presses each contact, by pushes of rows and what contacts bear now or bore `before`. Collective."""
        left, stress = np.zeros_like(local.push), np.zeros((*local.push.shape, local.push.shape[1]))
        some, along = (contacts.start, contacts.partner, contacts.normal), along_normals(borne)
        loads(self.axes, *some, local.w, along, local.push, left, stress)
        self.law.press(contacts, local.w, borne, left)
        exchange(left, stress)
        return np.asarray(pressing(self.axes, *some, along, before, left, stress))

    def keep_on_walls(self, p: Particles, a: Array, h: float, rows: Array) -> None:
        """As `keep`, of rows that nothing but walls can hold: each by itself, to the end, so that nothing need be remembered."""
        if not len(rows):
            return
        if not self.law.rough:
            self.give_back(p, rows, *self.walls.settle(p, a, h, rows, self.length))
            return
        graph = ContactGraph(self.ranks, p, rows, np.zeros(len(p)), 0.0, self.length, pairs=False)
        local, inside = self.local(p, a, h, graph), np.ones(graph.size + 1, np.bool_)
        self.solve(p, local, graph, inside, h, np.zeros((len(rows) * len(self.walls), *self.law.columns)), False)

    def give_back(self, p: Particles, rows: Array, v: Array, held: Array) -> None:
        """To our particles: velocities v of `rows`, and which of them contacts hold."""
        d = p.dimension
        changed, by = hand_over(rows, np.ascontiguousarray(v[:, :d]), held, p.velocity, p["supported"])
        self.given = changed, by if self.undamped is None else by / self.undamped[changed, None]
        if v.shape[1] > d:
            p["spin"][rows] = v[:, d:]


def slow_widths(p: Particles, a: Array, h: float) -> Array:
    """Widths (n,) of rows with accelerations a (n, d): two with a slow contact are no further apart than the sum of theirs."""
    return np.asarray(widths(p.radius, a, HELD * SLOW * h * h, NEAR))


def exactly(contacts: Contacts) -> Targets:
    """That nothing closes, but for round-off of the widest pushes."""
    tight = 1.0 / (PRECISE * contacts.widest)
    return Targets(np.zeros(len(tight)), tight, tight)
