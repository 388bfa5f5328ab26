"""Friction of constant magnitude: m dv/dt = -alpha v/|v|, advanced exactly; a particle at rest stays at rest."""

from math import sqrt

from particles_mpi.lean import inner, kernel
from particles_mpi.particles import Array, Particles
from particles_mpi.scene import Model, Scene


class Options(Model):
    """`strength`: alpha, a force."""

    strength: float

    def faults(self, scene: Scene) -> list[str]:
        return [] if self.strength >= 0.0 else [f"strength: {self.strength} is negative"]


class Effect:
    """friction(h/2) . force(h) . friction(h/2), with the stick rule: |v + h a| <= alpha h/m comes to rest exactly."""

    role = "dissipation"
    fields = ()
    formula = "m dv/dt = -alpha v/|v|"
    divides_by_mass = True

    def __init__(self, options: Options, scene: Scene):
        self.strength = options.strength

    def kick(self, particles: Particles, a: Array, decay: Array, push: Array, h: float, coast: float) -> None:
        """Advance velocities over h; (decay, push) as in drag. `coast` > 0: nothing else acts, see `stopping_velocity`."""
        kick_with_friction(particles.velocity, a, particles.mass, decay, push, self.strength, h, coast)


@inner
def slowed(speed: float, loss: float) -> float:
    """Factor on a velocity of magnitude `speed` after friction took `loss` = alpha h/m of it: max(0, 1 - loss/speed)."""
    return 1.0 - loss / speed if loss < speed else 0.0


@kernel
def kick_with_friction(v, a, mass, decay, push, strength, h, coast):
    """In place on v (n, d). See physics of `Effect`; the half-step factors are exact, the composition is second order.

    A free particle that will stop within the coming drift of length `coast` = dt, i.e. |v| <= alpha dt/m, is given its
    mean velocity over that drift, v t/(2 dt) with t = m |v|/alpha: it covers exactly its stopping distance m v^2/(2 alpha),
    and the closing half-step then brings it to rest.
    """
    d = v.shape[1]
    for i in range(v.shape[0]):
        loss = strength * h / mass[i]
        before = 0.0
        pushed = 0.0
        for k in range(d):
            before += v[i, k] ** 2
            pushed += (v[i, k] * decay[i] + a[i, k] * push[i]) ** 2
        before = sqrt(before)
        if coast > 0.0 and before * mass[i] <= strength * coast:
            mean = 0.5 * before * mass[i] / (strength * coast) if before > 0.0 else 0.0
            for k in range(d):
                v[i, k] *= mean
            continue
        if pushed <= loss * loss:
            for k in range(d):
                v[i, k] = 0.0
            continue
        first = slowed(before, 0.5 * loss)
        after = 0.0
        for k in range(d):
            v[i, k] = v[i, k] * first * decay[i] + a[i, k] * push[i]
            after += v[i, k] ** 2
        second = slowed(sqrt(after), 0.5 * loss)
        for k in range(d):
            v[i, k] *= second
