"""The effects of a scene that are switched on, built and sorted by kind, and what follows from which they are."""

from __future__ import annotations

from typing import TypeVar

from particles_mpi.particles import ALWAYS, FIELDS, OWN
from particles_mpi.scene.effect import (
    ConstantFriction,
    Context,
    Damping,
    Effect,
    Event,
    Force,
    PairContacts,
    VelocityFlow,
    WallContacts,
)
from particles_mpi.scene.schema import Scene

Kind = TypeVar("Kind", bound=Effect)


class ActiveEffects:
    """The effects of a scene by name, in the order of the scene, as attributes for each kind.

    With `switched_off`, those that are not active too.
    """

    def __init__(self, scene: Scene, switched_off: bool = False):
        options = scene.effects if switched_off else scene.active
        self.integrator = scene.time.integrator
        self.all: dict[str, Effect] = {name: of.build(scene) for name, of in options.items()}
        self.forces = self.of_kind(Force)
        self.flows = self.of_kind(VelocityFlow)
        self.events = self.of_kind(Event)
        self.damping = self.one_of(Damping)
        self.friction = self.one_of(ConstantFriction)
        self.walls = self.one_of(WallContacts)
        self.pairs = self.one_of(PairContacts)
        self.on_velocities = self.names(Damping, ConstantFriction, VelocityFlow)  # those that act in a kick

    def of_kind(self, kind: type[Kind]) -> dict[str, Kind]:
        """Those of one kind, by name."""
        return {name: effect for name, effect in self.all.items() if isinstance(effect, kind)}

    def one_of(self, kind: type[Kind]) -> Kind | None:
        """The one of its kind, if there is one."""
        return next(iter(self.of_kind(kind).values()), None)

    def bind(self, context: Context) -> None:
        """Tell all effects of the ranks and ids there are. Collective."""
        for effect in self.all.values():
            effect.bind(context)

    def names(self, *kinds: type[Effect]) -> list[str]:
        """Names of the effects of these kinds."""
        return [name for name, effect in self.all.items() if isinstance(effect, kinds)]

    @property
    def uniform(self) -> bool:
        """Do all forces give all particles the same acceleration?"""
        return all(force.g is not None for force in self.forces.values())

    @property
    def keeps_contacts(self) -> bool:
        """Are there forces that press particles together or onto walls, and contacts that take energy?"""
        lossy = any(contact.lossy for contact in (self.pairs, self.walls) if contact is not None)
        return self.integrator == "leapfrog" and bool(self.forces) and lossy


def fields_of(scene: Scene) -> list[str]:
    """Names of the per-particle fields that a scene needs, in an order that all ranks agree on."""
    effects = ActiveEffects(scene, switched_off=True)
    extra = {name for effect in effects.all.values() for name in effect.needs.columns}
    if scene.time.integrator == "taylor":
        extra.add("rate")
    keeps = effects.keeps_contacts
    if effects.pairs and (effects.pairs.options.mode == "event" or keeps):
        extra.add("contacted")
    if scene.output.observables:
        extra.add("virial")
    if keeps:
        extra.add("supported")
    if (effects.pairs or effects.walls) and (keeps or effects.flows or not effects.uniform):
        extra.add("total_acceleration")
    return [name for name in OWN if name in ALWAYS or name in extra] + sorted(extra & FIELDS.keys() - set(OWN))
