"""Computes, for the rows of a graph, which contacts are slow, their impulses, and the velocities that keep them.

`SlowContacts` finds the contacts of a graph, computes what presses each of them, which are therefore slow, and calls the solver.
"""

from typing import NamedTuple

import numpy as np

from particles_mpi.contacts.persistent.descent import exact_from
from particles_mpi.contacts.persistent.detection import PRECISE, SLOW_PUSH, Contacts, find_half_edges
from particles_mpi.contacts.persistent.graph import ContactGraph
from particles_mpi.contacts.persistent.iterations import OUTLIER
from particles_mpi.contacts.persistent.memory import along_normals
from particles_mpi.contacts.persistent.problem import Targets
from particles_mpi.contacts.persistent.rows import Local
from particles_mpi.contacts.persistent.slow import approach, carried, loads, pressing, slow
from particles_mpi.contacts.persistent.solver import SOLUTION_EFFORT, TRIED, Solver
from particles_mpi.contacts.persistent.surfaces import Pile, RoughContacts, SmoothContacts, Surfaces
from particles_mpi.contacts.persistent.walls import Walls
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Array, same_bits

UNKNOWN = 10  # times as many iterations where nothing is remembered
IN_CROWDS = 900  # iterations in small crowds, at first; TRIED lead to a direct solution where they are not enough
AS_PUSH = 2.0 * SLOW_PUSH  # times the impulse of a contact in a kick, which lasts half a step, is its load as a push


class Found(NamedTuple):
    """Contacts of a graph, and what they were found for: x, push, which rows are inside, the step."""

    graph: ContactGraph
    for_these: tuple[Array, ...]
    contacts: Contacts


class Solution(NamedTuple):
    """A solution for contacts and rows as in `for_these`: velocities (n, columns), which rows are held (n,), impulses of
    half-edges of the graph, and whether errors are allowed.
    """

    contacts: Contacts
    for_these: tuple[Array, ...]
    v: Array
    held: Array
    impulses: Array
    good: bool


class SlowContacts:
    """Solves for the slow contacts of rows with one another, if `pairs`, and with walls.

    `tolerance`: by which part of a radius contacts may close in a step.
    """

    def __init__(
        self, ranks: Communicator, length: Array, pairs: bool, walls: Walls, surfaces: Surfaces, tolerance: float
    ):  # fmt: skip
        self.ranks, self.length, self.pairs, self.walls, self.tolerance = ranks, length, pairs, walls, tolerance
        self.axes = (0.0,) * len(length)
        self.kind = RoughContacts(self.axes, surfaces) if surfaces.rough else SmoothContacts(self.axes)
        self.solver = Solver(ranks, self.axes)
        self.exact = exact_from(self.kind.rough)
        self.effort = SOLUTION_EFFORT  # see there; with 0 any pile is solved as a large one
        self.found: Found | None = None
        self.last: Solution | None = None  # if its errors were allowed

    def solve(
        self,
        local: Local,
        graph: ContactGraph,
        inside: Array,
        h: float,
        last_impulses: Array,
        known: bool,
        tried: int | None = None,
    ) -> Solution | None:
        """Return velocities that keep the slow contacts of rows `inside`; None if no rank has a contact. Collective.

        `last_impulses`: of half-edges of the graph in the last solution, if that is `known`. `tried`: None after a kick; for a
        crowd, how often it has been solved since the kick. The velocities of a crowd keep contacts already, so impulses begin at
        0, and only new ones are in the solution; a row is held if one of its contacts has an impulse now or had one in
        `last_impulses`.
        """
        contacts = self.contacts(local, graph, inside, h)
        before, last = last_impulses[contacts.slot], self.last
        for_these = before, local.v, local.w, local.supported, local.spin, np.array(known)
        same = last and tried is None and last.contacts is contacts and all(map(same_bits, last.for_these, for_these))
        count, new = self.ranks.total(len(before), not same)
        if not count:
            return None
        if not new:  # nothing has changed since the kick before: a pile at rest
            return last
        solution = self.solved(local, graph, contacts, for_these, h, last_impulses, count, tried)
        self.last = solution if solution.good else None
        return solution

    def solved(
        self, local: Local, graph: ContactGraph, contacts: Contacts, for_these: tuple[Array, ...], h: float, last_impulses: Array,
        count: int, tried: int | None,
    ) -> Solution:  # fmt: skip
        """Return a new solution for `count` half-edges of all ranks; see `solve`. Collective."""
        before, known, again = for_these[0], bool(for_these[-1]), tried is not None
        least = max(self.effort // count * (1 if known else UNKNOWN), self.kind.least) if self.pairs else self.exact
        load = AS_PUSH * before if known else self.load(local, graph, contacts, h, least)
        if not self.pairs:  # each row by itself: those of which something is remembered bear what they bore
            remembered = np.repeat(carried(contacts.start, along_normals(before)) != 0, np.diff(contacts.start))
            load[remembered] = AS_PUSH * before[remembered]
        if again and least >= self.exact and not self.kind.rough:
            least = TRIED if tried else IN_CROWDS
        pressed = self.pressed(local, graph, contacts, load, along_normals(AS_PUSH * before))
        chosen, targets = self.chosen(local, contacts, before, pressed, h, least)
        if again and not self.kind.rough:  # given twice, the way back to a margin lifts beds of smooth spheres by 1e-6
            np.maximum(targets.may_close, 0.0, out=targets.may_close)
        impulses = np.where(chosen, load.T / AS_PUSH, 0.0).T * (not again)
        problem = self.kind.problem(local, graph, contacts, chosen, targets, impulses)
        w, v = self.kind.motion(local, graph, local.v, local.spin)
        pile = Pile(contacts, local, self.tolerance / h if least < self.exact else 0.0)

        def asleep(v: Array) -> bool:
            return self.kind.asleep(self.ranks, pile, along_normals(self.kind.impulses(problem)), v)

        look = None if again else asleep
        v, good, sleeps = self.solver.solve(problem, w, v, graph.id, graph.exchange, least, self.pairs, look)
        impulses = impulses if sleeps else self.kind.impulses(problem)  # a pile that is asleep keeps its impulses
        normal_impulses = along_normals(np.maximum(impulses, before) if again else impulses)
        held = carried(contacts.start, normal_impulses)
        all_impulses = np.zeros_like(last_impulses)
        all_impulses[contacts.slot] = np.where(along_normals(impulses) != 0.0, impulses.T, 0.0).T  # all that `remember` keeps
        return Solution(
            contacts, for_these, self.kind.at_rest(self.ranks, pile, normal_impulses, held, v), held, all_impulses, good
        )

    def contacts(self, local: Local, graph: ContactGraph, inside: Array, h: float) -> Contacts:
        """Return the half-edges of rows `inside` that may be slow: those of last time if only velocities have changed since.

        The last kick of a step and the first one of the next take place at the same positions.
        """
        for_these = local.x, local.push, inside, np.array(h)
        crowd, found = bool(local.crowd.any()), self.found  # velocities decide what contacts a crowd has
        if found and not crowd and found.graph is graph and all(map(same_bits, found.for_these, for_these)):
            return found.contacts
        near = graph.start, graph.other
        columns = find_half_edges(
            self.axes, tuple(local[:6]), near, inside, h, self.length, self.walls.faces, self.walls.planes, self.walls.taking
        )
        contacts = Contacts(*columns)
        self.found = None if crowd else Found(graph, for_these, contacts)
        return contacts

    def load(self, local: Local, graph: ContactGraph, contacts: Contacts, h: float, least: int) -> Array:
        """Return the load of all contacts that touch, as a push, if nothing but the pushes of rows acts. Collective."""
        touch = contacts.gap <= contacts.larger_push * h
        nothing = np.zeros((len(touch), *self.kind.columns))
        problem = self.kind.problem(local, graph, contacts, touch, exactly(contacts), nothing)
        w, push = self.kind.motion(local, graph, local.push, np.zeros_like(local.spin))
        self.solver.solve(problem, w, push, graph.id, graph.exchange, least, self.pairs)
        return self.kind.impulses(problem)

    def pressed(self, local: Local, graph: ContactGraph, contacts: Contacts, load: Array, before: Array) -> Array:
        """Return the speed (m,) that presses each contact, by pushes and the load of contacts, now or `before`. Collective."""
        net_push, stress = np.zeros_like(local.push), np.zeros((*local.push.shape, local.push.shape[1]))
        some, along = (contacts.start, contacts.partner, contacts.normal), along_normals(load)
        loads(self.axes, *some, local.w, along, local.push, net_push, stress)
        self.kind.press(contacts, local.w, load, net_push)
        graph.exchange(net_push, stress)
        return np.asarray(pressing(self.axes, *some, along, before, local.push, net_push, stress))

    def chosen(
        self, local: Local, contacts: Contacts, before: Array, pressed: Array, h: float, least: int
    ) -> tuple[Array, Targets]:
        """Return which contacts, with impulses `before`, are slow if so `pressed`, and the `Targets` of each."""
        closing = approach(self.axes, contacts.start, contacts.partner, contacts.normal, local.v)
        which, *targets = slow(
            tuple(contacts), closing, along_normals(before), (local.supported, local.radius), pressed, h,
            self.tolerance, OUTLIER * (least < self.exact), self.kind.slight,
        )  # fmt: skip
        return which, Targets(*targets)


def exactly(contacts: Contacts) -> Targets:
    """Return targets with which no contact closes, but for round-off of the larger pushes."""
    per_round_off = 1.0 / (PRECISE * contacts.larger_push)
    return Targets(np.zeros(len(per_round_off)), per_round_off, per_round_off)
