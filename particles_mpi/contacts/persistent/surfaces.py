"""Smooth and rough contacts for the solver: two classes with the same methods, which `solution` calls.

The impulse of a smooth contact is one number, along its normal. That of a rough one is a row of numbers: along the normal, across
it, and a couple. Velocities and spins, and 1/m and 1/I, are then columns of one array.
"""

from typing import NamedTuple

import numpy as np

from particles_mpi.contacts.persistent.detection import HELD, PRECISE, Contacts
from particles_mpi.contacts.persistent.graph import ContactGraph
from particles_mpi.contacts.persistent.memory import along_normals
from particles_mpi.contacts.persistent.problem import Problem, Targets, bound_rows, table_of
from particles_mpi.contacts.persistent.rough_iterations import slide_loads
from particles_mpi.contacts.persistent.rough_table import bound_rough, impulse_columns, rough_table
from particles_mpi.contacts.persistent.rows import Local
from particles_mpi.contacts.persistent.slow import carried, felt_push
from particles_mpi.contacts.warm_start import rough_columns
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Array, Particles, row_dot

STEADY = 45  # iterations that rough spheres always get: with fewer a pile creeps by what is left of errors, and never rests
SLIGHT = 0.01  # of the larger push: rough contacts that bear less are solved as if they bore that; errors below are round-off
QUIET = 1e-3  # of the allowed errors: a rough pile in which nothing is faster is asleep
LEFT_BETWEEN = 2.0 * HELD * PRECISE  # of the push that it feels: what a solution may leave a smooth sphere between two others
DUST = 1e-30  # of its own push: a slower spin of a rough sphere that is held is round-off of round-off, until it underflows
STILL = 1e-6  # of the push that they feel: slower rough spheres that are held stand still


class Surfaces(NamedTuple):
    """Friction mu of pairs and of each plane, and the resistance to rolling, a length."""

    pairs: float
    walls: Array
    resistance: float

    @property
    def rough(self) -> bool:
        """Is there any friction?"""
        return self.pairs > 0.0 or bool((self.walls > 0.0).any())


class Pile(NamedTuple):
    """Rows and their contacts; allowed: by how many radii a second these may close, 0 where they are solved to round-off."""

    contacts: Contacts
    local: Local
    allowed: float

    def pushes(self, normal_impulses: Array) -> Array:
        """Return the push (n,) that each row feels where contacts bear a load, or its own if that is larger; 0 if none bears any.

        normal_impulses (m,): above 0 where a contact bears a load.
        """
        contacts, own = self.contacts, self.local.push[: len(self.contacts.start) - 1]
        felt = felt_push(contacts.start, contacts.partner, self.local.w, contacts.larger_push, normal_impulses)
        return np.where(felt > 0.0, np.maximum(felt, np.sqrt(row_dot(own, own))), 0.0)

    def is_borne(self, normal_impulses: Array) -> bool:
        """Does a wall or a fixed sphere bear a load? Otherwise rest has no meaning: all rows may move together."""
        return bool(((self.local.w[self.contacts.partner] == 0.0) & (normal_impulses > 0.0)).any())

    def piled(self, normal_impulses: Array) -> Array:
        """Which rows (n,) bear other rows, by contacts with these `normal_impulses` (m,)."""
        walls = self.contacts.partner == len(self.local.w) - 1
        return np.asarray(carried(self.contacts.start, np.where(walls, 0.0, normal_impulses)) != 0)


class SmoothContacts:
    """Contacts without friction."""

    rough = False
    least = 0  # iterations that a solution always gets
    slight = 0.0  # see SLIGHT
    columns: tuple[int, ...] = ()  # of the impulse of a half-edge

    def __init__(self, axes: tuple[float, ...]):
        self.axes = axes

    def spins(self, p: Particles, graph: ContactGraph) -> Array:
        """Spins (size + 1, d(d-1)/2) of rows, with room for those of ghosts; of smooth spheres there are none."""
        return np.empty((0, 1))

    def problem(
        self, local: Local, graph: ContactGraph, contacts: Contacts, which: Array, targets: Targets, impulses: Array
    ) -> Problem:  # fmt: skip
        """Return the problem for the solver: contacts, of which `which` (m,) may have an impulse, and impulses. Collective."""
        some, bound = (contacts.start, contacts.partner), np.zeros_like(local.w)
        bound_rows(self.axes, contacts.start, contacts.normal, local.w, which, bound)
        graph.exchange(bound)
        table = table_of(self.axes, *some, contacts.normal, local.w, which, bound, targets.may_close, impulses)
        return Problem(*some, table, targets.per_allowed, targets.per_round_off)

    def motion(self, local: Local, graph: ContactGraph, v: Array, spin: Array) -> tuple[Array, Array]:
        """Return for the solver: inverse masses, and velocities v (size + 1, d) with spins."""
        return local.w, v

    def impulses(self, problem: Problem) -> Array:
        """The impulses of half-edges, (m, *columns)."""
        return problem.table[:, impulse_columns(len(self.axes), False)[0]].copy()

    def press(self, contacts: Contacts, w: Array, load: Array, net_push: Array) -> None:
        """Add the loads of contacts across their normals to the net pushes (n, d) of rows: smooth spheres have none."""

    def asleep(self, ranks: Communicator, pile: Pile, normal_impulses: Array, v: Array) -> bool:
        """Is no row that bears a load faster than the errors of a solution make it? Collective."""
        held = carried(pile.contacts.start, normal_impulses) != 0
        return not ranks.any((self.quick(pile, normal_impulses, v) & held).any())

    def quick(self, pile: Pile, normal_impulses: Array, v: Array) -> Array:
        """Return which rows (n,), with velocities and spins v (n, columns), are faster than errors of a solution make them."""
        return np.asarray(row_dot(v, v) > (LEFT_BETWEEN * pile.pushes(normal_impulses)) ** 2)

    def at_rest(self, ranks: Communicator, pile: Pile, normal_impulses: Array, held: Array, v: Array) -> Array:
        """Return velocities v (n, d), in which rows that bear others and are almost at rest have velocity 0. Collective.

        `held` (n,) is for rough spheres only. In piles that stand on something, speeds below the round-off of a solution become
        0: in the drift they would cause hundreds of collisions in a step between spheres that touch.
        """
        rests = ~self.quick(pile, normal_impulses, v)
        if not ranks.any(rests.any()) or not ranks.any(pile.is_borne(normal_impulses)):
            return v
        return np.asarray(np.where((rests & pile.piled(normal_impulses))[:, None], 0.0, v))


class RoughContacts(SmoothContacts):
    """Contacts with friction, and with resistance to rolling."""

    rough = True
    least = STEADY
    slight = SLIGHT

    def __init__(self, axes: tuple[float, ...], surfaces: Surfaces):
        super().__init__(axes)
        self.surfaces, d = surfaces, len(axes)
        self.columns = rough_columns(d)

    def spins(self, p: Particles, graph: ContactGraph) -> Array:
        spin = np.zeros((graph.size + 1, p["spin"].shape[1]))
        spin[: len(graph.rows)] = p["spin"][graph.rows]
        return spin

    def problem(
        self, local: Local, graph: ContactGraph, contacts: Contacts, which: Array, targets: Targets, impulses: Array
    ) -> Problem:  # fmt: skip
        some, bound = (contacts.start, contacts.partner), np.zeros_like(local.w)
        walls = max(len(self.surfaces.walls), 1)
        wall = np.where(contacts.partner == graph.size, (contacts.slot - len(graph.other)) % walls, -1)
        friction = np.append(self.surfaces.walls, self.surfaces.pairs)[wall]
        law = np.stack((friction, np.full(len(friction), self.surfaces.resistance)))
        bodies = graph.radius, graph.inverse_inertia, local.w, which
        bound_rough(self.axes, *some, contacts.normal, wall, contacts.gap, *bodies, law[1], bound)
        graph.exchange(bound)
        along = along_normals(impulses)
        smooth = table_of(self.axes, *some, contacts.normal, local.w, which, bound, targets.may_close, along)
        across = np.ascontiguousarray(impulses[:, 1:])
        table = rough_table(self.axes, smooth, wall, *some, contacts.gap, *bodies, law, across)
        return Problem(*some, table, targets.per_allowed, targets.per_round_off)

    def motion(self, local: Local, graph: ContactGraph, v: Array, spin: Array) -> tuple[Array, Array]:
        return np.column_stack((local.w, graph.inverse_inertia)), np.concatenate((v, spin), axis=1)

    def impulses(self, problem: Problem) -> Array:
        return problem.table[:, impulse_columns(len(self.axes), True)]

    def press(self, contacts: Contacts, w: Array, load: Array, net_push: Array) -> None:
        slide_loads(self.axes, contacts.start, contacts.partner, np.ascontiguousarray(load[:, 1:]), w, net_push)

    def quick(self, pile: Pile, normal_impulses: Array, v: Array) -> Array:
        radius, d = pile.local.radius[: len(v)], len(self.axes)
        most = np.maximum(STILL * pile.pushes(normal_impulses), QUIET * pile.allowed * radius) ** 2
        rim = radius[:, None] * v[:, d:]
        return np.asarray((row_dot(v[:, :d], v[:, :d]) > most) | (row_dot(rim, rim) > most))

    def at_rest(self, ranks: Communicator, pile: Pile, normal_impulses: Array, held: Array, v: Array) -> Array:
        """The same: iterations leave small velocities, which no force explains and which decay from step to step.

        In a pile, all spheres that bear others come to rest at once: one by one, each would be a small blow to its neighbours.
        """
        quick, piled = self.quick(pile, normal_impulses, v), pile.piled(normal_impulses)
        self.forget_dust(pile, held, v)
        awake, borne = ranks.largest(bool((quick & piled).any()), pile.is_borne(normal_impulses))
        if not borne:
            return v
        rests = (held != 0) & ~quick & ~(piled & bool(awake))
        return np.asarray(np.where(rests[:, None], 0.0, v))

    def forget_dust(self, pile: Pile, held: Array, v: Array) -> None:
        """Set to 0, in v (n, columns), those components of spins of held rows that are below DUST of the row's own push.

        Each solution leaves about 1e-16 of such a spin, until that is below the range of numbers.
        """
        spin, radius = v[:, len(self.axes) :], pile.local.radius[: len(v), None]
        least = DUST * np.abs(pile.local.push[: len(v)]).max(axis=1, initial=0.0, keepdims=True)
        spin[(held != 0)[:, None] & (radius * np.abs(spin) < least)] = 0.0
