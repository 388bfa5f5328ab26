"""`study accuracy`: measures the experiments, prints them as they end, writes the report."""

from collections.abc import Callable, Iterator
from pathlib import Path
from time import perf_counter

from particles_mpi.errors import SceneError
from particles_mpi.output.files import failing_together, make_folder
from particles_mpi.scene.schema import Scene
from particles_mpi.study import report
from particles_mpi.study.accuracy import effects, fluid, losses, orbits, resting, rough, scene_accuracy, softening, tree
from particles_mpi.study.experiment import Benchmark, Experiment

# Of each letter: are bodies so few that one rank does, and what measures its experiments?
EXPERIMENTS: dict[str, tuple[bool, tuple[Callable[[Benchmark], list[Experiment]], ...]]] = {
    "A": (True, (orbits.regular_orbits,)),
    "B": (True, (orbits.close_encounters,)),
    "C": (False, (fluid.experiments,)),
    "D": (False, (tree.experiments,)),
    "F": (True, (softening.kepler, softening.plummer)),
    "G": (True, (losses.throws, losses.bouncing)),
    "H": (False, (effects.experiments,)),
    "I": (False, (resting.experiments,)),
    "J": (False, (rough.rolling, rough.creeping)),
}


def measure_letter(key: str, benchmark: Benchmark) -> list[Experiment]:
    """Measure the experiments of one letter. Collective; those with few bodies are returned on rank 0 only, [] elsewhere."""
    few_bodies, parts = EXPERIMENTS[key]
    return benchmark.on_few(few_bodies, lambda few: [found for part in parts for found in part(few)]) or []


def built_in(keys: str, benchmark: Benchmark) -> Iterator[Experiment]:
    """Yield the experiments of these letters. Collective."""
    for key in (key for key in EXPERIMENTS if key in keys):
        since = perf_counter()
        yield from measure_letter(key, benchmark)
        benchmark.screen.say(f"  ({key} took {perf_counter() - since:.0f} s)")


def study_accuracy(scene: Scene | None, keys: str, quick: bool, folder: Path) -> None:
    """Run the built-in experiments of the letters `keys` (all if empty), or those of a scene. Collective."""
    begin, keys = perf_counter(), keys.upper() or "".join(EXPERIMENTS)
    if unknown := [key for key in keys if key not in EXPERIMENTS]:
        raise SceneError(f"--only: there is no experiment {', '.join(unknown)}; there are {', '.join(EXPERIMENTS)}")
    benchmark = Benchmark(quick=quick, quiet=False)
    ranks, screen = benchmark.ranks, benchmark.screen
    make_folder(ranks, folder)
    title = f"What accuracy costs: {scene.title or 'a scene'}" if scene else "What accuracy costs"
    found = []
    for one in scene_accuracy.experiments(benchmark, scene) if scene else built_in(keys, benchmark):
        screen.say(f"   (reference: {one.reference})", head=f"\n{one.key}: {one.title}")
        screen.table(report.errors_table(one))
        for answer in one.answers:
            screen.say(f"  {answer}")
        found.append(one)
    seconds = perf_counter() - begin
    with failing_together(ranks, f"cannot write into {folder}"):
        if ranks.is_root:
            timing = {"samples": benchmark.samples, "least_seconds": benchmark.sample_seconds, "seconds": seconds}
            path = report.write_report(folder, title, found, report.describe_machine(ranks) | timing)
            if (costs := report.tenfold_table(found)).row_count:
                screen.table(costs)
            else:
                screen.say(f"{report.TENFOLD} is not known: along no curve do the errors fall far enough")
            screen.say(f"{seconds:.0f} s; the whole report, with pictures: {path}   (CSV: {folder}/*.csv)", whole=True)
