"""The keys for restitution, damping and friction, which the tables of collisions and walls share."""

from math import inf
from typing import Annotated, Any

from pydantic import Field, ValidationInfo, field_validator

from particles_mpi.scene.model import Fraction, Model, NotNegative


class Losses(Model):
    """What a contact takes: `restitution` e (momentum is conserved), or `damping` alpha, which multiplies velocities by
    sqrt(1-alpha).

    Spheres are rough with `friction` mu (Coulomb's) or `tangential_restitution` beta_0. That is the part of the slip of their
    surfaces that a contact which sticks reverses: 0 if it is not given. Without mu contacts always stick. See `contacts.rough`.
    """

    damping: Fraction | None = None
    restitution: Fraction | None = None
    friction: NotNegative | None = None
    tangential_restitution: Annotated[float, Field(ge=-1.0, le=1.0)] | None = None

    @property
    def surface(self) -> tuple[float, float]:
        """(mu, beta_0) of contacts, see `contacts.rough`: (0, 0) if they are smooth, an infinite mu if they always stick."""
        beta = 0.0 if self.tangential_restitution is None else self.tangential_restitution
        mu = (0.0 if self.tangential_restitution is None else inf) if self.friction is None else self.friction
        return (mu, beta) if mu > 0.0 and beta > -1.0 else (0.0, 0.0)

    @property
    def rough(self) -> bool:
        """Does a contact also act along the surfaces, by friction?"""
        return self.surface[0] > 0.0

    def parts(self) -> dict[str, "Losses"]:
        """Return the losses of each part of this table, by the beginning of its keys; "" stands for the table itself."""
        return {"": self}

    def within(self, table: "Losses") -> "Losses":
        """Return these losses, and those of `table` for the keys that are not given here."""
        normal = table if self.restitution is None and self.damping is None else self
        across = table if self.tangential_restitution is None else self
        return Losses(
            damping=normal.damping,
            restitution=normal.restitution,
            friction=table.friction if self.friction is None else self.friction,
            tangential_restitution=across.tangential_restitution,
        )

    def described(self, scene: Any, total: int) -> str:
        """Return a description of the rough surfaces for the plan, "" if there are none."""
        surfaces = {losses.surface for losses in self.parts().values() if losses.rough}
        limits = {mu: "without a limit" if mu == inf else f"{mu:g}" for mu, _ in surfaces}
        texts = [f"friction {limits[mu]}, tangential restitution {beta:g}" for mu, beta in sorted(surfaces)]
        return "rough: " + "; ".join(texts) if texts else ""

    def rough_faults(self, scene: Any) -> list[str]:
        """Return why spheres cannot be rough in this scene, as lines that begin with the key; [] if they can."""
        faults = []
        for part, losses in self.parts().items():
            key = part + ("friction" if losses.friction is not None else "tangential_restitution")
            if losses.rough and scene.dimension not in (2, 3):
                faults.append(f"{key}: rough spheres need dimension 2 or 3, not {scene.dimension}")
            if losses.rough and losses.damping is not None:
                faults.append(f"{key}: damping acts on the whole velocity and has no friction; give restitution instead")
        return faults

    @field_validator("restitution")
    @classmethod
    def _one_of_both(cls, value: float | None, info: ValidationInfo) -> float | None:
        if value is not None and info.data.get("damping") is not None:
            raise ValueError("give restitution or damping, not both (in Python: set the other to None)")
        return value
