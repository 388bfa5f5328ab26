"""Walls: planes (point p, unit normal n into the free side). Contact at (x-p).n = R with v.n < 0; v -= (1+e)(v.n) n."""

from __future__ import annotations

from math import inf

import numpy as np

from particles_mpi.contacts.law import loss
from particles_mpi.contacts.velocity_flow import Rates
from particles_mpi.contacts.walls import Planes, drift_with_walls
from particles_mpi.particles import Particles
from particles_mpi.scene.schema import EffectOptions, Fraction, Model, Scene


class Plane(Model):
    """`point` on the wall, `normal` into the free side (any length); `restitution` or `damping` if not the table's."""

    point: list[float]
    normal: list[float]
    restitution: Fraction | None = None
    damping: Fraction | None = None


class Options(EffectOptions):
    """`restitution` e, or `damping` alpha (whole velocity times sqrt(1-alpha)); `planes`, or every non-periodic box face."""

    restitution: Fraction | None = None
    damping: Fraction | None = None
    planes: list[Plane] | None = None

    def faults(self, scene: Scene) -> list[str]:
        d, faults = scene.dimension, []
        if self.restitution is not None and self.damping is not None:
            faults.append("restitution: give restitution or damping, not both")
        for number, plane in enumerate(self.planes or []):
            key = f"planes[{number}]"
            faults += [
                f"{key}.{name}: {len(value)} components in dimension {d}"
                for name, value in (("point", plane.point), ("normal", plane.normal))
                if len(value) != d
            ]
            if not any(plane.normal):
                faults.append(f"{key}.normal: has no length")
            if plane.restitution is not None and plane.damping is not None:
                faults.append(f"{key}.restitution: give restitution or damping, not both")
        if self.planes is None and scene.box is None:
            faults.append("planes: needed where there is no [box]")
        return faults


def planes_of(options: Options, scene: Scene) -> Planes:
    """The walls of a scene."""
    d = scene.dimension
    planes = options.planes
    if planes is None:
        assert scene.box is not None
        planes = []
        for k in [k for k in range(d) if not scene.periodic[k]]:
            for corner, sign in ((scene.box.lower, 1.0), (scene.box.upper, -1.0)):
                planes.append(Plane(point=list(corner), normal=[sign if m == k else 0.0 for m in range(d)]))
    point = np.array([p.point for p in planes], float).reshape(-1, d)
    normal = np.array([p.normal for p in planes], float).reshape(-1, d)
    normal /= np.sqrt((normal**2).sum(axis=1, keepdims=True))
    losses = [
        loss(options.restitution, options.damping)
        if p.restitution is None and p.damping is None
        else loss(p.restitution, p.damping)
        for p in planes
    ]
    lower, upper = np.full(d, -inf), np.full(d, inf)
    oblique = np.abs(normal).max(axis=1, initial=0.0) < 1.0
    for x, n in zip(point[~oblique], normal[~oblique], strict=True):
        k = int(np.abs(n).argmax())
        if n[k] > 0.0:
            lower[k] = max(lower[k], x[k])
        else:
            upper[k] = min(upper[k], x[k])
    e, factor = (np.array(column, float) for column in zip(*losses, strict=True)) if losses else (np.empty(0), np.empty(0))
    return Planes(point, normal, e, factor, lower, upper, bool(oblique.any()))


class Effect:
    """Reflects spheres off planes, at the instant of contact."""

    role = "event"
    fields = ()
    formula = "v -= (1+e)(v.n) n at (x-p).n = R"

    def __init__(self, options: Options, scene: Scene):
        self.planes = planes_of(options, scene)
        self.lossy = bool(self.planes.lossy.any())

    def drift(self, particles: Particles, h: float, rates: Rates) -> int:
        """Drift over h with walls alone, while velocities change by `rates`; returns the number of wall hits. Purely local."""
        p, axes = particles, (0,) * particles.dimension
        w = p.inverse_mass if rates.alpha else np.empty(0)
        return drift_with_walls(axes, p.position, p.velocity, p.radius, w, h, tuple(self.planes), rates)
