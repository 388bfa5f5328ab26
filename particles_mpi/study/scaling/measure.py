"""`study scaling`: strong and weak scaling of a scene over rank counts, in one start of mpirun.

A setting is the scene with `factor` times its particles on so many of the ranks; the others sleep meanwhile. All settings are
timed by turns, and phases and counts are noted. Mutual gravity has one phase for what it sends and what it adds up: the model
then finds the cost of rows, and none of messages.
"""

import os
import platform
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from particles_mpi.errors import SceneError, StoppedError
from particles_mpi.output.files import failing_together, make_folder
from particles_mpi.parallel.agreement import await_all, raising_together
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import FIELDS, components
from particles_mpi.run.console import Screen
from particles_mpi.scene.active import fields_of
from particles_mpi.scene.schema import Scene
from particles_mpi.simulation import Simulation
from particles_mpi.study.report import write_csv
from particles_mpi.study.scaling.figure import draw
from particles_mpi.study.scaling.performance_model import Law, Point, fit
from particles_mpi.study.scaling.report import Curve, Result, say_curve, say_model
from particles_mpi.study.scaling.scale_scene import edges, scale_scene, unable_to_grow
from particles_mpi.study.timing import QUICK_SAMPLE_SECONDS, SAMPLE_SECONDS, SAMPLES, StepTimer, time_in_turns

HEADLINE = Path(__file__).parents[2] / "scenes" / "headline.toml"
LARGER_FACTOR = 8.0  # times the headline: where surfaces matter less
SMALLER_FACTOR, LEAST_PARTICLES = 1 / 8, 250  # on one rank, if so many particles are left: what a step costs apart from particles
COMMUNICATING = ("agree", "ghosts", "migrate", "exchange")  # phases in which ranks communicate and wait for one another
PHASE_PREFIX = "phase "  # begins the name of what a phase takes


@dataclass
class RankSubsetTimer(StepTimer):
    """Times the steps of one setting on the first ranks of `world`, and notes phases and counts.

    `subset`: these ranks, None on the others. `sums`: seconds and counts on this rank over all samples, by name.
    """

    world: Communicator = field(kw_only=True)
    subset: Communicator | None = field(kw_only=True)
    sums: dict[str, float] = field(default_factory=dict)

    def sample(self, sample_seconds: float) -> float:
        """Return the seconds of a step, on all ranks of the world. Collective there."""
        if not self.samples:
            self.sums.clear()  # those of the warm-up
        sample = super().sample
        return max(found_by(self.world, self.subset, lambda subset: sample(sample_seconds)))

    def clock(self, sim: Simulation, steps: int) -> float:
        """Time steps as the base class does, and add phases and counts to the sums."""
        before = counters(sim)
        seconds = super().clock(sim, steps)
        for name, value in (counters(sim) | {"steps": steps, "clocked": seconds}).items():
            self.sums[name] = self.sums.get(name, 0) + value - before.get(name, 0)
        return seconds

    def a_step(self) -> dict[str, float]:
        """Return the seconds of each phase and the counts of one step on this rank, by name.

        Phases come in lumps: each gets the share of the median step that it has of all samples together.
        """
        phase, step = self.seconds.median / self.sums["clocked"], 1.0 / self.sums["steps"]
        return {name: whole * (phase if name.startswith(PHASE_PREFIX) else step) for name, whole in self.sums.items()}

    def point(self, oversubscribed: bool) -> Point:
        """Return the results of all ranks together. Collective in the world."""
        found = [part for part in self.world.allgather((self.a_step(), self.sim.total) if self.sim else None) if part]
        steps, count = [step for step, _ in found], len(found)
        names = [name for name in steps[0] if name.startswith(PHASE_PREFIX)]
        mean = {name: float(np.mean([step[name] for step in steps])) for name in steps[0]}
        talk = [sum(step.get(f"{PHASE_PREFIX}{name}", 0.0) for name in COMMUNICATING if count > 1) for step in steps]
        own = [sum(step[name] for name in names) - waited for step, waited in zip(steps, talk, strict=True)]
        seconds = self.seconds
        phases = {name.removeprefix(PHASE_PREFIX): mean.pop(name) for name in names}
        other = max(0.0, seconds.median - sum(phases.values()))  # between the phases
        return Point(
            found[0][1], count, seconds.median, seconds.low, seconds.high,
            own=float(np.mean(own)) + other, slowest=max(own) + other, talk=min(talk),
            counts=mean, phases=phases | {"other": other}, oversubscribed=oversubscribed,
        )  # fmt: skip


def found_by(world: Communicator, subset: Communicator | None, work: Callable[[Communicator], Any]) -> list[Any]:
    """Return `work(subset)` of each rank of a subset, while the others (None) sleep; an error is raised on all. Collective."""
    value, error = None, None
    if subset:
        try:
            value = work(subset)
        except (SceneError, StoppedError) as raised:
            await_all(subset, raised)
            error = raised
    world.sleeping_barrier()
    found = world.allgather((subset is not None, value, error))
    for _, _, failed in found:
        if failed:
            raise failed
    return [one for inside, one, _ in found if inside]


def divides(sim: Simulation) -> bool:
    """Does each rank compute its part of space? Mode event puts all particles on every rank if that is no more work."""
    return sim.near is None or bool(sim.near.divided)


def counters(sim: Simulation) -> dict[str, float]:
    """Return all counters of a simulation, of this rank."""
    ranks, near = sim.ranks, sim.near
    searching = near and divides(sim) and "mutual_gravity" not in sim.forces
    counted = {name: getattr(ranks, name) for name in ("rows", "messages", "reductions", "all_to_alls")}
    counted |= {f"bytes_{kind}": sent for kind, sent in ranks.bytes.items()}
    counted |= {"fetches": near.searches if searching else sim.steps_done, "ghost_rows": near.ghost_rows if near else 0}
    return counted | {f"{PHASE_PREFIX}{name}": seconds for name, seconds in sim.timers.seconds.items()}


def rank_counts(size: int) -> list[int]:
    """Return 1, 2, 4 ... and the number of all ranks."""
    return sorted({*(1 << k for k in range(size.bit_length())), size})


def settings(scene: Scene, counts: list[int], sizes: list[float], weak: bool) -> list[tuple[float, int]]:
    """Return what to measure, as (factor, ranks); with `weak` also for weak scaling, and a smaller scene for the model."""
    wanted = [(size, count) for size in sizes for count in counts]
    if weak:
        wanted += [(float(count), count) for count in counts]
        if sum(p.count or 0 for p in scene.particles) * SMALLER_FACTOR >= LEAST_PARTICLES:
            wanted.append((SMALLER_FACTOR, 1))
    return list(dict.fromkeys(wanted))


def time_settings(
    scene: Scene, world: Communicator, wanted: Iterable[tuple[float, int]], sample_seconds: float, screen: Screen
) -> tuple[dict[tuple[float, int], Point], bool]:
    """Return the points of the settings (factor, ranks), and whether ranks divide space. Collective."""
    subsets = {count: world.subset(count) for count in rank_counts(world.size)}
    timers = {}
    for factor, count in wanted:
        subset, scaled = subsets[count], scene if factor == 1 else scale_scene(scene, factor)
        ranks = subset or world  # ranks outside begin nothing
        begin = partial(Simulation, scaled, comm=ranks.comm)
        timers[factor, count] = RankSubsetTimer(ranks, begin, max(scaled.steps, 1), world=world, subset=subset)
    progress = screen.count("scaling", len(timers) * (1 + SAMPLES))
    time_in_turns(list(timers.values()), SAMPLES, sample_seconds, lambda: progress("scaling: time"))
    screen.stop()
    parallel = [timer.sim for (_, count), timer in timers.items() if timer.sim and count > 1]
    cores = world.allgather((platform.node(), os.sched_getaffinity(0)))
    points = {key: timer.point(oversubscribed(cores[: key[1]])) for key, timer in timers.items()}
    return points, not parallel or any(divides(sim) for sim in parallel)


def oversubscribed(cores: list[tuple[str, set[int]]]) -> bool:
    """Are there fewer cores than ranks on some machine? `cores`: of each rank, its machine and the cores it may use."""
    machines = ([own for name, own in cores if name == node] for node, _ in cores)
    return any(len(ranks) > len(set().union(*ranks)) for ranks in machines)


def measure_scaling(described: Scene | None, folder: Path, quick: bool) -> None:
    """Measure, print the tables and the model, write scaling.csv, scaling_model.csv, scaling.png and scaling.svg. Collective.

    `described`: None for the headline gas, and one LARGER_FACTOR times larger. `quick`: short samples, and that one is left out.
    """
    ranks = Communicator()
    screen = Screen(ranks.is_root, False)
    make_folder(ranks, folder)
    with raising_together(ranks):
        scene = described or Scene.load(HEADLINE)
    no_weak, counts = unable_to_grow(scene), rank_counts(ranks.size)
    sizes = [1.0] if described or quick else [1.0, LARGER_FACTOR]
    sample_seconds = QUICK_SAMPLE_SECONDS if quick else SAMPLE_SECONDS
    points, divided = time_settings(scene, ranks, settings(scene, counts, sizes, not no_weak), sample_seconds, screen)
    curves = [Curve(False, [points[size, count] for count in counts]) for size in sizes]
    if not no_weak:
        curves.append(Curve(True, [points[float(count), count] for count in counts]))
    law, measured = law_of(scene, points[1.0, 1].particles, divided), list(points.values())
    model = fit(measured, law, row_bytes(scene)) if ranks.size > 1 else None
    result = Result(scene.title or "untitled scene", law, curves, measured, model, no_weak, described is None)
    with failing_together(ranks, f"cannot write into {folder}"):
        ranks.run_on_root(lambda: write(result, folder, screen))


def row_bytes(scene: Scene) -> int:
    """Return the bytes that are sent of a ghost."""
    ghosts = (FIELDS[name] for name in fields_of(scene) if FIELDS[name].ghost)
    return sum(8 * max(components(column, scene.dimension), 1) for column in ghosts)


def law_of(scene: Scene, total: int, divided: bool) -> Law:
    """Return how work and traffic of the scene grow; `divided`: does each rank compute its part of space?"""
    growth, fetches_all = "N", not divided
    if "mutual_gravity" in scene.effects:
        tree = scene.effects["mutual_gravity"].choice(scene, total).angle is not None
        growth, fetches_all = ("N log N", False) if tree else ("N^2", True)
    return Law(growth, edges(scene), tuple(scene.periodic), fetches_all, divided)


def write(result: Result, folder: Path, screen: Screen) -> None:
    """Print the tables, write tables and figure; on one rank, while the others sleep."""
    for curve in result.curves:
        say_curve(result, curve, screen)
    if result.no_weak:
        screen.say(f"no weak scaling: {'; '.join(result.no_weak)}")
    files = [write_csv(folder / "scaling.csv", list(result.measured_rows()))]
    if result.model:
        say_model(result, result.model, screen)
        files.append(write_csv(folder / "scaling_model.csv", list(result.predicted_rows(result.model))))
    else:
        screen.say("no model: on one rank nothing is sent; mpirun -n P measures up to P ranks")
    figure = draw(result)
    for path in (folder / "scaling.png", folder / "scaling.svg"):
        figure.savefig(path)
        files.append(path)
    screen.say(f"written: {', '.join(map(str, files))}", whole=True)
