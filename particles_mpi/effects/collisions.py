"""Collisions of spheres: hard contacts with an impulse along the normal, by the operator that `mode` names."""

from typing import Annotated, Literal

from pydantic import Field

from particles_mpi.contacts.law import loss
from particles_mpi.contacts.rough import takes_energy
from particles_mpi.scene.effect import FORWARD, EffectOptions, Needs, PairContacts
from particles_mpi.scene.losses import Losses
from particles_mpi.scene.model import NotNegative
from particles_mpi.scene.schema import Scene


class Options(Losses, EffectOptions):
    """`mode` names the operator; `restitution` or `damping` is what a contact takes; `passes` is for a step in mode `rewind`.

    `allow_overlap`: spheres that overlap at the start are pushed apart, with a warning, instead of being refused.

    `contact_duration` t_c, in mode `event`: a contact within t_c of the last one of either partner takes no energy (TC model). By
    default t_c is a ten-thousandth of a step, and a contact then takes no energy only if its particle has had many that followed
    one another within t_c, or at one moment: 8 under forces, more if particles are few (`contacts/README.md`).
    `contact_tolerance`: where forces keep spheres in contact, the part of a radius by which contacts may close in a step, as root
    mean square.
    """

    mode: Literal["rewind", "event"] = "rewind"
    allow_overlap: bool = False
    passes: Annotated[int, Field(ge=1)] = 10
    contact_duration: NotNegative | None = None
    contact_tolerance: Annotated[float, Field(gt=0.0, le=0.1)] = 1e-4

    def faults(self, scene: Scene) -> list[str]:
        faults = []
        if self.passes != 10 and self.mode != "rewind":
            faults.append('passes: only in mode "rewind"')
        if self.contact_duration is not None and self.mode != "event":
            faults.append('contact_duration: only in mode "event"')
        return faults + self.rough_faults(scene)


class Effect(PairContacts):
    """Collisions of pairs of spheres. The operators are in `contacts/`; this class holds the parameters that they need."""

    formula = "v_i -= (1+e) m_j/(m_i+m_j) (k.v_r) k at |x_i - x_j| = R_i + R_j"
    needs = Needs(divides_by_mass=True, integrators=FORWARD)

    def __init__(self, options: Options, scene: Scene):
        self.options = options
        self.loss = loss(options.restitution, options.damping)
        self.surface = options.surface
        self.lossy = min(self.loss) < 1.0 or takes_energy(self.surface)
