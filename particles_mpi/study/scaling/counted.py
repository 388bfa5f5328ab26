"""`study scaling --counts`: what a rank sends and holds in a step, counted on as many ranks as were started.

Counts are the same where ranks share cores, so there may be many more ranks than cores. Each scene grows with the ranks (weak:
PER_RANK particles on each) and is divided among them (strong). Every column should stay flat on a weak curve with many ranks,
and fall on a strong one as the surface of a block of space; those that do not are named. Only steps on a single
rank are timed: with the counts they give the model of many ranks.

How often mode rewind renews its candidates is learned during a run; here it is every SEARCH_INTERVAL steps, so that counts can be
compared. Memory is the largest sum of all arrays of a rank (of tracemalloc; what kernels allocate for themselves is not in it).
"""

import tracemalloc
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from math import inf, log
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from particles_mpi.neighbours.neighbour_list import Neighbourhood
from particles_mpi.output.files import failing_together, make_folder
from particles_mpi.parallel.agreement import raising_together
from particles_mpi.parallel.communicator import KINDS, Communicator
from particles_mpi.run.console import Screen
from particles_mpi.scene.schema import Scene
from particles_mpi.simulation import Simulation
from particles_mpi.study.recommend.runs import variant
from particles_mpi.study.report import grouped, numbers_table, write_csv
from particles_mpi.study.scaling.measure import HEADLINE, counters, divides, found_by, law_of, rank_counts, row_bytes
from particles_mpi.study.scaling.performance_model import Law, Point, fit
from particles_mpi.study.scaling.report import Curve, Result, say_model
from particles_mpi.study.scaling.scale_scene import scale_scene, unable_to_grow

PER_RANK = 2000  # particles; fewer would be blocks of space that are all surface
STRONG_RANKS, QUICK_RANKS = 32, 8  # ranks of the strong curve's scene; ranks at most with --quick
SEARCH_INTERVAL, COUNTED_STEPS = 8, 24  # steps from one search for neighbours to the next, and those that are counted
FLAT_FROM, FLAT_WITHIN = 8, 0.1  # ranks from which on a column is judged, and how much it may change
BYTE_COLUMNS = {f"bytes_{kind}": f"bytes: {kind}" for kind in KINDS}
COLUMNS = {
    "bytes": "bytes sent", **BYTE_COLUMNS, "messages": "messages", "reductions": "reductions", "all_to_alls": "all-to-alls",
    "fetches": "searches", "ghosts": "ghost rows", "memory": "memory, MB", "memory_start": "memory of set-up, MB",
}  # fmt: skip
CAUSES = {
    "bytes_rows": "rows of ghosts or of a tree, and the columns that are sent of each",
    "bytes_counts": "in every exchange each rank sends the number of rows to come to all others: P - 1 numbers",
    "bytes_gathers": "each rank sends its box, or an error, to all others: P - 1 times",
    "bytes_reductions": "each number is sent in log2 P stages",
    "messages": "blocks of bisection have more neighbours than those of a regular grid, or ranks send to all",
    "reductions": "ranks agree more often: among more particles some need more passes, or more time windows",
    "all_to_alls": "more exchanges of all with all",
    "fetches": "all ranks search as soon as one particle has moved too far, which is sooner among more particles",
    "ghosts": "ghosts come from further away",
    "memory": "more than the rows of the rank and of ghosts: room for messages, entries for each rank, or all particles",
    "memory_start": "more than the particles of the rank: entries for each rank, or all particles",
}


def count_scaling(described: Scene | None, folder: Path, quick: bool) -> None:
    """Count, print tables and verdicts, write counts.csv and counts_model.csv. Collective.

    `described`: None for the headline gas, in both modes of collisions. `quick`: on QUICK_RANKS ranks at most.
    """
    world = Communicator()
    screen = Screen(world.is_root, False)
    make_folder(world, folder)
    with raising_together(world):
        scene = described or Scene.load(HEADLINE)
        modes = ("rewind", "event")
        scenes = [described] if described else [variant(scene, {}, {"collisions": {"mode": mode}}) for mode in modes]
    counts = [number for number in rank_counts(world.size) if number <= (QUICK_RANKS if quick else inf)]
    tables: dict[str, list[dict[str, Any]]] = {"counts.csv": [], "counts_model.csv": []}
    for scene in scenes:
        curves, divided = count_scene(scene, world, counts, screen)
        if not world.is_root:
            continue
        law = law_of(scene, curves[0].particles(1), divided)
        for curve in curves:
            tables["counts.csv"] += table_rows(title(scene), curve)
            say_counts(title(scene), curve, law, screen)
        if counts[-1] > 1:
            measured = [point for curve in curves for point in curve.points]
            model = fit(measured, law, row_bytes(scene))
            result = Result(title(scene), law, curves, measured, model, [], False)
            say_model(result, model, screen)
            tables["counts_model.csv"] += [{"scene": title(scene)} | row for row in result.predicted_rows(model)]
    files = {folder / name: rows for name, rows in tables.items() if rows}
    with failing_together(world, f"cannot write into {folder}"):
        world.run_on_root(lambda: [write_csv(path, rows) for path, rows in files.items()])
    screen.say(f"written: {', '.join(map(str, files))}", whole=True)


def title(scene: Scene) -> str:
    """Return the title of the scene, with its mode of collisions."""
    collisions = scene.effects.get("collisions")
    return (scene.title or "untitled scene") + (f", mode {collisions.mode}" if collisions else "")


def count_scene(scene: Scene, world: Communicator, counts: list[int], screen: Screen) -> tuple[list[Curve], bool]:
    """Return the strong curve, and the weak one if the scene can grow; and whether ranks divide space. Collective."""
    own, weak = sum(population.count or 0 for population in scene.particles), not unable_to_grow(scene)
    strong = PER_RANK * min(STRONG_RANKS, counts[-1])
    curves = [[(strong, ranks) for ranks in counts], [(PER_RANK * ranks, ranks) for ranks in counts]][: 1 + weak]
    wanted = list(dict.fromkeys(setting for curve in curves for setting in curve))
    progress = screen.count("counting", len(wanted))
    scaled = lambda particles: scale_scene(scene, particles / own) if weak else scene  # noqa: E731
    pairs = Communicator(world.comm.Split(world.rank // 2))
    run_counted(scaled(PER_RANK * pairs.size), pairs)  # loads modules and kernels, which are not to be counted as memory
    found, divided = {}, True
    for particles, ranks in wanted:
        parts = found_by(world, world.subset(ranks), partial(run_counted, scaled(particles)))
        columns, (first, shared) = [point.counts for point, _ in parts], parts[0]
        mean, most = ({name: float(of([one[name] for one in columns])) for name in columns[0]} for of in (np.mean, np.max))
        found[particles, ranks] = replace(first, counts=mean, oversubscribed=ranks > 1, most=most)
        divided &= ranks == 1 or shared
        progress("counting")
    screen.stop()
    return [Curve(weak, [found[setting] for setting in curve]) for weak, curve in zip((False, True), curves)], divided


def run_counted(scene: Scene, ranks: Communicator) -> tuple[Point, bool]:
    """Return (counts of a step on this rank, its seconds if there is no other; whether ranks divide space). Collective."""
    tracemalloc.start()
    sim = Simulation(scene, comm=ranks.comm)
    if isinstance(sim.near, Neighbourhood):
        tuner: Any = sim.near.tuner
        tuner.next = lambda work, crossing: SEARCH_INTERVAL  # candidates always last so long
    memory_start = tracemalloc.get_traced_memory()[1]
    to_search(sim, 1)
    tracemalloc.reset_peak()
    before, first = counters(sim), sim.steps_done
    to_search(sim, COUNTED_STEPS)
    memory = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    steps, seconds = sim.steps_done - first, 0.0
    columns = {name: (value - before.get(name, 0)) / steps for name, value in counters(sim).items()}
    columns["bytes"] = sum(columns[name] for name in BYTE_COLUMNS)
    columns["ghosts"] = sim.near.ghost_rows / max(sim.near.searches, 1) if sim.near else 0.0
    columns |= {"memory": memory / 1e6, "memory_start": memory_start / 1e6}
    if ranks.size == 1:
        begin = perf_counter()
        to_search(sim, COUNTED_STEPS)
        seconds = (perf_counter() - begin) / (sim.steps_done - first - steps)
    return Point(sim.total, ranks.size, seconds, seconds, seconds, seconds, seconds, 0.0, columns), divides(sim)


def to_search(sim: Simulation, least: int) -> None:
    """Do at least so many steps, up to the end of the next one with a search for neighbours, if there is one soon."""
    searches = -1
    for done in range(least + SEARCH_INTERVAL):
        if done >= least and (sim.near is None or sim.near.searches > searches >= 0):
            break
        searches = sim.near.searches if sim.near else 0
        sim.step()


def verdict(name: str, points: list[Point], law: Law) -> str:
    """Describe how the mean of a column changes from FLAT_FROM ranks on: "flat", or like the geometry, or what is wrong."""
    first, last = points[0], points[-1]
    before, after = first.counts[name], last.counts[name]
    ideal, reason = expected(name, first, last, law)
    if abs(after - before) <= FLAT_WITHIN * before and ideal >= 1.0 - FLAT_WITHIN:
        return "flat"
    grows = f"from {amount(before)} to {amount(after)} on {last.ranks} ranks"
    if reason and after <= (1.0 + FLAT_WITHIN) * ideal * before:
        return f"{grows}: like {reason}"
    power = f", as P^{log(after / before) / log(last.ranks / first.ranks):.2f}" if before and after else ""
    if name == "bytes":  # of all bytes, the kind that grew most
        name = max(BYTE_COLUMNS, key=lambda kind: last.counts[kind] - first.counts[kind])
    return f"NOT FLAT, {grows}{power}: {CAUSES[name]}"


def expected(name: str, first: Point, last: Point, law: Law) -> tuple[float, str]:
    """Return the factor by which a column changes if ranks divide space perfectly, and like what; 1 and "" for no change."""
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
    """Print a line for each column: its mean for every number of ranks, and the largest of a rank; then the verdicts."""
    points = curve.points
    table = numbers_table("a rank and step", *(f"P = {point.ranks}" for point in points), "largest")
    for name, words in COLUMNS.items():
        table.add_row(words, *(amount(point.counts[name]) for point in points), amount(points[-1].most[name]))
    screen.say(f": {curve.name}, counted", head=scene)
    screen.table(table)
    past = [point for point in points if point.ranks >= FLAT_FROM]
    if len(past) < 2:
        screen.say(f"  which columns are flat is judged only from {FLAT_FROM} ranks on")
        return
    verdicts = {words: verdict(name, past, law) for name, words in COLUMNS.items()}
    flat = [words for words, text in verdicts.items() if text == "flat"]
    screen.say(f"  flat from {FLAT_FROM} ranks on: {', '.join(flat) or 'none'}")
    for words, text in verdicts.items():
        if text != "flat":
            screen.say(f"  {words}: {text}")


def amount(value: float) -> str:
    """Return a short text: whole numbers from 100 on, otherwise three digits."""
    return grouped(value) if value >= 100.0 else f"{value:.3g}"


def table_rows(scene: str, curve: Curve) -> Iterator[dict[str, Any]]:
    """Yield the rows of counts.csv: one for each point, with mean and largest of each column."""
    for point in curve.points:
        row = {"scene": scene, "curve": curve.name, "ranks": point.ranks, "particles": point.particles}
        for name in COLUMNS:
            row |= {name: point.counts[name], f"{name}_largest": point.most[name]}
        yield row
