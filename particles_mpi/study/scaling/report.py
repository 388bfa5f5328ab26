"""Reports what `study scaling` found: curves, predictions, rows of the CSV files, and tables on the screen."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from particles_mpi.parallel.communicator import KINDS
from particles_mpi.run.console import Screen
from particles_mpi.study.report import numbers_table
from particles_mpi.study.scaling.performance_model import Law, Model, Point

EXTRAPOLATED = [1 << k for k in (*range(11), 16)]  # numbers of ranks for which the model predicts
DISTURBED_LATENCY = 1e-4  # seconds: no message within a machine takes that long, unless another program has the core
COUNTS = ("fetches", "rows", "ghost_rows", "messages", "reductions", "all_to_alls", *(f"bytes_{kind}" for kind in KINDS))
SHOWN_PHASES = 7  # phases of a table, and of the figure


@dataclass(frozen=True)
class Curve:
    """Points with growing numbers of ranks, from one on. `weak`: the number of particles per rank is constant, not the total."""

    weak: bool
    points: list[Point]

    @property
    def name(self) -> str:
        """The kind of the curve, and its number of particles: of all ranks, or of one."""
        return f"{'weak, N/P' if self.weak else 'strong, N'} = {self.points[0].particles}"

    def particles(self, ranks: int) -> int:
        """Return the particles of all ranks."""
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
        """Return the work per second of a rank over that of one rank alone: T1/(P TP), or T1/TP on a weak curve with work ~ N."""
        alone, together = (self.law.rate(p.particles, p.ranks, p.seconds) for p in (curve.points[0], point))
        return together / alone

    def origin(self, model: Model) -> str:
        """Return a text: the measurements that the model extrapolates."""
        ranks = f"1 to {model.measured} ranks" if model.measured > 1 else "1 rank"
        late = f", disturbed: a message took {model.latency * 1e3:.2g} ms" if model.latency > DISTURBED_LATENCY else ""
        return f"MODEL, extrapolated from {ranks} of one machine{late}"

    def measured_rows(self) -> Iterator[dict[str, Any]]:
        """Yield the rows of scaling.csv: one for each point of each curve; seconds and counts of a step, counts of a rank."""
        phases = dict.fromkeys(name for p in self.points for name in p.phases)
        for curve in self.curves:
            for p in curve.points:
                efficiency = self.efficiency(curve, p)
                row = {"curve": curve.name, "ranks": p.ranks, "particles": p.particles, "oversubscribed": int(p.oversubscribed)}
                row |= {"seconds_per_step": p.seconds, "quartile_1": p.low, "quartile_3": p.high}
                row |= {"speedup": efficiency * p.ranks, "efficiency": efficiency} | {name: p.counts[name] for name in COUNTS}
                yield row | {f"seconds_{name}": p.phases.get(name, 0.0) for name in phases}

    def predicted_rows(self, model: Model) -> Iterator[dict[str, Any]]:
        """Yield the rows of scaling_model.csv: predictions, not measurements; seconds of a step by terms."""
        for curve in self.curves:
            for ranks in EXTRAPOLATED:
                n = curve.particles(ranks)
                row = {"curve": curve.name, "ranks": ranks, "particles": n, "kind": "model"}
                efficiency = model.efficiency(n, ranks, curve.points[0].particles)
                row |= {"seconds_per_step": model.seconds(n, ranks), "efficiency": efficiency}
                yield row | {f"seconds_{name}": seconds for name, seconds in model.parts(n, ranks).items()}


def shares(points: list[Point]) -> list[dict[str, float]]:
    """Return for each point the share of the step of each phase: the longest phases of all points, and "the rest"."""
    each = [{name: s / sum(p.phases.values()) for name, s in p.phases.items()} for p in points]
    total = {name: sum(one.get(name, 0.0) for one in each) for one in each for name in one}
    chosen = [{name: one.get(name, 0.0) for name in sorted(total, key=lambda name: -total[name])[:SHOWN_PHASES]} for one in each]
    return [one | {"the rest": abs(1.0 - sum(one.values()))} for one in chosen]


def say_curve(result: Result, curve: Curve, screen: Screen) -> None:
    """Print a table with a line per number of ranks (counts are per step and rank), and one of the shares of phases."""
    phases = shares(curve.points)
    table = numbers_table("ranks", "ms a step", "quartiles", "speed-up", "efficiency", "ghosts", "messages", "reductions")
    parts = numbers_table("ranks", *phases[0])
    for p, row in zip(curve.points, phases, strict=True):
        name, efficiency = f"{p.ranks}{', oversubscribed' * p.oversubscribed}", result.efficiency(curve, p)
        milliseconds = f"{p.seconds * 1e3:.3g}", f"{p.low * 1e3:.3g} to {p.high * 1e3:.3g}"
        counts = (f"{p.counts[name]:.3g}" for name in ("ghost_rows", "messages", "reductions"))
        table.add_row(name, *milliseconds, f"{efficiency * p.ranks:.2f}", f"{efficiency:.0%}", *counts)
        parts.add_row(name, *(f"{share:.0%}" for share in row.values()))
    screen.say(f": {curve.name}", head=result.title)
    screen.table(table)
    screen.table(parts)


def say_model(result: Result, model: Model, screen: Screen) -> None:
    """Print what the model predicts, from which data, and what it assumes."""
    layer = "all particles" if model.law.fetches_all else f"a layer of {model.thickness:.2g} mean distances"
    fetched = f"rows of {layer} fetched {model.fetches:.2g} times" if model.thickness else "no rows fetched"
    screen.say(
        f"\n  t = {model.fixed * 1e6:.3g} us + {model.imbalance:.2f} x {model.each * 1e9:.3g} ns x work{'/P' * model.law.shared}"
        f" + {model.row * 1e6:.3g} us x rows + {model.latency * 1e6:.3g} us x stages; work = {model.law.growth}\n"
        f"  counted in a step: {fetched}, {model.messages:.2g} messages to"
        f" each neighbour, {model.reductions:.2g} reductions, {model.all_to_alls:.2g} exchanges of all with all\n"
        "  ms a step, efficiency, share of work in the step:",
        head=result.origin(model),
    )
    table, rows = numbers_table("ranks", *(curve.name for curve in result.curves)), list(result.predicted_rows(model))
    for ranks in EXTRAPOLATED:
        cells = ((r["seconds_per_step"], r["efficiency"], r["seconds_work"]) for r in rows if r["ranks"] == ranks)
        table.add_row(str(ranks), *(f"{seconds * 1e3:.3g} ms, {e:.0%}, {work / seconds:.0%}" for seconds, e, work in cells))
    screen.table(table)
    for curve in result.curves:
        screen.say(f"  what ends the scaling ({curve.name}): {what_ends(model, curve)}")
    fitted = [p for p in result.points if not p.oversubscribed]
    residuals = ", ".join(f"N = {p.particles} on {p.ranks}: {model.residual(p):+.0%}" for p in fitted)
    screen.say("\n  assumed: ".join([f"  error of the model where it was fitted: {residuals}", *model.assumptions]))


def what_ends(model: Model, curve: Curve) -> str:
    """Return a text: the longest loss on the two largest numbers of ranks of the model, and the one that grows most."""
    said, losses = [], [model.losses(curve.particles(ranks), ranks, curve.weak) for ranks in EXTRAPOLATED[-2:]]
    for ranks, loss in zip(EXTRAPOLATED[-2:], losses, strict=True):
        longest = max(loss, key=lambda name: loss[name])
        said.append(f"on {ranks} ranks {longest}, {loss[longest] / model.seconds(curve.particles(ranks), ranks):.0%} of a step")
    growth = {name: seconds - losses[0][name] for name, seconds in losses[1].items()}
    growing = max(growth, key=lambda name: growth[name])
    return f"{'; '.join(said)}; the largest growth between the two: {growing}, by {growth[growing] * 1e3:.2g} ms"
