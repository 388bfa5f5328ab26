"""What `study scaling --counts` found: which columns stay flat as ranks grow, as lines on the screen and rows of CSV files."""

from collections.abc import Iterator
from math import log
from typing import Any

from particles_mpi.parallel.communicator import KINDS
from particles_mpi.run.console import Screen
from particles_mpi.study.report import grouped, numbers_table
from particles_mpi.study.scaling.performance_model import Law, Point
from particles_mpi.study.scaling.report import Curve

FLAT_FROM, FLAT_WITHIN = 8, 0.1  # ranks from which on a column is judged, and how much it may change
BYTE_COLUMNS = {f"bytes_{kind}": f"bytes: {kind}" for kind in KINDS}
COLUMNS = {
    "bytes": "bytes sent", **BYTE_COLUMNS, "messages": "messages", "reductions": "reductions", "all_to_alls": "all-to-alls",
    "fetches": "searches", "ghosts": "ghost rows", "memory": "memory, MB", "memory_start": "memory of set-up, MB",
}  # fmt: skip
CAUSES = {
    "bytes_rows": "rows of ghosts or of a tree, and what is sent of each",
    "bytes_counts": "in every exchange each rank tells all others how many rows come: P - 1 numbers",
    "bytes_gathers": "each rank sends its box, or what went wrong, to all others: P - 1 times",
    "bytes_reductions": "each number is sent in log2 P stages",
    "messages": "blocks of bisection have more neighbours than those of a regular grid, or ranks send to all",
    "reductions": "ranks agree more often: of more particles some need more passes, or more windows of time",
    "all_to_alls": "more exchanges of all with all",
    "fetches": "all search when one of more particles has gone too far",
    "ghosts": "ghosts come from further away",
    "memory": "more than the rows of the rank and of ghosts: room for messages, entries for each rank, or all particles",
    "memory_start": "more than the particles of the rank: entries for each rank, or all particles",
}


def verdict(name: str, points: list[Point], law: Law) -> str:
    """How the mean of a column changes past FLAT_FROM ranks: "flat", or as geometry makes it, or what is wrong with it."""
    first, last = points[0], points[-1]
    before, after = first.counts[name], last.counts[name]
    ideal, reason = expected(name, first, last, law)
    if abs(after - before) <= FLAT_WITHIN * before and ideal >= 1.0 - FLAT_WITHIN:
        return "flat"
    grows = f"from {amount(before)} to {amount(after)} on {last.ranks} ranks"
    if reason and after <= (1.0 + FLAT_WITHIN) * ideal * before:
        return f"{grows}: as {reason}"
    power = f", as P^{log(after / before) / log(last.ranks / first.ranks):.2f}" if before and after else ""
    if name == "bytes":  # of all bytes, the kind that grew most
        name = max(BYTE_COLUMNS, key=lambda kind: last.counts[kind] - first.counts[kind])
    return f"NOT FLAT, {grows}{power}: {CAUSES[name]}"


def expected(name: str, first: Point, last: Point, law: Law) -> tuple[float, str]:
    """By which factor a column changes where ranks divide space perfectly, and as what; 1 and "" for what should not change."""
    if name in ("bytes", "bytes_rows", "ghosts"):
        layer = law.thickness(first.particles, first.ranks, first.counts["ghosts"])
        if layer > (first.particles / first.ranks) ** (1.0 / len(law.edges)):  # thicker than the block
            return 1.0, ""
        rows = [law.rows(point.particles, point.ranks, layer) for point in (first, last)]
        return (rows[1] / rows[0] if rows[0] else 0.0), "the surfaces that a block has in common with others"
    if name == "messages":
        return law.neighbours(last.ranks) / law.neighbours(first.ranks), "the number of neighbours of a block"
    if name.startswith("memory"):
        rows = [p.particles / p.ranks + (p.counts["ghosts"] if name == "memory" else 0.0) for p in (first, last)]
        return rows[1] / rows[0], "the rows of a rank and its ghosts" if name == "memory" else "the particles of a rank"
    return 1.0, ""


def say_counts(scene: str, curve: Curve, law: Law, screen: Screen) -> None:
    """A line for each column: its mean over the ranks for every number of ranks, and the largest of a rank; then the verdicts."""
    points = curve.points
    table = numbers_table("a rank and step", *(f"P = {point.ranks}" for point in points), "largest")
    for name, words in COLUMNS.items():
        table.add_row(words, *(amount(point.counts[name]) for point in points), amount(points[-1].most[name]))
    screen.say(f": {curve.name}, counted", head=scene)
    screen.table(table)
    past = [point for point in points if point.ranks >= FLAT_FROM]
    if len(past) < 2:
        screen.say(f"  which columns are flat, is judged past {FLAT_FROM} ranks")
        return
    verdicts = {words: verdict(name, past, law) for name, words in COLUMNS.items()}
    flat = [words for words, text in verdicts.items() if text == "flat"]
    screen.say(f"  flat past {FLAT_FROM} ranks: {', '.join(flat) or 'none'}")
    for words, text in verdicts.items():
        if text != "flat":
            screen.say(f"  {words}: {text}")


def amount(value: float) -> str:
    """A short text: whole numbers from 100 on, else three digits."""
    return grouped(value) if value >= 100.0 else f"{value:.3g}"


def table_rows(scene: str, curve: Curve) -> Iterator[dict[str, Any]]:
    """Of counts.csv: a row for each point, mean and largest of each column."""
    for point in curve.points:
        row = {"scene": scene, "curve": curve.name, "ranks": point.ranks, "particles": point.particles}
        for name in COLUMNS:
            row |= {name: point.counts[name], f"{name}_largest": point.most[name]}
        yield row
