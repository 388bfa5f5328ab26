"""The graph of contacts and their impulses, kept from one solution for the next one, which begins with them: a warm start."""

import numpy as np

from particles_mpi.contacts.persistent.detection import ROUND_UP
from particles_mpi.contacts.persistent.graph import ContactGraph
from particles_mpi.contacts.persistent.memory import carry_over, recall, remember, send_home
from particles_mpi.contacts.persistent.zone import inside_zone
from particles_mpi.contacts.warm_start import Memory, nothing
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Array, Particles

GRAPH_SKIN = 0.3  # of the smallest radius: so far two rows together may move before the graph is built again
DILUTE = 1.0  # the same, in a gas: few pairs come near, but rows move far


class ContactHistory:
    """The graph of rows that are near one another, and the impulses of its half-edges in the last solution.

    length (d,): of the periodic box, 0 along axes that are not periodic. `walls`: how many there are. `columns`: the shape of the
    impulse of a half-edge. `points`: do points touch one another?
    """

    def __init__(self, ranks: Communicator, length: Array, walls: int, columns: tuple[int, ...], points: bool):
        self.ranks, self.length, self.walls, self.points = ranks, length, walls, points
        self.nothing = nothing(columns)
        self.memory = self.nothing  # the impulses, while there is no graph; else `impulses` has them
        self.graph: ContactGraph | None = None
        self.impulses: Array = np.empty((0, *columns))  # by half-edges of the graph
        self.dilute = False  # has the graph few half-edges?

    def forget(self) -> None:
        """Forget all impulses, and the graph."""
        self.memory, self.graph = self.nothing, None

    def restore(self, memory: Memory) -> None:
        """Start from these impulses of contacts of our rows."""
        self.memory, self.graph = (memory if len(memory.id) else self.nothing), None

    def remembered(self) -> Memory:
        """Return the impulses of our rows' contacts in the last solution."""
        if self.graph is not None:
            self.memory = remember(self.graph, self.impulses, self.walls)
        return self.memory

    def has_impulses(self) -> bool:
        """Did any contact of our rows have an impulse?"""
        return bool(self.impulses.any()) if self.graph else len(self.memory.id) > 0

    def graph_of(self, p: Particles, wide: Array, zone: Array) -> ContactGraph:
        """Return the graph of rows in the zone (2, d) that are near by their widths (n,), new or the old one. Collective."""
        old = self.graph if self.graph and self.graph.holds(p, ROUND_UP * wide, zone) else None
        if self.ranks.any(old is None):
            least = p.radius.min(initial=np.inf, where=p.radius > 0.0)
            skin = (DILUTE if self.dilute else GRAPH_SKIN) * self.ranks.least(least)
            skin = skin if skin < np.inf else 0.0
            rows = np.flatnonzero(inside_zone(p.position, ROUND_UP * wide + skin, zone))
            graph = ContactGraph(self.ranks, p, rows, wide, skin, self.length, points=self.points)
            self.impulses = self.impulses_before(p, graph)
            many = len(graph.other) - (4 if self.dilute else 1) * len(rows)  # two limits, so that it does not change to and fro
            self.dilute = self.ranks.total(many)[0] < 0
            self.graph = old = graph
        assert old is not None
        return old

    def impulses_before(self, p: Particles, graph: ContactGraph) -> Array:
        """Return the impulses that the half-edges of a new graph had in the last solution. Collective."""
        old = self.graph
        if old is not None and not np.array_equal(old.ids, p.id):  # rows have changed their rank, or their order
            old = None
        memory = send_home(self.ranks, self.nothing if old else self.remembered(), p)
        return carry_over(old, self.impulses, graph, self.walls) if old else recall(memory, graph, self.walls)
