"""Who keeps contacts that last, where a scene can have any."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from particles_mpi.contacts.rough import FRICTION
from particles_mpi.kernels.planes import no_planes
from particles_mpi.particles import Particles
from particles_mpi.scene.active import ActiveEffects
from particles_mpi.scene.effect import Context

if TYPE_CHECKING:
    from particles_mpi.contacts.persistent.operator import PersistentContacts


def keeper_of_contacts(effects: ActiveEffects, context: Context, p: Particles) -> PersistentContacts | None:
    """The operator for contacts that last, where forces and losses can make one last; else None. Collective.

    Elastic spheres, too, come to rest on one another where the walls below them take energy and forces are the same for all.
    """
    if not effects.keeps_contacts:
        return None
    from particles_mpi.contacts.persistent.operator import PersistentContacts
    from particles_mpi.contacts.persistent.surfaces import Surfaces

    pairs, walls = effects.pairs is not None and effects.pairs.lossy, effects.walls
    if effects.pairs and not pairs and effects.uniform:
        pairs = context.ranks.any((p.radius > 0.0).any())
    planes, taking = (walls.planes, walls.taking) if walls else (no_planes(p.dimension), np.empty(0, bool))
    tolerance, points = 0.0, False
    if effects.pairs:
        options = effects.pairs.options
        tolerance, points = options.contact_tolerance, p.dimension == 1 and options.mode == "event"
    friction, resistance = effects.surfaces[:, FRICTION], effects.rolling.resistance if effects.rolling else 0.0
    rough = Surfaces(float(friction[0]), friction[1:], resistance)
    return PersistentContacts(
        context.ranks, context.length, pairs, planes, taking, rough, effects.uniform, tolerance, context.timers, points,
        migrating=effects.pairs is not None,
    )  # fmt: skip
