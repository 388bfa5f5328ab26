"""What `study scaling` found: curves, predictions, tables on the screen and as CSV."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.table import Table

from particles_mpi.output.files import replacing
from particles_mpi.run.console import Screen
from particles_mpi.study.scaling.performance_model import Law, Model, Point

EXTRAPOLATED = [1 << k for k in range(11)]  # ranks that the model is asked about
DISTURBED = 1e-4  # seconds: no message within a machine takes that long, unless somebody else has the core
COUNTS = ("fetches", "rows", "ghost_rows", "messages", "reductions", "all_to_alls")
SHOWN = 7  # phases of a table


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

    def origin(self, model: Model) -> str:
        """Whose measurements the model extrapolates."""
        ranks = f"1 to {model.measured} ranks" if model.measured > 1 else "1 rank"
        late = f", disturbed: a message took {model.latency * 1e3:.2g} ms" if model.latency > DISTURBED else ""
        return f"MODEL, extrapolated from {ranks} of one machine{late}"

    def predictions(self, model: Model) -> Iterator[tuple[Curve, int, dict[str, float], float]]:
        """(curve, ranks, seconds of a step term by term, efficiency)."""
        for curve in self.curves:
            for ranks in EXTRAPOLATED:
                n = curve.particles(ranks)
                yield curve, ranks, model.parts(n, ranks), model.efficiency(n, ranks, curve.points[0].particles)


def report(result: Result, folder: Path, screen: Screen) -> list[Path]:
    """Print the tables, write them as CSV, and return the files; on one rank."""
    for curve in result.curves:
        screen.say(f"[bold]{result.title or 'untitled scene'}[/bold]: {curve.name}")
        screen.say(measured_table(result, curve))
        screen.say(phases_table(curve))
    if result.no_weak:
        screen.say(f"no weak scaling: {'; '.join(result.no_weak)}")
    files = [write(folder / "scaling.csv", list(measured_rows(result)))]
    if result.model:
        say_model(result, result.model, screen)
        files.append(write(folder / "scaling_model.csv", list(predicted_rows(result, result.model))))
    else:
        screen.say("no model: on one rank nothing is sent; mpirun -n P measures up to P ranks")
    return files


def numbers_table(*columns: str) -> Table:
    """A table of numbers, to the right."""
    table = Table(box=None, padding=(0, 2, 0, 0))
    for column in columns:
        table.add_column(column, justify="right")
    return table


def name_of(point: Point) -> str:
    """Its number of ranks, and whether they shared cores."""
    return f"{point.ranks}{', oversubscribed' * point.oversubscribed}"


def measured_table(result: Result, curve: Curve) -> Table:
    """A line a rank count; counts are those of a step and a rank."""
    table = numbers_table("ranks", "ms a step", "quartiles", "speed-up", "efficiency", "ghosts", "messages", "reductions")
    for p in curve.points:
        efficiency = result.efficiency(curve, p)
        milliseconds = f"{p.seconds * 1e3:.3g}", f"{p.low * 1e3:.3g} to {p.high * 1e3:.3g}"
        counts = [f"{p.counts[name]:.3g}" for name in ("ghost_rows", "messages", "reductions")]
        table.add_row(name_of(p), *milliseconds, f"{efficiency * p.ranks:.2f}", f"{efficiency:.0%}", *counts)
    return table


def shares(points: list[Point], most: int) -> list[dict[str, float]]:
    """Of each point, the share of the step that each phase takes: the longest phases of all points, and "the rest"."""
    each = [{name: s / sum(p.phases.values()) for name, s in p.phases.items()} for p in points]
    total = {name: sum(one.get(name, 0.0) for one in each) for one in each for name in one}
    names = sorted(total, key=lambda name: -total[name])[:most]
    chosen = [{name: one.get(name, 0.0) for name in names} for one in each]
    return [one | {"the rest": abs(1.0 - sum(one.values()))} for one in chosen]


def phases_table(curve: Curve) -> Table:
    """Shares of the step, the longest phases of the curve first."""
    rows = shares(curve.points, SHOWN)
    table = numbers_table("ranks", *rows[0])
    for p, row in zip(curve.points, rows, strict=True):
        table.add_row(name_of(p), *(f"{share:.0%}" for share in row.values()))
    return table


def say_model(result: Result, model: Model, screen: Screen) -> None:
    """What the model says, from what, and what it takes for granted."""
    traffic = model.traffic
    layer = "all particles" if model.law.everyone else f"a layer of {traffic.thickness:.2g} mean distances"
    fetched = f"rows of {layer} fetched {traffic.fetches:.2g} times" if traffic.thickness else "no rows fetched"
    screen.say(
        f"[bold]{result.origin(model)}[/bold]\n"
        f"  t = {model.fixed * 1e6:.3g} us + {model.imbalance:.2f} x {model.each * 1e9:.3g} ns x work{'/P' * model.law.shared}"
        f" + {model.row * 1e6:.3g} us x rows + {model.latency * 1e6:.3g} us x stages; work = {model.law.growth}\n"
        f"  counted in a step: {fetched}, {traffic.messages:.2g} messages to"
        f" each neighbour, {traffic.reductions:.2g} reductions, {traffic.all_to_alls:.2g} exchanges of all with all"
    )
    table, rows = numbers_table("ranks", *(curve.name for curve in result.curves)), dict[int, list[str]]()
    for _, ranks, parts, efficiency in result.predictions(model):
        seconds = sum(parts.values())
        rows.setdefault(ranks, []).append(f"{seconds * 1e3:.3g} ms, {efficiency:.0%}, {parts['work'] / seconds:.0%}")
    for ranks, cells in rows.items():
        table.add_row(str(ranks), *cells)
    screen.say("  ms a step, efficiency, share of work in the step:")
    screen.say(table)
    fitted = [p for p in result.points if not p.oversubscribed]
    residuals = ", ".join(f"N = {p.particles} on {p.ranks}: {model.residual(p):+.0%}" for p in fitted)
    screen.say(
        "\n".join([f"  error of the model where it was fitted: {residuals}", *(f"  assumed: {a}" for a in model.assumptions)])
    )


def measured_rows(result: Result) -> Iterator[dict[str, Any]]:
    """Of scaling.csv: a row for each point of each curve; seconds and counts of a step, counts of a rank."""
    phases = dict.fromkeys(name for p in result.points for name in p.phases)
    for curve in result.curves:
        for p in curve.points:
            efficiency = result.efficiency(curve, p)
            row = {"curve": curve.name, "ranks": p.ranks, "particles": p.particles, "oversubscribed": int(p.oversubscribed)}
            row |= {"seconds_per_step": p.seconds, "quartile_1": p.low, "quartile_3": p.high}
            row |= {"speedup": efficiency * p.ranks, "efficiency": efficiency} | {name: p.counts[name] for name in COUNTS}
            yield row | {f"seconds_{name}": p.phases.get(name, 0.0) for name in phases}


def predicted_rows(result: Result, model: Model) -> Iterator[dict[str, Any]]:
    """Of scaling_model.csv: predictions, not measurements; seconds of a step by terms."""
    for curve, ranks, parts, efficiency in result.predictions(model):
        row = {"curve": curve.name, "ranks": ranks, "particles": curve.particles(ranks), "kind": "model"}
        row |= {"seconds_per_step": sum(parts.values()), "efficiency": efficiency}
        yield row | {f"seconds_{name}": seconds for name, seconds in parts.items()}


def write(path: Path, rows: list[dict[str, Any]]) -> Path:
    """Rows with the same keys as CSV."""
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        out = csv.DictWriter(file, list(rows[0]))
        out.writeheader()
        out.writerows(rows)
    return path
