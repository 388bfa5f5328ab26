"""What `study scaling` found, on the screen and in files."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

from rich.table import Table

from particles_mpi.output.files import replacing
from particles_mpi.run.console import Screen
from particles_mpi.study.scaling.performance_model import Point
from particles_mpi.study.scaling.plots import draw
from particles_mpi.study.scaling.result import Curve, Result


def report(result: Result, folder: Path, screen: Screen) -> None:
    """All of it; on one rank."""
    for curve in result.curves:
        screen.say(f"[bold]{result.title or 'untitled scene'}[/bold]: {curve.name}")
        screen.say(measured_table(result, curve))
        screen.say(phases_table(curve))
    if result.no_weak:
        screen.say(f"no weak scaling: {'; '.join(result.no_weak)}")
    files = [folder / "scaling.csv", folder / "scaling.png", folder / "scaling.svg"]
    write_measured(result, files[0])
    if result.model:
        say_model(result, screen)
        files.insert(1, folder / "scaling_model.csv")
        write_model(result, files[1])
    else:
        screen.say("no model: on one rank nothing is sent; mpirun -n P measures up to P ranks")
    figure = draw(result)
    for path in files[-2:]:
        figure.savefig(path)
    screen.say(f"written: {', '.join(map(str, files))}")


def right(*columns: str) -> Table:
    """A table of numbers."""
    table = Table(box=None, padding=(0, 2, 0, 0))
    for column in columns:
        table.add_column(column, justify="right")
    return table


def name_of(point: Point) -> str:
    return f"{point.ranks}{', oversubscribed' * point.oversubscribed}"


def measured_table(result: Result, curve: Curve) -> Table:
    """A line a rank count; counts are those of a step and a rank."""
    table = right("ranks", "ms a step", "quartiles", "speed-up", "efficiency", "ghosts", "messages", "reductions")
    for p in curve.points:
        efficiency = result.efficiency(curve, p)
        milliseconds = f"{p.seconds * 1e3:.3g}", f"{p.low * 1e3:.3g} to {p.high * 1e3:.3g}"
        counts = [f"{p.counts[name]:.3g}" for name in ("ghost_rows", "messages", "reductions")]
        table.add_row(name_of(p), *milliseconds, f"{efficiency * p.ranks:.2f}", f"{efficiency:.0%}", *counts)
    return table


def phases_table(curve: Curve) -> Table:
    """Shares of the step, the longest phases of the curve first."""
    shares = [{name: s / sum(p.phases.values()) for name, s in p.phases.items()} for p in curve.points]
    total = {name: sum(share.get(name, 0.0) for share in shares) for share in shares for name in share}
    names = sorted(total, key=lambda name: -total[name])[:SHOWN]
    table = right("ranks", *names, "the rest")
    for p, share in zip(curve.points, shares, strict=True):
        told = [share.get(name, 0.0) for name in names]
        table.add_row(name_of(p), *(f"{x:.0%}" for x in [*told, abs(1.0 - sum(told))]))
    return table


def say_model(result: Result, screen: Screen) -> None:
    """What the model says, from what, and what it takes for granted."""
    model = result.model
    assert model
    screen.say(f"[bold]{result.origin}[/bold]")
    traffic = model.traffic
    screen.say(
        f"  t = {model.fixed * 1e6:.3g} us + {model.imbalance:.2f} x {model.each * 1e9:.3g} ns x work{'/P' * model.law.shared}"
        f" + {model.row * 1e6:.3g} us x rows + {model.latency * 1e6:.3g} us x stages; work = {model.law.growth}"
    )
    layer = "all particles" if model.law.everyone else f"a layer of {traffic.thickness:.2g} mean distances"
    fetched = f"rows of {layer} fetched {traffic.fetches:.2g} times" if traffic.thickness else "no rows fetched"
    screen.say(
        f"  counted in a step: {fetched}, {traffic.messages:.2g} messages to"
        f" each neighbour, {traffic.reductions:.2g} reductions, {traffic.all_to_alls:.2g} exchanges of all with all"
    )
    table = right("ranks", *(curve.name for curve in result.curves))
    rows: dict[int, list[str]] = {}
    for _, ranks, parts, efficiency in result.predictions():
        seconds = sum(parts.values())
        working = parts["work"] / seconds
        rows.setdefault(ranks, []).append(f"{seconds * 1e3:.3g} ms, {efficiency:.0%}, {working:.0%}")
    for ranks, cells in rows.items():
        table.add_row(str(ranks), *cells)
    screen.say("  ms a step, efficiency, share of work in the step:")
    screen.say(table)
    fitted = [p for p in result.points if not p.oversubscribed]
    told = ", ".join(f"N = {p.particles} on {p.ranks}: {model.residual(p):+.0%}" for p in fitted)
    screen.say(f"  error of the model where it was fitted: {told}")
    for line in model.assumptions:
        screen.say(f"  assumed: {line}")


def write_measured(result: Result, path: Path) -> None:
    """scaling.csv: a row for each point of each curve; seconds and counts of a step, counts of a rank."""
    header = [
        "curve",
        "ranks",
        "particles",
        "oversubscribed",
        "seconds_per_step",
        "quartile_1",
        "quartile_3",
        "speedup",
        "efficiency",
    ]
    phases = list(dict.fromkeys(name for p in result.points for name in p.phases))
    rows = []
    for curve in result.curves:
        for p in curve.points:
            efficiency = result.efficiency(curve, p)
            row: list[Any] = [curve.name, p.ranks, p.particles, int(p.oversubscribed), p.seconds, p.low, p.high]
            row += [efficiency * p.ranks, efficiency, *(p.counts[name] for name in COUNTS)]
            rows.append(row + [p.phases.get(name, 0.0) for name in phases])
    write(path, [*header, *COUNTS, *(f"seconds_{name}" for name in phases)], rows)


def write_model(result: Result, path: Path) -> None:
    """scaling_model.csv: predictions, not measurements; seconds of a step by terms."""
    rows = [[curve.name, n, curve.particles(n), "model", sum(parts.values()), efficiency, *parts.values()]
            for curve, n, parts, efficiency in result.predictions()]  # fmt: skip
    names = ["fixed", "work", "rows", "latency"]
    write(path, ["curve", "ranks", "particles", "kind", "seconds_per_step", "efficiency", *(f"seconds_{n}" for n in names)], rows)


def write(path: Path, header: list[str], rows: list[list[Any]]) -> None:
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([header, *rows])


SHOWN = 7  # phases of a table


COUNTS = ("fetches", "rows", "ghost_rows", "messages", "reductions", "all_to_alls")
