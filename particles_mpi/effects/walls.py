"""Walls: planes (point p, unit normal n into the free side). Contact at (x-p).n = R with v.n < 0; v -= (1+e)(v.n) n."""

from math import inf

import numpy as np

from particles_mpi.contacts.closing_kick import LastContacts
from particles_mpi.contacts.law import loss
from particles_mpi.contacts.rough import Rough, takes_energy
from particles_mpi.contacts.velocity_flow import Rates
from particles_mpi.contacts.walls import WallNotes, drift_with_walls
from particles_mpi.kernels.planes import Planes
from particles_mpi.particles import Particles
from particles_mpi.scene.effect import FORWARD, EffectOptions, Needs, WallContacts
from particles_mpi.scene.losses import Losses
from particles_mpi.scene.model import wrong_length
from particles_mpi.scene.schema import Scene


class Plane(Losses):
    """`point` on the wall, `normal` into the free side (of any length); losses that it does not give are those of the table."""

    point: list[float]
    normal: list[float]


class Options(Losses, EffectOptions):
    """`planes`: the walls, by default every face of the box that is not periodic. `restitution` or `damping`, `friction` and
    `tangential_restitution` are for planes that do not give their own.
    """

    planes: list[Plane] | None = None

    @property
    def divides_by_mass(self) -> bool:
        """Is a mass of 0 refused? It is if a wall is rough: the spheres that it turns need a moment of inertia."""
        return any(losses.rough for losses in self.parts().values())

    def faults(self, scene: Scene) -> list[str]:
        d, faults = scene.dimension, self.rough_faults(scene)
        for number, plane in enumerate(self.planes or []):
            key = f"planes[{number}]"
            faults += wrong_length(f"{key}.point", plane.point, d) + wrong_length(f"{key}.normal", plane.normal, d)
            if not any(plane.normal):
                faults.append(f"{key}.normal: has no length")
        if self.planes is None and scene.box is None:
            faults.append("planes: needed where there is no [box]")
        return faults

    def parts(self) -> dict[str, Losses]:
        if self.planes is None:
            return {"": self}
        return {f"planes[{number}].": plane.within(self) for number, plane in enumerate(self.planes)}


class Effect(WallContacts):
    """Reflects spheres off planes, at the instant of contact."""

    formula = "v -= (1+e)(v.n) n at (x-p).n = R"
    needs = Needs(integrators=FORWARD)

    def __init__(self, options: Options, scene: Scene):
        d, planes = scene.dimension, options.planes
        if planes is None:
            assert scene.box is not None
            corners = ((scene.box.lower, 1.0), (scene.box.upper, -1.0))
            planes = [
                Plane(point=list(corner), normal=[sign if m == k else 0.0 for m in range(d)])
                for k in range(d)
                for corner, sign in corners
                if not scene.periodic[k]
            ]
        point = np.array([p.point for p in planes], float).reshape(-1, d)
        normal = np.array([p.normal for p in planes], float).reshape(-1, d)
        size = np.frexp(np.abs(normal).max(axis=1, initial=0.0, keepdims=True))[1]
        normal = np.ldexp(normal, -size)  # by a power of two, so that squares are never out of range
        normal /= np.sqrt((normal**2).sum(axis=1, keepdims=True))
        losses = [plane.within(options) for plane in planes]
        e, factor = np.array([loss(of.restitution, of.damping) for of in losses], float).reshape(-1, 2).T.copy()
        self.surfaces = [of.surface for of in losses]
        lower = np.where(normal == 1.0, point, -inf).max(axis=0, initial=-inf)
        upper = np.where(normal == -1.0, point, inf).min(axis=0, initial=inf)
        oblique = np.abs(normal).max(axis=1, initial=0.0) < 1.0
        self.planes = Planes(point, normal, e, factor, lower, upper, bool(oblique.any()))
        self.taking = self.planes.lossy | np.array([takes_energy(of) for of in self.surfaces], bool)
        self.lossy = bool(self.taking.any())
        self.law = np.array([(0.0, 0.0), *self.surfaces])

    def drift(self, particles: Particles, h: float, rates: Rates, noting: bool) -> tuple[int, int, LastContacts]:
        p, d = particles, particles.dimension
        w = p.inverse_mass if rates.alpha or self.law.any() else np.empty(0)
        fields = (0,) * d, p.position, p.velocity, p.radius, w
        rough = Rough(p.arrays.get("spin", np.empty((0, 1))), p.inverse_inertia, self.law, np.empty(d), np.empty(d))
        n, no_rows = len(p) if noting else 0, np.empty(0, np.int64)
        notes = WallNotes(np.empty(len(p)), np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n))
        hits, missed, _, noted = drift_with_walls(*fields, tuple(notes), h, tuple(self.planes), rates, rough, 0.0, no_rows)
        fixed = {"id": no_rows, "place": np.empty((0, d)), "radius": np.empty(0)}
        return hits, missed, LastContacts(notes.row[:noted], notes.wall[:noted], notes.time[:noted], fixed)
