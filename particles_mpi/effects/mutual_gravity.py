"""Mutual gravity: every particle attracts every other, fixed ones too; those without mass feel it and do not attract."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from particles_mpi.gravity.direct import add_potential, attract
from particles_mpi.parallel.blocks import blocks
from particles_mpi.parallel.ranks import Ranks
from particles_mpi.particles import Array, Particles
from particles_mpi.scene import Model, Scene


class Options(Model):
    """`G`, by default the scene's; `softening` eps (length): the force of a Plummer sphere of that size (Aarseth 1963).

    `method`: "direct", the sum over all pairs.
    """

    G: Annotated[float, Field(ge=0.0)] | None = None
    softening: Annotated[float, Field(ge=0.0)] = 0.0
    method: Literal["direct", "tree"] = "direct"
    opening_angle: Annotated[float, Field(gt=0.0, le=1.0)] = 0.5

    def faults(self, scene: Scene) -> list[str]:
        faults = []
        if self.method == "tree":
            faults.append('method: "tree" is not available in this version; use "direct"')
        if any(scene.periodic):
            faults.append("method: no images of a periodic box attract one another here; use a box that is not periodic, or none")
        return faults


class Effect:
    """Adds the attraction; its potential energy is shared by both partners of a pair."""

    role = "force"
    fields = ()
    formula = "dv_i/dt = G sum_j m_j (x_j - x_i)/(|x_j - x_i|^2 + eps^2)^(3/2)"
    constant = False

    def __init__(self, options: Options, scene: Scene):
        self.G = scene.G if options.G is None else options.G
        self.softening2 = options.softening**2
        self.axes = (0,) * scene.dimension

    def enter(self, ranks: Ranks, total: int) -> None:
        """Whose particles attract: all `total` of them, on these ranks."""
        self.ranks, self.total = ranks, total

    def add(self, particles: Particles, acceleration: Array) -> None:
        """acceleration (n, d) += that of all sources. Collective."""
        columns = {name: particles[name] for name in ("id", "position", "mass")}
        pull = np.zeros_like(acceleration)
        for block in blocks(self.ranks, columns, self.total):
            attract(self.axes, particles.position, block["position"], block["mass"], self.softening2, pull)
        acceleration += self.G * pull

    def potential(self, particles: Particles) -> Array:
        """Half of each pair's energy, all of it where the partner is fixed, whose own share nobody counts; (n,). Collective."""
        columns = {name: particles[name] for name in ("id", "position")}
        columns["mass"] = particles.mass * np.where(particles.fixed != 0, 1.0, 0.5)
        total = np.zeros(len(particles))
        for block in blocks(self.ranks, columns, self.total):
            add_potential(
                self.axes, particles.position, particles.id, block["position"], block["mass"], block["id"], self.softening2, total
            )
        return self.G * particles.mass * total
