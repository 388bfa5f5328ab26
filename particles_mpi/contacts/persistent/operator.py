"""Contacts that last: spheres that forces press onto walls and one another come to rest there, and do not sink or rattle.

A sphere that bounces lower and lower under a force would meet the wall more and more often, and never stop. Here a contact is
*kept* if forces press it along its normal and its next bounce would be over within a few steps. After every kick, velocities
become those, nearest to them in kinetic energy, with which no kept contact closes by more than its gap in a step (`descent`).
That takes energy or none, because rest is always allowed, and moves nothing. All other contacts, with their restitution, are left
to the drift: the faster ones, and those that nothing presses, such as those of balls side by side on a floor.

Elastic spheres rest on one another too, where all forces are uniform and walls take energy: those that are pressed stand on one.

*Crowds.* A sphere that hits a pile would set all of it rattling without end: each contact in it would take place hundreds of
times in a step. If particles have many contacts within a hundredth of a drift, it is therefore undone and repeated after
`keep_crowds`: these particles, and all that touch them, keep their contacts at any speed, as if e = 0. Many contacts with e < 1
lead to the same.

Few rows are involved, as a rule: those that were supported before, those near walls, and those near these (the *zone*); but all,
where forces press free spheres onto one another. Each rank solves for its own rows, with those next to them as ghosts.
"""

import numpy as np

from particles_mpi.contacts.persistent.detection import HELD, REACH, REACH_IN_CROWDS, SLOW_PUSH, widths
from particles_mpi.contacts.persistent.graph import ContactGraph
from particles_mpi.contacts.persistent.history import ContactHistory
from particles_mpi.contacts.persistent.on_walls import settle_on_walls
from particles_mpi.contacts.persistent.rows import Local, gather, hand_over
from particles_mpi.contacts.persistent.solution import SlowContacts
from particles_mpi.contacts.persistent.surfaces import Surfaces
from particles_mpi.contacts.persistent.walls import Walls
from particles_mpi.contacts.persistent.zone import inside_zone, spread, zone_around
from particles_mpi.contacts.rough import FRICTION
from particles_mpi.kernels.markers import CROWD
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Array, Particles, row_dot
from particles_mpi.scene.active import ActiveEffects
from particles_mpi.scene.effect import Context

LEAST_PRESS = 0.1  # times what all fall by: drag that differs by less does not press free spheres together
OUTWARDS = np.array([[-1.0], [1.0]])  # the signs of the ends of a box


class PersistentContacts:
    """Keeps the slow contacts of particles: with one another if `pairs`; with planes that take energy, or with all if pairs do.

    `uniform`: all forces give all particles the same acceleration, so that free ones never press onto one another. `migrating`:
    do rows change their rank, though no `pairs` are kept?
    """

    def __init__(self, context: Context, effects: ActiveEffects, p: Particles):
        """For effects with forces and losses that can make a contact last. Collective.

        Elastic spheres, too, come to rest on one another where the walls below them take energy and forces are the same for all.
        So do spheres that lose energy to one another on walls that take none, as long as they touch another sphere.
        """
        ranks, length, options = context.ranks, context.length, effects.pairs.options if effects.pairs else None
        pairs = self.lossy = effects.pairs is not None and effects.pairs.lossy
        if effects.pairs and not pairs and effects.uniform:
            pairs = ranks.any((p.radius > 0.0).any())
        self.ranks, self.length = ranks if pairs else Communicator.alone(), length
        self.pairs, self.uniform, self.timers = pairs, effects.uniform, context.timers
        self.everywhere = OUTWARDS * np.full((2, len(length)), np.inf)
        taking = effects.walls.taking if effects.walls else np.empty(0, bool)
        keeping = taking | self.lossy  # a pile would rattle for ever between walls that take no energy
        self.walls = Walls(effects.planes, keeping, taking)
        friction, resistance = effects.surfaces[:, FRICTION], effects.rolling.resistance if effects.rolling else 0.0
        surfaces = Surfaces(float(friction[0]), friction[1:][keeping], resistance)
        self.slow = SlowContacts(self.ranks, length, pairs, self.walls, surfaces, options.contact_tolerance if options else 0.0)
        self.kind = self.slow.kind
        self.migrating = options is not None and ranks.size > 1
        points = options is not None and p.dimension == 1 and options.mode == "event"  # these touch one another
        self.history = ContactHistory(ranks if self.migrating else self.ranks, length, len(self.walls), self.kind.columns, points)
        self.given: tuple[Array, Array] = np.empty(0, np.int64), np.empty(0)  # our rows, velocities given to them, but for drag
        self.undamped: Array | None = None  # see `keep`
        self.needs_memory = pairs or self.kind.rough  # of the impulses of contacts, from one kick to the next
        self.awake = True  # else particles pass through one another and through walls
        self.totals = {"unconverged": 0}  # of this rank, which are counted for all by rank 0

    def keep(self, p: Particles, a: Array, h: float, undamped: Array | None = None) -> None:
        """Change velocities, after a kick by accelerations a (n, d) in a step of h, so that slow contacts are kept. Collective
        with `pairs`, and where rows are migrating.

        undamped (n,): which part drag has left of the velocity that constant forces gave in the kick (`Kick.undamped`). Contacts
        push during the whole kick, as those forces do, so drag takes the same part of what they give, as if masses were larger.
        """
        self.given, self.undamped = (self.given[0][:0], self.given[1][:0]), undamped
        if not self.awake:
            return
        with self.timers("rest"):
            involved = self.walls.involved(p, a, h)
            if not self.pairs:
                self.keep_on_walls(p, a, h, involved)
                return
            drag = [0.0] * 4
            if self.lossy and undamped is not None:
                rates = p["drag"][p.fixed == 0]
                drag = [rates.max(initial=0.0), -rates.min(initial=np.inf), longest(p.velocity), longest(a)]
            some, known, most, least, fastest, pull = self.ranks.largest(len(involved) > 0, self.history.has_impulses(), *drag)
            # other forces than uniform ones press free spheres anyhow, and differ from place to place
            presses = (most + least) * fastest > (LEAST_PRESS * pull if self.uniform else 0.0)
            if presses:  # what drag slows less onto what it slows more: by what it takes beyond the least rate, which is -least
                a = a - (p["drag"][:, None] + least) * p.velocity
            everywhere = presses or not self.uniform
            if not some and not everywhere:
                self.history.forget()
                return
            wide = slow_widths(p, a, h)
            zone = self.everywhere if everywhere or not known else self.zone(p, wide, involved)
            graph = self.history.graph_of(p, wide, zone)
            local = self.local(p, a, h, graph)
            inside = inside_zone(local.x, widths(local.radius, local.push, HELD * h, REACH), zone)
            self.history.impulses[:] = self.solve(p, local, graph, inside, h, self.history.impulses, bool(known))

    def keep_crowds(self, p: Particles, a: Array, h: float, tried: int) -> None:
        """Do as `keep`, but keep contacts of particles that are CROWD, and of all that touch them, at any speed.

        `tried`: how often that was done since the kick, without success. Collective.
        """
        self.undamped = None
        with self.timers("rest"):
            touch = slow_widths(p, a, h)
            wide = np.maximum(touch, widths(p.radius, p.velocity, h, REACH_IN_CROWDS))
            graph = ContactGraph(self.ranks, p, np.arange(len(p)), wide, 0.0, self.length, points=self.history.points)
            local = self.local(p, a, h, graph)
            ghost_touch = np.zeros(graph.size + 1)
            ghost_touch[: len(p)] = touch
            marked = local.crowd.astype(np.float64)
            graph.exchange(ghost_touch)
            while True:
                local.crowd[:] = marked > 0.0
                new = spread(graph.start, graph.other, local.x, ghost_touch, self.length, local.crowd)
                if not self.ranks.any(new):
                    break
                marked[:] = local.crowd
                graph.exchange(marked)
            last_impulses = self.history.impulses_before(p, graph)
            self.solve(p, local, graph, np.ones(graph.size + 1, np.bool_), h, last_impulses, True, tried)

    def zone(self, p: Particles, wide: Array, involved: Array) -> Array:
        """Return the box (2, d) around the rows involved, in which contacts are sought. Collective."""
        ends = self.ranks.allreduce_max(zone_around(p.position, wide, involved))
        return np.where(self.length > 0.0, self.everywhere, ends * OUTWARDS)

    def local(self, p: Particles, a: Array, h: float, graph: ContactGraph) -> Local:
        """Return the state of the graph's rows, and of ghosts as their owners have them. Collective."""
        size, d = graph.size + 1, p.dimension
        x, v, push, supported = np.empty((size, d)), np.empty((size, d)), np.empty((size, d)), np.empty(size)
        gather(graph.rows, p.position, p.velocity, a, p["supported"], SLOW_PUSH * h, x, v, push, supported)
        w, spin = graph.inverse_mass, self.kind.spins(p, graph)
        columns = [x, v, push, supported, *([spin] if self.kind.rough else [])]
        if self.undamped is not None:
            w = w.copy()
            w[: len(graph.rows)] *= self.undamped[graph.rows]
            columns.append(w)
        graph.exchange(*columns)
        return Local(x, v, push, graph.radius, w, supported == CROWD, (supported != 0) & (w > 0.0), spin)

    def solve(
        self, p: Particles, local: Local, graph: ContactGraph, inside: Array, h: float, last_impulses: Array, known: bool,
        tried: int | None = None,
    ) -> Array:  # fmt: skip
        """Do as `SlowContacts.solve` and write velocities to p; returns the impulses of half-edges of the graph."""
        solution = self.slow.solve(local, graph, inside, h, last_impulses, known, tried)
        if not solution:
            p["supported"][graph.rows] = 0
            return np.zeros_like(last_impulses)
        self.totals["unconverged"] += self.ranks.is_root and not solution.good
        self.give_back(p, graph.rows, solution.v, solution.held)
        return solution.impulses

    def keep_on_walls(self, p: Particles, a: Array, h: float, rows: Array) -> None:
        """Do as `keep` for rows that only walls can hold: each row by itself, until it is solved.

        Smooth rows need no memory. A rough row may be pressed onto a wall by nothing but its friction at another one, so impulses
        are kept; they are sent where their rows are sent, which is collective where rows are migrating.
        """
        history = self.history
        if not self.kind.rough:
            if len(rows):
                fields, walls = (p.position, p.velocity, p.radius, p.mass, p.fixed, p["supported"]), self.walls
                axes = (0.0,) * p.dimension
                settled = settle_on_walls(axes, rows, fields, a, h, self.length, walls.faces, walls.planes)
                self.give_back(p, rows, *settled)
        elif not len(rows) and not self.migrating:
            history.forget()
        else:
            graph = ContactGraph(self.ranks, p, rows, np.zeros(len(p)), 0.0, self.length, pairs=False)
            last_impulses, local = history.impulses_before(p, graph), self.local(p, a, h, graph)
            inside = np.ones(graph.size + 1, np.bool_)
            history.graph, history.impulses = graph, self.solve(p, local, graph, inside, h, last_impulses, False)

    def give_back(self, p: Particles, rows: Array, v: Array, held: Array) -> None:
        """Write velocities v, and whether contacts hold a row, to the `rows` of our particles."""
        d = p.dimension
        changed, by = hand_over(rows, np.ascontiguousarray(v[:, :d]), held, p.velocity, p["supported"])
        self.given = changed, by if self.undamped is None else by / self.undamped[changed, None]
        if v.shape[1] > d:
            p["spin"][rows] = v[:, d:]


def longest(vectors: Array) -> float:
    """The length of the longest of vectors (n, d), or 0."""
    return float(np.sqrt(row_dot(vectors, vectors).max(initial=0.0)))


def slow_widths(p: Particles, a: Array, h: float) -> Array:
    """Return widths (n,) of rows with accelerations a (n, d): two with a slow contact are within the sum of theirs."""
    return np.asarray(widths(p.radius, a, HELD * SLOW_PUSH * h * h, REACH))
