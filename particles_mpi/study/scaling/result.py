"""What `study scaling` found: its curves, as tables on the screen and as CSV."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from particles_mpi.study.scaling.performance_model import Law, Model, Point

EXTRAPOLATED = [1 << k for k in range(11)]  # ranks that the model is asked about
CROWDED = 1e-4  # seconds: no message within a machine takes that long, unless somebody else has the core


@dataclass(frozen=True)
class Curve:
    """Points of growing rank counts, from one rank on. `weak`: with a constant number of particles a rank, not in all."""

    name: str
    weak: bool
    points: list[Point]

    def particles(self, ranks: int) -> int:
        """In all."""
        return self.points[0].particles * (ranks if self.weak else 1)


@dataclass(frozen=True)
class Result:
    """`points`: those of all curves, and others that the model (None on one rank) was fitted to.

    `no_weak`: why there is no weak curve. `headline`: is this the scene that the course code's times belong to?
    """

    title: str
    law: Law
    curves: list[Curve]
    points: list[Point]
    model: Model | None
    no_weak: list[str]
    headline: bool

    def efficiency(self, curve: Curve, point: Point) -> float:
        """T1/(P TP), or T1/TP on a weak curve; where work grows faster than N, of the work done."""
        one = curve.points[0]
        rate = self.law.rate(point.particles, point.ranks, point.seconds)
        return rate / self.law.rate(one.particles, one.ranks, one.seconds)

    @property
    def origin(self) -> str:
        """Whose measurements the model extrapolates."""
        assert self.model
        ranks = f"1 to {self.model.measured} ranks" if self.model.measured > 1 else "1 rank"
        late = f", disturbed: a message took {self.model.latency * 1e3:.2g} ms" if self.model.latency > CROWDED else ""
        return f"MODEL, extrapolated from {ranks} of one machine{late}"

    def predictions(self) -> Iterator[tuple[Curve, int, dict[str, float], float]]:
        """(curve, ranks, seconds of a step term by term, efficiency)."""
        for curve in self.curves:
            for ranks in EXTRAPOLATED:
                assert self.model
                n = curve.particles(ranks)
                yield curve, ranks, self.model.parts(n, ranks), self.model.efficiency(n, ranks, curve.points[0].particles)
