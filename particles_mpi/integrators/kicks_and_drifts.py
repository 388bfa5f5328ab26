"""The sum of all forces; kicks, which change velocities at fixed positions; integrators that alternate kicks and drifts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

from particles_mpi.errors import StoppedError
from particles_mpi.integrators.gauss_radau import TOLERANCE, Adaptive
from particles_mpi.kernels.fingerprint import places_of
from particles_mpi.kernels.motion import kick, kick_with_drag, press, release
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Array, Particles, to_read
from particles_mpi.scene.active import ActiveEffects
from particles_mpi.scene.calls import call_in_place, call_method
from particles_mpi.scene.effect import Force
from particles_mpi.scene.schema import Scene
from particles_mpi.timers import Timers

B = (0.0829844064174052, 0.396309801498368, -0.0390563049223486)
A = (0.245298957184271, 0.604872665711080)
# Kicks, and the drifts between them, as parts of a step. "order4" is SRKN_6^b of S. Blanes and P. C. Moan, J. Comput. Appl.
# Math. 142, 313 (2002): six forces a step, symplectic, for forces that do not depend on velocities. One drift goes back in
# time, so nothing may happen on the way.
COMPOSITIONS = {
    "leapfrog": ((0.5, 0.5), (1.0,)),
    "order4": ((*B, 1.0 - 2.0 * sum(B), *B[::-1]), (*A, 0.5 - sum(A), 0.5 - sum(A), *A[::-1])),
}

FIXED_IN_KICKS = "id", "position"  # a velocity flow can only read them


def integrator_of(
    scene: Scene, ranks: Communicator, kick: Kick, persistent: Any, closing: Any
) -> Adaptive | Taylor | Composition:
    """Return the integrator that a scene names. `persistent` keeps contacts that last, `closing` completes others, if any do.

    Its `advance` makes a step of length h, and calls `drift` to move the particles for a time, with contacts on the way.
    Collective.
    """
    name = scene.time.integrator
    if name == "adaptive":
        box = (*scene.corners, scene.periodic_length) if any(scene.periodic) and scene.outside else None
        return Adaptive(ranks, scene.time.tolerance or TOLERANCE, kick.forces, kick.timers, box)
    return Taylor(kick) if name == "taylor" else Composition(kick, persistent, closing, *COMPOSITIONS[name])


class Accelerations:
    """The sum of the `forces` of a scene (by name), which is kept while it holds; `calls` counts the evaluations of each force.

    total (n, d): the last sum, or None; g (d,): the sum of those that are the same for all particles; `done`: interactions that
    were computed by forces that are no longer there.
    """

    def __init__(self, forces: dict[str, Force], ranks: Communicator, dimension: int, calls: Counter[str], done: int):
        self.forces, self.ranks, self.calls, self.done = forces, ranks, calls, done
        self.g: Array = np.zeros(dimension)
        self.total: Array | None = None
        self.known: tuple[int, ...] = ()  # version, edition and fingerprint of the rows that `total` belongs to
        self.look_at_forces()

    def look_at_forces(self) -> None:
        """Set the attributes that depend on which forces there are."""
        self.place_dependent = any(force.place_dependent for force in self.forces.values())
        self.outside = {name: not type(force).__module__.startswith("particles_mpi.") for name, force in self.forces.items()}
        self.collective = any(force.collective for force in self.forces.values())
        self.g[:] = sum((force.g for force in self.forces.values() if force.g is not None), np.zeros_like(self.g))

    def replace(self, name: str, force: Force) -> None:
        """Put `force` in the place of the force with that name."""
        self.done += self.forces[name].interactions
        self.forces[name] = force
        self.look_at_forces()

    def sum(self, p: Particles) -> Array | None:
        """Return accelerations (n, d) at the present positions, or None without forces; evaluated anew if needed. Collective."""
        if not self.forces:
            return None
        known = places_of(p) if self.place_dependent else (p.version, p.edition)
        same = known == self.known
        if self.collective:  # if one rank evaluates forces, all do
            same = self.ranks.all(same)
        if same:
            return self.total
        a = np.zeros_like(p.velocity)
        for name, force in self.forces.items():
            before = self.ranks.exchanges
            call_in_place(name, force.add, to_read(p) if self.outside[name] else p, a)
            if not force.collective and self.ranks.exchanges > before:  # a rank without moved particles would not take part
                raise StoppedError(
                    f"effects.{name}: its `add` exchanges messages between ranks: its class needs collective = True"
                )
            self.calls[name] += 1
        a[p.fixed != 0] = 0.0
        self.total, self.known = a, known
        return a

    def potentials(self, p: Particles) -> dict[str, Array]:
        """Potential energies (n,) by force, of those that have one. Collective."""
        found = {}
        for name, force in self.forces.items():
            if type(force).potential is Force.potential:
                continue
            energy = call_method(name, force.potential, to_read(p) if self.outside[name] else p)
            given = self.ranks.any(energy is not None) if self.outside[name] else energy is not None
            if given:
                energy = energy if len(p) else np.zeros(0)  # what a rank without rows returns does not matter
                if np.shape(energy) != (len(p),) or np.asarray(energy).dtype.kind not in "fiub":
                    what = f"{type(energy).__name__} of shape {np.shape(energy)}"
                    raise StoppedError(
                        f"effects.{name}: its `potential` returned {what}, and not a number for each of {len(p)} rows"
                    )
                counts = p.fixed == 0 if force.of_movable else (p.fixed == 0) | np.isfinite(energy)
                found[name] = np.where(counts, energy, 0.0)
        return found

    @property
    def interactions(self) -> int:
        """Pairs, or what a tree puts in their place, that forces have computed so far."""
        return self.done + sum(force.interactions for force in self.forces.values())


class Kick:
    """Changes velocities over a time h, by the accelerations from `forces` (which may return None) and the effects on velocities.

    Force and damping are advanced together, exactly. With friction the kick is of second order in h, and near a standstill exact
    but for drag (`kernels.sliding`). Other flows act for h/2 before that, and in reverse order for h/2 after it (Strang
    splitting), so that the whole is symmetric and of second order. Where contacts last, friction and flows act on the velocities
    that these contacts leave, not on those that forces alone would give.
    """

    def __init__(self, effects: ActiveEffects, forces: Callable[[], Array | None], timers: Timers):
        self.damping, self.friction, self.flows = effects.damping, effects.friction, effects.flows
        self.forces, self.timers = forces, timers
        self.presses = effects.keeps_contacts and bool(self.friction or self.flows)
        self.known: tuple[int, int, float] | None = None

    def advance(self, particles: Particles, h: float, drift: float = 0.0) -> Array | None:
        """Kick for a time h; returns a (n, d) or None. `drift`: the length of the drift that follows, or 0. Collective."""
        with self.timers("forces"):
            a = self.forces()
        with self.timers("kick"):
            if self.presses:
                assert a is not None  # contacts last only where there are forces
                contacts = particles.fixed, particles["supported"], particles["total_acceleration"], np.empty_like(a)
                press(a, *contacts)
            rows = to_read(particles, FIXED_IN_KICKS) if self.flows else particles
            for name, flow in self.flows.items():
                call_in_place(name, flow.advance, rows, 0.5 * h)
            self.force_and_losses(particles, a, h, drift if a is None and not self.damping and not self.flows else 0.0)
            for name, flow in reversed(self.flows.items()):
                call_method(name, flow.advance, rows, 0.5 * h)
            if self.presses:
                release(particles.velocity, a, *contacts, self.factors_of(particles, h)[1])
            if self.flows:
                particles.hold_fixed()
        return a

    def force_and_losses(self, particles: Particles, a: Array | None, h: float, coast: float) -> None:
        """Kick without flows. `coast`: length of the drift that follows, if nothing but friction acts in it; else 0."""
        if self.damping is None and self.friction is None:
            if a is not None:
                kick(particles.velocity, a, h)
            return
        decay, force_time = self.factors_of(particles, h)
        a = np.zeros_like(particles.velocity) if a is None else a
        if self.friction:
            self.friction.kick(particles, a, decay, force_time, h, coast)
        else:
            kick_with_drag(particles.velocity, a, decay, force_time)

    def factors_of(self, particles: Particles, h: float) -> tuple[Array, Array]:
        """Return (decay, force_time) (n,): over h, drag takes v to v decay + a force_time. Kept until particles or h change."""
        if self.known != (particles.version, particles.edition, h):
            self.known = particles.version, particles.edition, h
            n = len(particles)
            self.factors = self.damping.factors(particles, h) if self.damping else (np.ones(n), np.full(n, h))
        return self.factors

    def undamped(self, particles: Particles, h: float) -> Array | None:
        """Return which part (n,) of the velocity that a constant force gives in a time h drag leaves; None if it leaves all."""
        return self.factors_of(particles, h)[1] / h if self.damping and h else None

    def rate(self, particles: Particles) -> Array | None:
        """Return dv/dt (n, d) by the flows at the present velocities, or None if there are none."""
        if not self.flows:
            return None
        total = np.zeros_like(particles.velocity)
        rows = to_read(particles, FIXED_IN_KICKS)
        for name, flow in self.flows.items():
            rate = call_method(name, flow.rate, rows)
            if np.shape(rate) != total.shape:
                raise StoppedError(f"effects.{name}: its `rate` returned shape {np.shape(rate)}, and not {total.shape}")
            total += rate
        total[particles.fixed != 0] = 0.0
        return total


class Composition:
    """Kicks and drifts in turn, with given parts of the step as their lengths. After each kick `persistent`, if given, keeps
    contacts that last; after the last kick `closing`, if given, adds what the impulses of other contacts lacked.

    Leapfrog is V(h/2) D(h) V(h/2): v to n+1/2, x to n+1, v to n+1. Kicks and drifts are symmetric, so it is of second order with
    dissipation too, needs one force evaluation, and stays stable for any drag (an explicit -k v in the kicks would not).
    """

    def __init__(self, kick: Kick, persistent: Any, closing: Any, kicks: tuple[float, ...], drifts: tuple[float, ...]):
        self.kick, self.persistent, self.closing = kick, persistent, closing
        self.parts = list(zip(kicks, (*drifts, 0.0), strict=True))

    def advance(self, particles: Particles, h: float, drift: Callable[[float], None]) -> None:
        """Advance by h. A drift follows each kick but the last."""
        for kicked, drifted in self.parts:
            a = self.kick.advance(particles, kicked * h, drifted * h)
            if self.closing and not drifted:
                self.closing.finish(a)
            if self.persistent:
                self.persistent.keep(particles, a, h, self.kick.undamped(particles, kicked * h))
            if drifted:
                drift(drifted * h)


class Taylor:
    """PBPhys's explicit rule, x += v h + (a - k v) h^2/2 and v += (a - k v) h: of first order with drag, or where forces depend
    on the place. It is kept for comparisons with PBPhys.

    It is the same as a drift with the mean velocity v + (a - k v) h/2 between two kicks with the rate a - k v at the start.
    """

    def __init__(self, kick: Kick):
        self.damped, self.kick = kick.damping is not None, kick

    def advance(self, particles: Particles, h: float, drift: Callable[[float], None]) -> None:
        """Advance by h: v to the middle of the step, x to its end, v to its end, all with the rate at the start."""
        with self.kick.timers("forces"):
            a = self.kick.forces()
        with self.kick.timers("kick"):
            rate = particles["rate"]
            rate[:] = 0.0 if a is None else a
            if self.damped:
                rate -= particles["drag"][:, None] * particles.velocity
            by_flows = self.kick.rate(particles)
            if by_flows is not None:
                rate += by_flows
            kick(particles.velocity, rate, 0.5 * h)
        drift(h)
        with self.kick.timers("kick"):
            kick(particles.velocity, particles["rate"], 0.5 * h)
