"""What contacts take, as the tables of collisions and walls say it."""

from math import inf
from typing import Annotated, Any

from pydantic import Field, ValidationInfo, field_validator

from particles_mpi.scene.model import Fraction, Model, NotNegative


class Losses(Model):
    """What contacts leave: `restitution` e (momentum is conserved), or `damping` alpha: the whole velocity times sqrt(1-alpha).

    Spheres are rough with `friction` mu (Coulomb's) or `tangential_restitution` beta_0, the part of the slip of their surfaces
    that comes back, reversed, where they stick: 0 if not given. Without mu they always stick. See `contacts.rough`.
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
        """Do surfaces act on one another in a contact?"""
        return self.surface[0] > 0.0

    def parts(self) -> dict[str, "Losses"]:
        """What contacts take, by the key in the table that says so, "" for the table itself."""
        return {"": self}

    def within(self, table: "Losses") -> "Losses":
        """These, and those of a `table` where they say nothing."""
        normal = table if self.restitution is None and self.damping is None else self
        across = table if self.tangential_restitution is None else self
        return Losses(
            damping=normal.damping,
            restitution=normal.restitution,
            friction=table.friction if self.friction is None else self.friction,
            tangential_restitution=across.tangential_restitution,
        )

    def described(self, scene: Any, total: int) -> str:
        """The surfaces, for the plan."""
        surfaces = {losses.surface for losses in self.parts().values() if losses.rough}
        limits = {mu: "without a limit" if mu == inf else f"{mu:g}" for mu, _ in surfaces}
        texts = [f"friction {limits[mu]}, tangential restitution {beta:g}" for mu, beta in sorted(surfaces)]
        return "rough: " + "; ".join(texts) if texts else ""

    def rough_faults(self, scene: Any) -> list[str]:
        """Why rough spheres cannot be here, each beginning with the key."""
        faults = []
        for part, losses in self.parts().items():
            key = part + ("friction" if losses.friction is not None else "tangential_restitution")
            if losses.rough and scene.dimension not in (2, 3):
                faults.append(f"{key}: spins are known in 2 and 3 dimensions, not in {scene.dimension}")
            if losses.rough and losses.damping is not None:
                faults.append(f"{key}: damping takes of the whole velocity; give restitution, to which friction belongs")
        return faults

    @field_validator("restitution")
    @classmethod
    def _one_of_both(cls, value: float | None, info: ValidationInfo) -> float | None:
        if value is not None and info.data.get("damping") is not None:
            raise ValueError("give restitution or damping, not both (in Python: None for the one to be left)")
        return value
