"""The kinds of effect, as base classes. `effects/__init__.py` explains how to write an effect, and `effect_files` loads it."""

import sys
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

from particles_mpi.particles import Array, Column, Particles, add_column
from particles_mpi.scene.model import Model

ANY = ("leapfrog", "order4", "taylor", "adaptive")  # all integrators
FORWARD = ("leapfrog", "taylor")  # those with one drift a step, forward in time


class EffectOptions(Model):
    """The keys of a table `[effects.NAME]`. An effect that is not `active` does nothing until it is switched on.

    `file`: the Python file of an effect from outside the program, relative to the scene file.
    """

    active: bool = True
    file: str | None = None

    @classmethod
    def effect_class(cls) -> Any:
        """The class `Effect` of the file in which these options are defined."""
        return vars(sys.modules[cls.__module__])["Effect"]

    @property
    def divides_by_mass(self) -> bool:
        """Is a mass of 0 refused with these options?"""
        return bool(self.effect_class().needs.divides_by_mass)

    def described(self, scene: Any, total: int) -> str:
        """How the effect is computed for `total` particles, in a few words for the plan; "" if there is only one way."""
        return ""

    def faults(self, scene: Any) -> list[str]:
        """What is wrong with these options in this scene, each beginning with the key; [] if nothing is."""
        return []


class Needs(NamedTuple):
    """What an effect needs from the program.

    columns: columns per particle that it brings, by name; divides_by_mass: is a mass of 0 refused? integrators: those that can
    compute the effect; a scene with another one is refused.
    """

    columns: Mapping[str, Column] = MappingProxyType({})
    divides_by_mass: bool = False
    integrators: tuple[str, ...] = ANY


class Context(NamedTuple):
    """What an effect can use besides its rank's particles. Types that would import MPI are given as Any."""

    ranks: Any  # a `Communicator`
    ids: Any  # an `IdRange`
    timers: Any  # a `Timers`
    lower: Array  # (d,): corners of the box, infinite where space is open
    upper: Array
    length: Array  # (d,): of the box on periodic axes, 0 on others

    @property
    def box(self) -> Any:
        """The corners and lengths of the box together, a `kernels.geometry.Box`."""
        from particles_mpi.kernels.geometry import Box  # here: a scene is read without compiled kernels

        return Box(self.lower, self.upper, self.length)


class Effect:
    """The base class of all kinds of effect. The plan prints `role`, the kind in words, and `formula`, the law in one line."""

    role: ClassVar[str]
    formula: ClassVar[str]
    possible: ClassVar[tuple[str, ...]] = ANY  # integrators that can compute an effect of this kind, whatever it `needs`
    needs: ClassVar[Needs] = Needs()

    def __init__(self, options: Any, scene: Any):
        """`options`: the validated keys of the effect's table in `scene` (a `Scene`)."""

    def __init_subclass__(cls) -> None:
        """Check `needs` (ValueError if it is wrong) and enter its columns into FIELDS, for exchange and output."""
        columns: Any = cls.needs.columns
        if not (isinstance(columns, Mapping) and all(isinstance(column, Column) for column in columns.values())):
            raise ValueError('its needs.columns must be a table of columns, as {"charge": Column()}')
        if unknown := [name for name in cls.needs.integrators if name not in ANY]:
            raise ValueError(f"its needs.integrators: there is no {unknown[0]!r}")
        cls.needs = cls.needs._replace(integrators=tuple(name for name in cls.needs.integrators if name in cls.possible))
        if not cls.needs.integrators:
            raise ValueError(f"its needs.integrators: an effect of this kind works with {' and '.join(cls.possible)} only")
        for name, column in columns.items():
            add_column(name, column)

    @staticmethod
    def option_changed(particles: Particles, before: Any, after: Any) -> None:
        """Update columns that depend on options, which have changed from `before` to `after` between two steps."""

    def bind(self, context: Context) -> None:
        """Called once for each effect object, before the first step in which it acts. Collective.

        Effects are built and bound anew when particles are added or removed, and when an option of an effect is changed.
        """


class Force(Effect):
    """A force: it adds to the accelerations of particles, and never overwrites them."""

    role = "force"
    place_dependent: ClassVar[bool] = True  # False: evaluated again only after a user's change, or a new order of rows
    collective: ClassVar[bool] = False  # does `add` communicate? Then all ranks call it together
    of_movable: ClassVar[bool] = False  # True: `potential` of movable particles has the part of fixed ones too
    g: Any = None  # the acceleration (d,), if it is the same for every particle
    direct: Any = None  # the sum over all pairs, with its `G` and `softening2`, if that is what the force adds
    interactions: Any = 0  # pairs, or tree interactions, computed so far: for comparisons of cost

    def add(self, particles: Particles, acceleration: Array) -> None:
        """Add the acceleration by this force to `acceleration` (n, d), for the rows of this rank. In place."""
        raise NotImplementedError

    def potential(self, particles: Particles) -> Array | None:
        """Return the potential energy (n,) of each particle, NaN where it has none; None if this force has no energy.

        Each partner of a pair has half of the pair's energy, also if one of them is fixed.
        """
        return None


class VelocityFlow(Effect):
    """A law dv/dt = f(v) that changes velocities at fixed positions.

    In a kick all flows act for half of its time before the force, and in reverse order for the other half after it. At a contact
    within the drift, what a flow does between the middle of the step and the contact is left out: a flow that does no work then
    changes no energy at contacts.
    """

    role = "velocity"
    possible = FORWARD

    def advance(self, particles: Particles, h: float) -> None:
        """Change velocities in place to those after a time h in which nothing else acts."""
        raise NotImplementedError

    def rate(self, particles: Particles) -> Array:
        """Return dv/dt (n, d) at the present velocities; only the integrator `taylor` calls it."""
        raise NotImplementedError


class Event(Effect):
    """Acts at the end of the drift of each step, on each particle by itself."""

    role = "event"
    possible = FORWARD

    def act(self, particles: Particles, h: float) -> int:
        """Change rows in place after a drift over h; returns how many particles of this rank were changed."""
        raise NotImplementedError


class Damping(Effect):
    """Linear in the velocity, dv/dt = a - k v, with a rate k per particle in the column `drag`."""

    role = "dissipation"

    def factors(self, particles: Particles, h: float) -> tuple[Array, Array]:
        """Return (decay, force_time), each (n,): after a time h the velocity is v * decay + a * force_time."""
        raise NotImplementedError


class ConstantFriction(Effect):
    """A force of constant magnitude `strength` against the velocity, computed together with forces and damping."""

    role = "dissipation"
    strength: float

    def kick(self, particles: Particles, a: Array, decay: Array, force_time: Array, h: float, coast: float) -> None:
        """Advance velocities over h by forces, damping and friction together, in place.

        `a` (n, d): accelerations by forces; `decay`, `force_time` (n,): what `Damping.factors` gives for h; `coast`: the length
        of the drift that follows, if nothing but friction acts in it, else 0.
        """
        raise NotImplementedError


class WallContacts(Effect):
    """Planes that particles bounce off. lossy: does any bounce take energy? taking (w,): does one at each of the w planes?
    surfaces: (mu, beta_0) of each plane, see `contacts.rough`.
    """

    role = "event"
    planes: Any
    lossy: bool
    taking: Any
    surfaces: list[tuple[float, float]]

    def drift(self, particles: Particles, h: float, rates: Any, noting: bool) -> tuple[int, int, Any]:
        """Move particles over a time h where there are walls and no pairs, while velocities change by `rates`. Not collective.

        Returns the number of wall hits, the number of particles that had no room to move, and the `LastContacts` of particles in
        the drift, which are recorded only if it is `noting` them.
        """
        raise NotImplementedError


class PairContacts(Effect):
    """Spheres that bounce off one another. loss: a `contacts.law.Loss`; surface: (mu, beta_0), see `contacts.rough`; lossy: does
    a contact take energy?
    """

    role = "event"
    options: Any
    loss: Any
    surface: tuple[float, float]
    lossy: bool


class RollingResistance(Effect):
    """A couple against the rolling and spinning of contacts that last, of at most `resistance` (a length) times their force."""

    role = "dissipation"
    resistance: float
