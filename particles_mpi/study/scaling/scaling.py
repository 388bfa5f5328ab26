"""Strong and weak scaling of a scene over rank counts, in one start of mpirun: the first ranks compute, the others sleep.

A setting is the scene with `factor` times its particles on so many ranks. All settings take turns (see `clock`). Mutual
gravity has one phase for what it sends and what it adds up: the model then finds the cost of rows, and none of messages.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from particles_mpi.errors import SceneError, StoppedError
from particles_mpi.initial.populate import fields_of
from particles_mpi.output.files import failing_together
from particles_mpi.parallel.agreement import raising_together
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import FIELDS
from particles_mpi.run.console import Screen
from particles_mpi.scene.schema import Scene
from particles_mpi.simulation import Simulation
from particles_mpi.study.measuring.clock import SAMPLE, SAMPLES, time_in_turns
from particles_mpi.study.scaling.performance_model import Law, Point, fit
from particles_mpi.study.scaling.rank_subset import Crew, divides
from particles_mpi.study.scaling.report import report
from particles_mpi.study.scaling.result import Curve, Result
from particles_mpi.study.scaling.scale_scene import edges, grown

HEADLINE = Path(__file__).parents[2] / "scenes" / "headline.toml"
LARGER = 8  # times the headline: where surfaces matter less
SMALLER, FEWEST = 1 / 8, 250  # on one rank, if so many particles are left: what a step costs apart from particles
TALK = ("agree", "ghosts", "migrate", "exchange")  # phases in which ranks communicate and wait for one another


class Scaling:
    """Measures a scene on the ranks of a communicator. `quick`: short samples, for a look."""

    def __init__(self, scene: Scene, ranks: Communicator, quick: bool):
        self.scene, self.world = scene, ranks
        self.least = 0.02 if quick else SAMPLE
        self.crews = {count: ranks.subset(count) for count in rank_counts(ranks.size)}
        self.homes = ranks.allgather((platform.node(), os.sched_getaffinity(0)))

    def oversubscribed(self, count: int) -> bool:
        """Have the first `count` ranks fewer cores than they are, on some machine?"""
        for node in {name for name, _ in self.homes[:count]}:
            ranks = [cores for name, cores in self.homes[:count] if name == node]
            if len(ranks) > len(set().union(*ranks)):
                return True
        return False

    def measure(self, settings: Iterable[tuple[float, int]], screen: Screen) -> dict[tuple[float, int], Point]:
        """The points of the settings (factor, ranks), all timed by turns. Collective."""
        crews = {
            (factor, count): self.crew(self.scene if factor == 1 else grown(self.scene, factor), self.crews[count])
            for factor, count in settings
        }
        told = screen.count("scaling", len(crews) * (1 + SAMPLES))
        time_in_turns(list(crews.values()), SAMPLES, self.least, lambda: told("scaling: time"))
        screen.stop()
        parts = [crew.sim for (_, count), crew in crews.items() if crew.sim and count > 1]
        self.divided = not parts or any(divides(sim) for sim in parts)
        return {setting: self.point(crew, setting[1]) for setting, crew in crews.items()}

    def crew(self, scene: Scene, ranks: Communicator | None) -> Crew:
        """Who times the scene; `ranks`: None where others do."""
        return Crew(
            ranks or self.world,
            lambda: Simulation(scene, comm=ranks.comm if ranks else None),
            max(scene.steps, 1),
            world=self.world,
            inside=ranks is not None,
        )

    def point(self, crew: Crew, count: int) -> Point:
        """What the crew's ranks found, put together. Collective."""
        mine = (crew.a_step(), crew.sim.total) if crew.sim else None
        found = [told for told in self.world.allgather(mine) if told]
        steps = [step for step, _ in found]
        names = [name for name in steps[0] if name.startswith("phase ")]
        phases = {name.removeprefix("phase "): float(np.mean([step[name] for step in steps])) for name in names}
        talk = [sum(step.get(f"phase {name}", 0.0) for name in TALK if count > 1) for step in steps]
        own = [sum(step[name] for name in names) - waited for step, waited in zip(steps, talk, strict=True)]
        seconds = crew.seconds
        other = max(0.0, seconds.median - sum(phases.values()))  # between the phases
        counts = {name: float(np.mean([step[name] for step in steps])) for name in steps[0] if name not in names}
        return Point(
            found[0][1], count, seconds.median, seconds.low, seconds.high,
            own=float(np.mean(own)) + other, slowest=max(own) + other, talk=min(talk),
            counts=counts, phases=phases | {"other": other}, oversubscribed=self.oversubscribed(count),
        )  # fmt: skip

    def law(self, total: int) -> Law:
        """How work and traffic of the scene grow; it has `total` particles."""
        scene, growth, everyone = self.scene, "N", not self.divided
        if "mutual_gravity" in scene.effects:
            tree = scene.effects["mutual_gravity"].choice(scene, total).angle is not None
            growth, everyone = ("N log N", False) if tree else ("N^2", True)
        return Law(growth, edges(scene), tuple(scene.periodic), everyone, self.divided)

    def row_bytes(self) -> int:
        """Of a ghost, as it is sent."""
        return sum(
            8 * (self.scene.dimension if FIELDS[name].vector else 1) for name in fields_of(self.scene) if FIELDS[name].ghost
        )


def rank_counts(size: int) -> list[int]:
    """1, 2, 4 ... and all."""
    counts = [1 << k for k in range(size.bit_length())]
    return sorted({*counts, size})


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
    points = scaling.measure(settings(scaling.scene, list(scaling.crews), sizes, not no_weak), screen)
    total = points[1.0, 1].particles
    curves = []
    for size in sizes:
        strong = [points[size, count] for count in scaling.crews]
        curves.append(Curve(f"strong, N = {strong[0].particles}", False, strong))
    if not no_weak:
        curves.append(Curve(f"weak, N/P = {total}", True, [points[float(count), count] for count in scaling.crews]))
    law, found = scaling.law(total), list(points.values())
    model = fit(found, law, scaling.row_bytes()) if ranks.size > 1 else None
    result = Result(scaling.scene.title, law, curves, found, model, no_weak, scene is None)
    ranks.run_on_root(lambda: write_report(result, folder, screen))


def write_report(result: Result, folder: Path, screen: Screen) -> None:
    """On one rank, while the others sleep."""
    try:
        report(result, folder, screen)
    except OSError as error:
        raise StoppedError(f"cannot write into {folder}: {error.strerror}") from None


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
        grown(scene, 1.0)
    except SceneError as error:
        return error.faults
    return []
