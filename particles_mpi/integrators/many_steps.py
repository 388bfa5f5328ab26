"""Many steps in one compiled loop, where particles are few, or do not act on one another.

For a few particles a force takes less time than one call of Python, and for many the memory is slower than the arithmetic of a
step. So all steps until the next output or check are computed in one kernel, for a block of particles that stays in the cache. It
calls the same kernels in the same order as `Composition`, `Taylor` and `Adaptive`, and so gives the same bits. On several ranks
each rank computes all of a few particles that attract one another, which costs less than a message.

Of a few spheres that collide it computes the steps in which none meets another one or a wall: most. `Drift` does the others.
"""

from math import inf
from typing import Any, NamedTuple

import numpy as np

from particles_mpi.contacts.drift import Drift
from particles_mpi.contacts.persistent.walls import Walls
from particles_mpi.contacts.rough import no_spins
from particles_mpi.contacts.walls import WallNotes
from particles_mpi.gravity.direct import ONE_SUM
from particles_mpi.integrators.collocation import END, STUCK, work_for
from particles_mpi.integrators.compiled_steps import Scheme, adaptive_steps, fixed_steps
from particles_mpi.integrators.gauss_radau import Adaptive
from particles_mpi.integrators.kicks_and_drifts import Accelerations, Composition, Taylor
from particles_mpi.integrators.step_parts import Bodies, Forces, OnWalls, Space, StepLosses
from particles_mpi.kernels.fingerprint import places_of
from particles_mpi.kernels.planes import no_planes
from particles_mpi.kernels.validity import WATCH_EVERY
from particles_mpi.parallel.exchange import allgather_rows
from particles_mpi.parallel.signals import check_signals
from particles_mpi.particles import Array, Particles, rows_of
from particles_mpi.scene.active import ActiveEffects
from particles_mpi.scene.effect import Context

BLOCK_ROWS = 4096  # rows that are advanced together: what is needed of them stays in the cache
LONGEST_CALL = 1e8  # ns of one call, about, so that Ctrl-C is noticed soon
PAIR_NS, ROW_NS, STEP_NS = 3.0, 8.0, 50.0  # ns of a pair, a row, and everything else in a step, at most
MOST_SPHERES = 16  # that collide: of more, some meet in most steps, which need `Drift`
FEW_STEPS = 3  # so many are worth the search that follows; after fewer comes a pause, ever longer up to LONGEST_PAUSE
LONGEST_PAUSE = 127
SUM = "sum of forces"  # a name that no field has
NONE = np.empty(0, bool)


class RowsTogether(NamedTuple):
    """The arguments of the kernels for some rows."""

    bodies: Bodies
    forces: Forces
    losses: StepLosses
    space: Space


class ManySteps:
    """Computes many steps at once, for the rows of this rank or for at most `ONE_SUM` particles of all ranks."""

    def __init__(
        self, rows: Particles, context: Context, effects: ActiveEffects, summed: Accelerations, drift: Drift, rule: Any,
        persistent: Any,
    ):  # fmt: skip
        """`summed`: the sum of all forces; drift, rule (an integrator) and persistent: what computes a single step otherwise."""
        self.rows, self.context, self.effects = rows, context, effects
        self.summed, self.drift, self.rule, self.persistent = summed, drift, rule, persistent
        self.known: tuple[int, int, float] | None = None
        self.blocks: list[RowsTogether] = []
        self.direct = next((force.direct for force in summed.forces.values() if force.direct), None)
        self.collide = effects.pairs is not None
        self.clear = 0  # steps since the last one in which particles met
        self.pause = self.pausing = 0  # steps for which this is not tried after the last meeting, and how many of them are left
        self.ordered = self.direct is not None or isinstance(rule, Adaptive)  # are sums over all particles, in the order of ids?
        self.together = self.ordered or self.collide  # all particles in the same kernel?
        alone = context.ranks.size == 1 and not (self.ordered and self.collide)  # else a new order would cost a search
        self.own = alone or not self.together  # are this rank's rows used as they are?
        self.axes = (0,) * rows.dimension
        kicks, drifts = np.array(rule.parts).T if isinstance(rule, Composition) else np.array([[0.5], [1.0]])
        self.scheme = Scheme(kicks.copy(), drifts.copy(), isinstance(rule, Taylor))

    @staticmethod
    def suit(effects: ActiveEffects, total: int, persistent: Any) -> bool:
        """Can these kernels compute all effects of the scene, for `total` particles?"""
        if effects.flows or effects.events or effects.rough:
            return False
        one_drift = effects.integrator in ("leapfrog", "taylor")
        if effects.pairs and (persistent or not one_drift or not 0 < total <= MOST_SPHERES):
            return False
        if persistent and not (effects.uniform and persistent.walls.straight):
            return False
        forces = effects.forces.values()
        together = effects.integrator == "adaptive" or any(force.direct for force in forces)
        known = all(force.direct or not force.place_dependent for force in forces)
        return known and not (together and (persistent or total > ONE_SUM))

    def advance(self, h: float, steps_done: int, most: int) -> int:
        """Compute up to `most` steps of length h, the first one after `steps_done`; returns how many. Collective.

        Where spheres collide: 0 if one may meet another one or a wall in the first step, and in a pause after such steps.
        """
        if self.pausing:
            self.pausing -= 1
            return 0
        summed, drift, adaptive = self.summed, self.drift, isinstance(self.rule, Adaptive)
        total = None if adaptive and self.direct else summed.sum(self.rows)
        with self.context.timers("steps"):
            self.gather(h, total)
            watch = WATCH_EVERY - steps_done % WATCH_EVERY
            if adaptive:
                done, sums = self.adaptive_steps(h, most, watch)
                hits, missed, known = 0, 0, False
            else:
                done, hits, missed, sums, known = self.fixed_steps(h, most, watch)
            self.give_back()
            if self.collide:
                self.try_again(h, done, most)
            if known and sums:
                summed.total, summed.known = self.blocks[0].bodies.total[self.mine], places_of(self.rows)
        if self.direct:
            for name in summed.forces:
                summed.calls[name] += sums
            self.direct.interactions += len(self.rows) * self.context.ids.total * sums
        if self.effects.walls and not self.collide:
            counted = self.own or self.context.ranks.is_root
            drift.calls.update(dict.fromkeys(drift.wall_names, done))
            drift.totals["wall_hits"] += hits * counted
            drift.totals["missed"] += missed * counted
        drift.total = None
        drift.calls.update(dict.fromkeys(self.effects.on_velocities, 2 * done))
        return done

    def try_again(self, h: float, done: int, most: int) -> None:
        """Decide when to try again, where spheres collide, after `done` of the `most` steps that were wanted."""
        self.clear += done
        if done < most:
            self.pause = self.pause // 2 if self.clear >= FEW_STEPS else min(2 * self.pause + 1, LONGEST_PAUSE)
            self.pausing = self.pause + (done > 0)  # and the step before which it ended
            self.clear = 0
        if done:
            self.drift.pass_by(h, done)

    def fixed_steps(self, h: float, most: int, watch: int) -> tuple[int, int, int, int, bool]:
        """Compute steps of `Composition` or `Taylor`; returns what the kernel `fixed_steps` returns, for all blocks together."""
        n, parts = self.context.ids.total, len(self.scheme.kicks)
        cost = STEP_NS + ROW_NS * n + PAIR_NS * n * n * (parts * (self.direct is not None) + self.collide)
        longest, most = LONGEST_CALL, min(most, max(1, int(LONGEST_CALL / cost)))
        if len(self.blocks) > 1 or (self.own and self.context.ranks.size > 1):  # all blocks must end with the same step
            most = min(most, watch)  # the watchdog is called after that step
            watch, longest = most + 1, inf
        hits = missed = 0
        for block in self.blocks:
            begun = np.empty_like(block.bodies.v) if self.collide else None
            done, hit, stuck, sums, known = fixed_steps(self.axes, *block, self.scheme, h, most, watch, (cost, longest), begun)
            hits, missed = hits + hit, missed + stuck
        return done, hits, missed, sums, known

    def adaptive_steps(self, h: float, steps: int, watch: int) -> tuple[int, int]:
        """Compute steps of `Adaptive`; returns (steps done, sums of forces). StateError if the first one gets stuck."""
        (bodies, forces, _, space), rule = self.blocks[0], self.rule
        work, begun = work_for(bodies.x.size), np.zeros((2, bodies.x.size))
        n = len(bodies.x)
        most = max(1, int(LONGEST_CALL / (STEP_NS + 10.0 * ROW_NS * n + PAIR_NS * n * n)))
        flat = tuple(vectors.reshape(-1) for vectors in (bodies.x, bodies.v, bodies.total))
        need, done, sums = END, 0, 0
        while need not in (END, STUCK) or sums == 0:
            bundles = bodies, flat, forces, space, rule.tables, work, begun
            need, done, more = adaptive_steps(self.axes, *bundles, need, done, h, (steps, watch, most))
            sums += more
            steps = done + 1  # no more than the step that has begun
            check_signals()
        if need == STUCK:
            if done == 0:
                self.give_back()
                raise rule.stuck(self.rows, work)
            flat[0][:], flat[1][:] = begun  # the next call begins with this step and raises the error
        rule.substeps += int(work.progress["substeps"][0])
        return done, sums

    def gather(self, h: float, total: Array | None) -> None:
        """Collect the rows to be advanced and what acts on them; `total` (n, d): the sum of forces on this rank's. Collective."""
        p, ranks = self.rows, self.context.ranks
        if self.own and self.known == (p.version, p.edition, h):
            if total is not None and self.direct:
                self.blocks[0].bodies.total[:] = total
            return
        every = p.arrays | {SUM: np.zeros_like(p.position) if total is None else total.copy() if self.direct else total}
        if not self.own:
            every = allgather_rows(ranks, every)
        if self.together:
            if (self.ordered or not self.own) and (np.diff(every["id"]) < 0).any():
                every = rows_of(every, np.argsort(every["id"]))
                if self.own:
                    p.replace({name: every[name] for name in p.arrays})
            self.mine = np.searchsorted(every["id"], p.id)
        self.known = p.version, p.edition, h
        n, size = len(every["id"]), ONE_SUM if self.together else BLOCK_ROWS
        slices = [slice(first, first + size) for first in range(0, max(n, 1), size)]
        parts = ({name: column[some] for name, column in every.items()} for some in slices)
        self.blocks = [self.block(Particles(p.dimension, part), h) for part in parts]

    def block(self, p: Particles, h: float) -> RowsTogether:
        """The arguments of the kernels, for the rows of p."""
        d, n, effects, forces = p.dimension, len(p), self.effects, self.summed.forces
        drag = p["drag"] if effects.damping else np.empty(0)
        w = p.inverse_mass if effects.friction else np.empty(0)
        rate = p["rate"] if self.scheme.taylor else np.empty((0, d))
        bodies = Bodies(p.position, p.velocity, p.mass, p.radius, w, drag, p.fixed, p[SUM], rate)
        planes, kicked = effects.planes, bool(forces or effects.on_velocities)
        own = kicked and "total_acceleration" in p.arrays
        a = p["total_acceleration"] if own else self.summed.g[None, :] if kicked else np.empty((0, d))
        box = self.context.lower, self.context.upper, self.context.length
        on_walls = self.on_walls_of(p)
        reach = self.persistent.walls.reach(p.fixed, p[SUM], h) if on_walls.kept and n else 0.0
        smooth = no_spins(d, np.zeros((1 + len(planes.point), 2)))
        noting = n if effects.finishes_bounces else 0
        notes = WallNotes(np.empty(n), np.empty(noting, np.int64), np.empty(noting, np.int64), np.empty(noting))
        space = Space(tuple(planes), bool(effects.walls), a, own, *box, tuple(notes), smooth, reach, on_walls)
        return RowsTogether(bodies, self.forces_on(p), self.losses_of(p, h), space)

    def forces_on(self, p: Particles) -> Forces:
        """The forces on the rows of p."""
        forces, (n, d) = self.summed.forces, p.position.shape
        if not self.direct:  # the sum of those that do not depend on places is there already
            none = np.empty((0, d))
            return Forces(none, False, 0.0, 0.0, none.reshape(0, 0, d), bool(forces))
        first, others, attracted = np.zeros((n, d)), [], False
        for force in forces.values():
            if attracted:
                others.append(np.zeros((n, d)))
            if not force.direct:
                force.add(p, others[-1] if attracted else first)
            attracted |= force.direct is not None
        return Forces(first, True, self.direct.G, self.direct.softening2, np.array(others).reshape(len(others), n, d), True)

    def on_walls_of(self, p: Particles) -> OnWalls:
        """Contacts with walls that last, if there are any."""
        d, persistent = p.dimension, self.persistent
        walls = persistent.walls if persistent else Walls(no_planes(d), NONE, NONE)
        supported = p["supported"] if persistent else np.empty(0, np.uint8)
        (point, normal), n = walls.planes, len(supported)
        scratch = np.empty(n, np.int64)
        room = scratch, scratch.copy(), np.empty((n, d)), scratch.copy(), np.empty((n, d))
        return OnWalls(persistent is not None, (0.0,) * d, supported, point, normal, walls.faces, *room)

    def losses_of(self, p: Particles, h: float) -> StepLosses:
        """Return damping and friction for the kicks of a step of length h."""
        damping, friction, kicks = self.effects.damping, self.effects.friction, self.scheme.kicks.tolist()
        strength = friction.strength if friction else 0.0
        if not (damping or friction):
            return StepLosses(np.empty((0, 0)), np.empty((0, 0)), False, strength, False)
        n = len(p)
        factors = [damping.factors(p, part * h) if damping else (np.ones(n), np.full(n, part * h)) for part in kicks]
        decay, force_time = (np.array(of) for of in zip(*factors, strict=True))
        return StepLosses(decay, force_time, friction is not None, strength, not (damping or self.summed.forces))

    def give_back(self) -> None:
        """Copy what the kernels have changed to the rows of this rank."""
        if self.own:
            return
        p, (bodies, _, _, space) = self.rows, self.blocks[0]
        changed = {"position": bodies.x, "velocity": bodies.v}
        if self.scheme.taylor:
            changed["rate"] = bodies.rate
        if space.own_rates:
            changed["total_acceleration"] = space.rates
        for name, values in changed.items():
            p[name][:] = values[self.mine]
