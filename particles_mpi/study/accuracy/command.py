"""`study accuracy`: measures the experiments, prints them as they end, writes the report."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

from particles_mpi.errors import SceneError
from particles_mpi.output.files import failing_together
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.run.console import Screen
from particles_mpi.scene.schema import Scene
from particles_mpi.study.experiment import Benchmark, Experiment

NOTES = ["E, float32 against float64: nothing here is offered in float32, so there is nothing to compare."]


class Chapter(NamedTuple):
    """`module` of this folder whose `measure` gives the experiments; a few bodies are computed on rank 0 alone."""

    module: str
    measure: str = "measure"
    few_bodies: bool = False


CHAPTERS = {
    "A": Chapter("orbits", "regular_orbits", True),
    "B": Chapter("orbits", "close_encounters", True),
    "C": Chapter("fluid"),
    "D": Chapter("tree"),
    "F": Chapter("softening", few_bodies=True),
    "G": Chapter("losses", few_bodies=True),
    "H": Chapter("effects"),
}


def experiments(key: str, benchmark: Benchmark) -> list[Experiment]:
    """Measure the experiments of one letter. Collective; those of a few bodies are known to rank 0 only, others get none."""
    chapter = CHAPTERS[key]
    measure: Callable[[Benchmark], list[Experiment]] = getattr(
        import_module(f"particles_mpi.study.accuracy.{chapter.module}"), chapter.measure
    )
    return benchmark.on_few(chapter.few_bodies, measure) or []


def accuracy(scene: Scene | None, keys: str, quick: bool, folder: Path, comm: Any = None) -> list[Experiment]:
    """The built-in experiments of the letters `keys` (all if empty), or those of a scene. Collective."""
    ranks = Communicator(comm)
    screen = Screen(ranks.is_root, False)
    benchmark = Benchmark(comm, quick, screen=screen)
    begin, found, notes = perf_counter(), [], []
    with failing_together(ranks, f"cannot write into {folder}"):
        if ranks.is_root:
            folder.mkdir(parents=True, exist_ok=True)
    if scene is not None:
        from particles_mpi.study.accuracy.scene_accuracy import measure

        title = f"What accuracy costs: {scene.title or 'a scene'}"
        found = measure(benchmark, scene)
        for one in found:
            show(screen, one)
    else:
        title, notes = "What accuracy costs", NOTES
        unknown = [key for key in keys.upper() if key not in CHAPTERS]
        if unknown:
            raise SceneError(f"--only: there is no experiment {', '.join(unknown)}; there are {', '.join(CHAPTERS)}")
        for key in (key for key in CHAPTERS if not keys or key in keys.upper()):
            since = perf_counter()
            for one in experiments(key, benchmark):
                show(screen, one)
                found.append(one)
            screen.say(f"  ({key} took {perf_counter() - since:.0f} s)")
    seconds = perf_counter() - begin
    with failing_together(ranks, f"cannot write into {folder}"):
        if ranks.is_root:
            from particles_mpi.study import report

            timing = {"samples": benchmark.samples, "least_seconds": benchmark.least, "seconds": seconds}
            path = report.write(folder, title, found, report.machine(ranks) | timing, notes)
            screen.table(report.tenfold_table(found))
            screen.say(f"{seconds:.0f} s; all of it, with pictures: {path}   (CSV: {folder}/*.csv)")
    return found


def show(screen: Screen, found: Experiment) -> None:
    """Print an experiment."""
    from particles_mpi.study.report import table

    screen.say(f"\n[bold]{found.key}: {found.title}[/bold]   (reference: {found.reference})")
    screen.table(table(found))
    for answer in found.answers:
        screen.say(f"  {answer}")
