"""`study scaling`: strong and weak scaling of a scene over rank counts, in one start of mpirun.

A setting is the scene with `factor` times its particles on so many of the ranks; the others sleep meanwhile.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from particles_mpi.errors import SceneError
from particles_mpi.output.files import failing_together
from particles_mpi.parallel.agreement import raising_together
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.run.console import Screen
from particles_mpi.scene.schema import Scene
from particles_mpi.study.scaling.measure import Scaling
from particles_mpi.study.scaling.performance_model import fit
from particles_mpi.study.scaling.report import Curve, Result, report
from particles_mpi.study.scaling.scale_scene import scale_scene

HEADLINE = Path(__file__).parents[2] / "scenes" / "headline.toml"
LARGER = 8  # times the headline: where surfaces matter less
SMALLER, FEWEST = 1 / 8, 250  # on one rank, if so many particles are left: what a step costs apart from particles


def scale(scene: Scene | None, folder: Path, quick: bool, comm: Any = None) -> None:
    """Measure, print the tables and the model, write scaling.csv, scaling_model.csv, scaling.png and scaling.svg. Collective.

    `scene`: None for the headline gas, and one LARGER times as large. `quick`: short samples, and that one is left out.
    """
    ranks = Communicator(comm)
    screen = Screen(ranks.is_root, False)
    with failing_together(ranks, f"cannot write into {folder}"):
        if ranks.is_root:
            folder.mkdir(parents=True, exist_ok=True)
    with raising_together(ranks):
        scene_or_headline = scene or Scene.load(HEADLINE)
    scaling = Scaling(scene_or_headline, ranks, quick)
    no_weak = unable_to_grow(scaling.scene)
    sizes = [1.0] if scene or quick else [1.0, float(LARGER)]
    points = scaling.measure(settings(scaling.scene, list(scaling.subsets), sizes, not no_weak), screen)
    total = points[1.0, 1].particles
    curves = []
    for size in sizes:
        strong = [points[size, count] for count in scaling.subsets]
        curves.append(Curve(f"strong, N = {strong[0].particles}", False, strong))
    if not no_weak:
        curves.append(Curve(f"weak, N/P = {total}", True, [points[float(count), count] for count in scaling.subsets]))
    law, found = scaling.law(total), list(points.values())
    model = fit(found, law, scaling.row_bytes()) if ranks.size > 1 else None
    result = Result(scaling.scene.title, law, curves, found, model, no_weak, scene is None)
    with failing_together(ranks, f"cannot write into {folder}"):
        ranks.run_on_root(lambda: write(result, folder, screen))


def write(result: Result, folder: Path, screen: Screen) -> None:
    """Print the tables, write tables and figure; on one rank, while the others sleep."""
    from particles_mpi.study.scaling.plots import draw

    files, figure = report(result, folder, screen), draw(result)
    for path in (folder / "scaling.png", folder / "scaling.svg"):
        figure.savefig(path)
        files.append(path)
    screen.say(f"written: {', '.join(map(str, files))}")


def settings(scene: Scene, counts: list[int], sizes: list[float], weak: bool) -> list[tuple[float, int]]:
    """What to measure, as (factor, ranks); with `weak` also what weak scaling needs, and a smaller scene for the model."""
    wanted = [(size, count) for size in sizes for count in counts]
    if weak:
        wanted += [(float(count), count) for count in counts]
        if sum(p.count or 0 for p in scene.particles) * SMALLER >= FEWEST:
            wanted.append((SMALLER, 1))
    return list(dict.fromkeys(wanted))


def unable_to_grow(scene: Scene) -> list[str]:
    """Why the scene has no weak scaling; nothing if it has."""
    try:
        scale_scene(scene, 1.0)
    except SceneError as error:
        return error.faults
    return []
