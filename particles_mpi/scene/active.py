"""The effects of a scene that are switched on, built and sorted by kind, and what follows from which they are."""

from typing import Any, TypeVar

import numpy as np

from particles_mpi.particles import ALWAYS, BUILT_IN, FIELDS, Array
from particles_mpi.scene import effect as kinds
from particles_mpi.scene.calls import built, call_method
from particles_mpi.scene.schema import Scene

Kind = TypeVar("Kind", bound=kinds.Effect)


class ActiveEffects:
    """The effects of a scene, built from their options, as attributes for each kind; with `switched_off`, also those not active.

    all: every effect by name, in the order of the scene; forces, flows, events: those of a kind, by name; damping, friction,
    rolling, walls, pairs: the only one of its kind, or None; on_velocities: names of those that act on velocities in a kick.
    """

    def __init__(self, scene: Scene, switched_off: bool = False):
        options = scene.effects if switched_off else scene.active
        self.dimension, self.integrator = scene.dimension, scene.time.integrator
        self.all: dict[str, kinds.Effect] = {name: built(name, of, scene) for name, of in options.items()}
        self.forces, self.flows = self.of_kind(kinds.Force), self.of_kind(kinds.VelocityFlow)
        self.events = self.of_kind(kinds.Event)
        self.damping, self.friction = self.one_of(kinds.Damping), self.one_of(kinds.ConstantFriction)
        self.rolling = self.one_of(kinds.RollingResistance)
        self.walls, self.pairs = self.one_of(kinds.WallContacts), self.one_of(kinds.PairContacts)
        self.on_velocities = self.names(kinds.Damping, kinds.ConstantFriction, kinds.VelocityFlow)  # those that act in a kick

    def of_kind(self, kind: type[Kind]) -> dict[str, Kind]:
        """Return the effects of one kind, by name."""
        return {name: effect for name, effect in self.all.items() if isinstance(effect, kind)}

    def one_of(self, kind: type[Kind]) -> Kind | None:
        """Return the only effect of this kind, or None if the scene has none."""
        return next(iter(self.of_kind(kind).values()), None)

    def bind(self, context: kinds.Context) -> None:
        """Give all effects the context: ranks, ids, timers and the box. Collective."""
        for name, effect in self.all.items():
            call_method(name, effect.bind, context)

    def names(self, *of: type[kinds.Effect]) -> list[str]:
        """Names of the effects of these kinds."""
        return [name for name, effect in self.all.items() if isinstance(effect, of)]

    @property
    def uniform(self) -> bool:
        """Do all forces give all particles the same acceleration?"""
        return all(force.g is not None for force in self.forces.values())

    @property
    def rough(self) -> bool:
        """Are there rough spheres, which turn?"""
        return any(mu > 0.0 for mu, _ in self.surfaces)

    @property
    def planes(self) -> Any:
        """The walls, as `kernels.planes.Planes`, of which there may be none."""
        from particles_mpi.kernels.planes import no_planes  # here: a scene is read without compiled kernels

        return self.walls.planes if self.walls else no_planes(self.dimension)

    @property
    def surfaces(self) -> Array:
        """The table `law` of `contacts.rough.Rough`: of pairs, then of each plane."""
        return np.array([self.pairs.surface if self.pairs else (0.0, 0.0), *(self.walls.surfaces if self.walls else [])])

    @property
    def keeps_contacts(self) -> bool:
        """Can contacts last? They can with leapfrog, if there are forces, and contacts that take energy."""
        return self.integrator == "leapfrog" and bool(self.forces) and self.lossy

    @property
    def gives_no_energy(self) -> bool:
        """Have all forces a potential, so that it takes an event or a user's flow to give energy to particles?"""
        known = all(type(force).potential is not kinds.Force.potential for force in self.forces.values())
        return known and not (self.flows or self.events)

    @property
    def conserves_energy(self) -> bool:
        """Is the total energy constant: do forces have a potential, and does no other effect or contact change energy?"""
        return self.gives_no_energy and not (self.on_velocities or self.lossy)

    @property
    def finishes_bounces(self) -> bool:
        """Does the closing kick complete the impulses of contacts (`contacts.closing_kick`)?"""
        depends = any(force.place_dependent for force in self.forces.values())
        return depends and self.integrator == "leapfrog" and bool(self.pairs or self.walls)

    @property
    def elastic(self) -> bool:
        """Do collisions of particles keep the energy?"""
        return self.pairs is None or not self.pairs.lossy

    @property
    def lossy(self) -> bool:
        """Do contacts take energy? Particles can then crowd together, and have many contacts in a step."""
        return any(contact.lossy for contact in (self.pairs, self.walls) if contact is not None)


def fields_of(scene: Scene) -> list[str]:
    """Names of the per-particle fields that a scene needs, in an order that all ranks agree on."""
    effects = ActiveEffects(scene, switched_off=True)
    keeps, pairs = effects.keeps_contacts, effects.pairs
    conditions = {
        "rate": scene.time.integrator == "taylor",
        "contacted": pairs and (pairs.options.mode == "event" or effects.lossy),
        "virial": scene.output.observables,
        "supported": keeps,
        "spin": scene.rough,
        "moment_of_inertia": scene.rough,
        "orientation": scene.rough and scene.output.orientation,
        "free_acceleration": keeps and effects.finishes_bounces,
        "total_acceleration": (pairs or effects.walls) and (keeps or not effects.uniform),
    }
    needed = {*ALWAYS, *(name for name, condition in conditions.items() if condition)}
    needed |= {name for effect in effects.all.values() for name in effect.needs.columns}
    if needed & {"spin", "moment_of_inertia", "orientation"}:  # each of them needs the first two
        needed |= {"spin", "moment_of_inertia"}
    return [name for name in BUILT_IN if name in needed] + sorted(needed & FIELDS.keys() - set(BUILT_IN))
