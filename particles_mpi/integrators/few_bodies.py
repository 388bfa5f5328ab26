"""Few bodies: many steps in one compiled loop, with the same bits as `Composition`, `Taylor` and `Adaptive` give step by step.

For a few particles a force takes less time than one call of Python. So wherever nothing but forces, drag, friction and walls
acts on at most `FEW` particles, the steps up to the next moment at which anyone looks go on inside one kernel. It calls
the same kernels as the integrators do, in the same order. On several ranks each rank computes all of the few particles,
which costs less than a message, and keeps its own.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from particles_mpi.contacts.drift import Drift
from particles_mpi.contacts.walls import no_planes
from particles_mpi.integrators.collocation import END, STUCK, work_for
from particles_mpi.integrators.compiled_steps import Bodies, Forces, Losses, Scheme, Space, adaptive_steps, fixed_steps
from particles_mpi.integrators.gauss_radau import Adaptive
from particles_mpi.integrators.kicks_and_drifts import Accelerations, Composition, Taylor
from particles_mpi.kernels.validity import WATCH_EVERY
from particles_mpi.parallel.exchange import allgather_rows
from particles_mpi.parallel.signals import check_signals
from particles_mpi.particles import Array, Particles, places_of, rows_of
from particles_mpi.scene.active import ActiveEffects
from particles_mpi.scene.effect import Context

FEW = 256  # particles: with more, a force takes longer than the calls that are saved
WORK = 10_000_000  # pairs at once, so that Ctrl-C is heard: some hundredths of a second
SUM = "sum of forces"  # a name that no field has
BESIDES = 30  # pairs that take as long as everything else in a step, for each particle


class FewBodies:
    """Computes the steps of at most `FEW` particles.

    Where all are on this rank, or each moves by itself, the kernels work on its rows, and nothing is sent.
    """

    def __init__(self, rows: Particles, context: Context, effects: ActiveEffects, summed: Accelerations, drift: Drift, rule: Any):
        """`summed`: the sum of all forces; `drift` and `rule`, an integrator: those that compute a single step otherwise."""
        self.rows, self.context, self.effects = rows, context, effects
        self.summed, self.drift, self.rule = summed, drift, rule
        self.known: tuple[int, int, float] | None = None
        self.direct = next((force.direct for force in summed.forces.values() if force.direct), None)
        self.own = context.ranks.size == 1 or not (self.direct or isinstance(rule, Adaptive))  # are the rows here enough?
        kicks, drifts = np.array(rule.parts).T if isinstance(rule, Composition) else np.array([[0.5], [1.0]])
        self.scheme = Scheme(kicks.copy(), drifts.copy(), isinstance(rule, Taylor))

    @staticmethod
    def suit(effects: ActiveEffects, total: int) -> bool:
        """Are there so few particles, and nothing but what these kernels compute?"""
        others = effects.pairs or effects.flows or effects.events or effects.keeps_contacts
        known = all(force.direct or not force.place_dependent for force in effects.forces.values())
        return total <= FEW and not others and known

    def advance(self, h: float, steps_done: int, most: int) -> int:
        """Up to `most` steps of length h, the first one after `steps_done`; returns how many. Collective."""
        summed, drift, adaptive = self.summed, self.drift, isinstance(self.rule, Adaptive)
        total = None if adaptive and self.direct else summed.sum(self.rows)
        with self.context.timers("few"):
            self.gather(h, total)
            watch = WATCH_EVERY - steps_done % WATCH_EVERY
            if adaptive:
                done, hits, sums, known = *self.adaptive_steps(h, most, watch), False
            else:
                n = self.context.ids.total
                most = min(most, max(1, WORK // max(n * (n * len(self.scheme.kicks) + BESIDES), 1)))
                if self.own and self.context.ranks.size > 1:  # what stops one rank must stop all
                    most = min(most, watch)
                bundles = self.bodies, self.forces, self.losses, self.space, self.scheme
                done, hits, sums, known = fixed_steps(self.axes, *bundles, h, most, watch)
            self.give_back()
            if known and sums:
                summed.total, summed.known = self.bodies.total[self.mine], places_of(self.rows)
        if self.direct:
            for name in summed.forces:
                summed.calls[name] += sums
            self.direct.interactions += len(self.rows) * len(self.bodies.id) * sums
        if self.space.bounded:
            drift.calls.update(dict.fromkeys(drift.wall_names, done))
            drift.totals["wall_hits"] += hits if self.own or self.context.ranks.is_root else 0
        drift.total = None
        drift.calls.update(dict.fromkeys(self.effects.on_velocities, 2 * done))
        return done

    def adaptive_steps(self, h: float, steps: int, watch: int) -> tuple[int, int, int]:
        """Steps of `Adaptive`: (how many, wall hits, sums of forces). StateError if the first one gets stuck."""
        bodies, rule = self.bodies, self.rule
        work, begun = work_for(bodies.x.size), np.zeros((2, bodies.x.size))
        n = len(bodies.id)
        most = max(1, WORK // max(n * (n + BESIDES), 1))
        flat = tuple(vectors.reshape(-1) for vectors in (bodies.x, bodies.v, bodies.total))
        need, done, sums = END, 0, 0
        while need not in (END, STUCK) or sums == 0:
            bundles = bodies, flat, self.forces, self.space, rule.tables, work, begun
            need, done, more = adaptive_steps(self.axes, *bundles, need, done, steps, h, watch, most)
            sums += more
            steps = done + 1  # no more than the step that has begun
            check_signals()
        if need == STUCK:
            if done == 0:
                self.give_back()
                raise rule.stuck(self.rows, work)
            flat[0][:], flat[1][:] = begun  # the next call will tell
        rule.substeps += int(work.progress["substeps"][0])
        return done, 0, sums

    def gather(self, h: float, total: Array | None) -> None:
        """All particles, and what acts on them; `total` (n, d): the sum of forces on this rank's. Collective."""
        p, ranks = self.rows, self.context.ranks
        if self.own and self.known == (p.version, p.edition, h):
            if total is not None:
                self.bodies.total[:] = total
            return
        every = p.arrays | {SUM: np.zeros_like(p.position) if total is None else total}
        if not self.own:
            every = allgather_rows(ranks, every)
        if (np.diff(every["id"]) < 0).any():
            every = rows_of(every, np.argsort(every["id"]))
            if self.own:
                p.replace({name: every[name] for name in p.arrays})
        self.known = p.version, p.edition, h
        self.mine = np.searchsorted(every["id"], p.id)
        self.bundle(Particles(p.dimension, every), h)

    def bundle(self, p: Particles, h: float) -> None:
        """The arguments of the kernels, for all particles p."""
        d, n, effects, forces = p.dimension, len(p), self.effects, self.summed.forces
        self.axes = (0,) * d
        drag = p["drag"] if effects.damping else np.empty(0)
        w = p.inverse_mass if effects.friction else np.empty(0)
        rate = p["rate"] if self.scheme.taylor else np.empty((0, d))
        self.bodies = Bodies(p.id, p.position, p.velocity, p.mass, p.radius, w, drag, p.fixed, p[SUM].copy(), rate)
        first, others = np.zeros((n, d)), []
        G, softening2 = (self.direct.G, self.direct.softening2) if self.direct else (0.0, 0.0)
        attracted = False
        for force in forces.values():
            if attracted:
                others.append(np.zeros((n, d)))
            if not force.direct:
                force.add(p, others[-1] if attracted else first)
            attracted |= force.direct is not None
        self.forces = Forces(first, attracted, G, softening2, np.array(others).reshape(-1, n, d), bool(forces))
        self.losses = self.losses_of(p, h)
        planes, kicked = effects.walls.planes if effects.walls else no_planes(d), bool(forces or effects.on_velocities)
        own = kicked and "total_acceleration" in p.arrays
        a = p["total_acceleration"] if own else self.summed.g[None, :] if kicked else np.empty((0, d))
        box = self.context.lower, self.context.upper, self.context.length
        self.space = Space(tuple(planes), bool(effects.walls), a, own, *box, np.empty(n), np.empty(0, np.int64))

    def losses_of(self, p: Particles, h: float) -> Losses:
        """What happens in the kicks of a step of length h besides forces."""
        damping, friction, kicks = self.effects.damping, self.effects.friction, self.scheme.kicks.tolist()
        strength = friction.strength if friction else 0.0
        if not (damping or friction):
            return Losses(np.empty((0, 0)), np.empty((0, 0)), False, strength, False)
        n = len(p)
        factors = [damping.factors(p, part * h) if damping else (np.ones(n), np.full(n, part * h)) for part in kicks]
        decay, push = (np.array(of) for of in zip(*factors, strict=True))
        return Losses(decay, push, friction is not None, strength, not (damping or self.summed.forces))

    def give_back(self) -> None:
        """To this rank's rows what the kernels have changed."""
        if self.own:
            return
        p = self.rows
        changed = {"position": self.bodies.x, "velocity": self.bodies.v}
        if self.scheme.taylor:
            changed["rate"] = self.bodies.rate
        if self.space.own_rates:
            changed["total_acceleration"] = self.space.rates
        for name, values in changed.items():
            p[name][:] = values[self.mine]
