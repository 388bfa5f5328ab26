"""`study accuracy`: measures, tells on the screen, writes the report."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import Any

from rich.table import Table

from particles_mpi.errors import SceneError
from particles_mpi.output.files import failing_together
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.run.console import Screen
from particles_mpi.scene.schema import Scene
from particles_mpi.study.accuracy import CHAPTERS, experiments
from particles_mpi.study.measuring.experiment import Experiment, Lab
from particles_mpi.study.reporting import tables

NOTES = ["E, float32 against float64: nothing here is offered in float32, so there is nothing to compare."]


def accuracy(scene: Scene | None, keys: str, quick: bool, folder: Path, comm: Any = None) -> list[Experiment]:
    """The built-in experiments of the letters `keys` (all if empty), or those of a scene. Collective."""
    ranks = Communicator(comm)
    lab = Lab(comm, quick, screen=Screen(ranks.is_root, False))
    begin, found, notes = perf_counter(), [], []
    with failing_together(ranks, f"cannot write into {folder}"):
        if ranks.is_root:
            folder.mkdir(parents=True, exist_ok=True)
    if scene is not None:
        from particles_mpi.study.accuracy.scene_accuracy import measure as of_scene

        title = f"What accuracy costs: {scene.title or 'a scene'}"
        for one in of_scene(lab, scene):
            found.append(tell(lab.screen, one))
    else:
        title, notes = "What accuracy costs", NOTES
        unknown = [key for key in keys.upper() if key not in CHAPTERS]
        if unknown:
            raise SceneError(f"--only: there is no experiment {', '.join(unknown)}; there are {', '.join(CHAPTERS)}")
        for key, measure in experiments(keys).items():
            since = perf_counter()
            found += [tell(lab.screen, one) for one in measure(lab)]
            lab.screen.say(f"  ({key} took {perf_counter() - since:.0f} s)")
    seconds = perf_counter() - begin
    with failing_together(ranks, f"cannot write into {folder}"):
        if ranks.is_root:
            from particles_mpi.study.reporting import report

            about = {**report.machine(ranks), "samples": lab.samples, "least_seconds": lab.least, "seconds": seconds}
            path = report.write(folder, title, found, about, notes)
            lab.screen.table(ten_times(found))
            lab.screen.say(f"{seconds:.0f} s; all of it, with pictures: {path}   (CSV: {folder}/*.csv)")
    return found


def tell(screen: Screen, found: Experiment) -> Experiment:
    """An experiment on the screen."""
    table = Table(*tables.header(found), box=None, padding=(0, 2, 0, 0))
    for column in table.columns:
        column.no_wrap = True
        column.justify = "right" if column is not table.columns[0] else "left"
    front = found.front()
    for row, texts in tables.cells(found):
        table.add_row(*texts, style="bold" if row in front else None)
    screen.say(f"\n[bold]{found.key}: {found.title}[/bold]   (reference: {found.reference})")
    screen.table(table)
    for answer in found.answers:
        screen.say(f"  {answer}")
    return found


def ten_times(found: list[Experiment]) -> Table:
    """What ten times more accuracy costs."""
    table = Table("problem", "setting", "a tenth of the error in", "time", title="what ten times more accuracy costs", box=None)
    for title, curve, error, factor in tables.tenfolds(found):
        table.add_row(title, curve, error, f"x {factor:.2g}")
    return table
