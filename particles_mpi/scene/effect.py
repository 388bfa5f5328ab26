"""The kinds of effect: when they act, and what they need. How to write one stands in `effects/__init__.py`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from particles_mpi.particles import Array, Column, Particles, add_column

ANY = ("leapfrog", "order4", "taylor", "adaptive")  # all integrators
FORWARD = ("leapfrog", "taylor")  # those with one drift a step, forward in time


@dataclass(frozen=True)
class Needs:
    """What an effect needs of the program.

    columns: per-particle columns of its own, by name; divides_by_mass: a mass of 0 is refused; integrators: those that can
    compute it, others are refused when the scene is read.
    """

    columns: Mapping[str, Column] = field(default_factory=dict)
    divides_by_mass: bool = False
    integrators: tuple[str, ...] = ANY


@dataclass(frozen=True)
class Context:
    """What there is besides a rank's own particles: the ranks, the ids of all particles, and the box.

    ranks: a `Ranks`; ids: an `IdRange`; timers: a `Timers`; lower, upper, length (d,): corners of the box, and its length on
    periodic axes (0 on others). Any where a type would load MPI to check a scene.
    """

    ranks: Any
    ids: Any
    timers: Any
    lower: Array
    upper: Array
    length: Array


class Effect:
    """What all kinds of effect have in common.

    role: the kind, in words, for the plan; formula: the law in one line, for the plan.
    """

    role: ClassVar[str]
    formula: ClassVar[str]
    needs: ClassVar[Needs] = Needs()

    def __init__(self, options: Any, scene: Any):
        """`options`: the validated keys of the effect's table in `scene` (a `Scene`)."""

    def __init_subclass__(cls) -> None:
        """The columns that an effect brings are known to exchange and output from here on."""
        for name, column in cls.needs.columns.items():
            add_column(name, column)

    def bind(self, context: Context) -> None:
        """Called before the first step and whenever the number of particles has changed. Collective."""


class Force(Effect):
    """Adds to an acceleration, and never sets it.

    place_dependent: False if the acceleration stays the same as long as nobody changes a field of the particles; it is then
    not summed anew in each step. collective: does `add` communicate? Then all ranks call it together. g: the acceleration
    (d,) if it is the same for every particle.
    """

    role = "force"
    place_dependent: ClassVar[bool] = True
    collective: ClassVar[bool] = False
    g: Any = None

    @property
    def interactions(self) -> int:
        """Pairs, or what is put in their place, that were computed so far: for comparisons of cost."""
        return 0

    def add(self, particles: Particles, acceleration: Array) -> None:
        """acceleration (n, d) += that of this force, for the rows of this rank."""
        raise NotImplementedError

    def potential(self, particles: Particles) -> Array | None:
        """Potential energy (n,) of each particle, NaN where there is none; None if this force has no energy."""
        return None


class VelocityFlow(Effect):
    """dv/dt as a function of the velocity, at fixed positions. Several act one after the other, symmetrically about the force."""

    role = "velocity"
    needs = Needs(integrators=FORWARD)

    def advance(self, particles: Particles, h: float) -> None:
        """Velocities after a time h with nothing else acting, in place."""
        raise NotImplementedError

    def rate(self, particles: Particles) -> Array:
        """dv/dt (n, d) at the present velocities: contacts, and the integrator `taylor`, ask for it."""
        raise NotImplementedError


class Event(Effect):
    """Acts at the end of the drift of each step, on each particle by itself."""

    role = "event"
    needs = Needs(integrators=FORWARD)

    def act(self, particles: Particles, h: float) -> int:
        """Change rows in place after a drift over h; returns how many particles of this rank were changed."""
        raise NotImplementedError


class Damping(Effect):
    """Linear in the velocity, dv/dt = a - k v, with a rate k per particle in the column `drag`."""

    role = "dissipation"

    def factors(self, particles: Particles, h: float) -> tuple[Array, Array]:
        """(decay, push), each (n,): the velocity after h is v * decay + a * push."""
        raise NotImplementedError


class ConstantFriction(Effect):
    """A force of constant magnitude `strength` against the velocity, computed together with forces and damping."""

    role = "dissipation"
    strength: float

    def kick(self, particles: Particles, a: Array, decay: Array, push: Array, h: float, coast: float) -> None:
        """Advance velocities over h. `coast` > 0: nothing else acts in the coming drift, of that length."""
        raise NotImplementedError


class WallContacts(Effect):
    """`planes` that particles bounce off. lossy: does a bounce take energy?"""

    role = "event"
    planes: Any
    lossy: bool

    def drift(self, particles: Particles, h: float, rates: Any) -> int:
        """Drift over h with walls alone, while velocities change by `rates`; returns the number of wall hits."""
        raise NotImplementedError


class PairContacts(Effect):
    """Spheres that bounce off one another. restitution, keep: see `contacts.law.loss`; lossy: does a contact take energy?"""

    role = "event"
    options: Any
    restitution: float
    keep: float
    lossy: bool


KINDS = (Force, VelocityFlow, Event, Damping, ConstantFriction, WallContacts, PairContacts)
ONE_OF_EACH = (Damping, ConstantFriction, WallContacts, PairContacts)
