"""Seconds of a step on some of the ranks while the others sleep, and what the simulation does meanwhile: phases and counts.

All settings are timed by turns. Mutual gravity has one phase for what it sends and what it adds up: the model then finds the
cost of rows, and none of messages.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from particles_mpi.errors import SceneError, StoppedError
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import FIELDS
from particles_mpi.run.console import Screen
from particles_mpi.scene.active import fields_of
from particles_mpi.scene.schema import Scene
from particles_mpi.simulation import Simulation
from particles_mpi.study.scaling.performance_model import Law, Point
from particles_mpi.study.scaling.scale_scene import edges, scale_scene
from particles_mpi.study.timing import SAMPLE, SAMPLES, StepTimer, time_in_turns

TALK = ("agree", "ghosts", "migrate", "exchange")  # phases in which ranks communicate and wait for one another
PHASE = "phase "  # begins the name of what a phase takes


@dataclass
class RankSubsetTimer(StepTimer):
    """Times the steps of one setting on the first ranks of `world`, and notes phases and counts.

    `inside`: is this rank one of them? `sums`: seconds and counts on this rank over all samples, by name.
    """

    world: Communicator = field(kw_only=True)
    inside: bool = field(kw_only=True)
    sums: dict[str, float] = field(default_factory=dict)

    def sample(self, least: float) -> float:
        """Seconds of a step, known to all of the world. Collective there."""
        if not self.samples:
            self.sums.clear()  # those of the warm-up
        seconds, error = 0.0, None
        if self.inside:
            try:
                seconds = super().sample(least)
            except (SceneError, StoppedError) as raised:  # on all of the subset together
                error = raised
        self.world.sleeping_barrier()
        for slowest, failed in self.world.allgather((seconds, error)):
            seconds = max(seconds, slowest)
            if failed:
                raise failed
        return seconds

    def clock(self, sim: Simulation, steps: int) -> float:
        """The same, and what was done meanwhile is added to the sums."""
        before = counters(sim)
        seconds = super().clock(sim, steps)
        for name, value in (counters(sim) | {"steps": steps, "clocked": seconds}).items():
            self.sums[name] = self.sums.get(name, 0) + value - before.get(name, 0)
        return seconds

    def a_step(self) -> dict[str, float]:
        """What a step takes and does on this rank. Phases, which come in lumps, have their share of all samples in the median."""
        phase, step = self.seconds.median / self.sums["clocked"], 1.0 / self.sums["steps"]
        return {name: whole * (phase if name.startswith(PHASE) else step) for name, whole in self.sums.items()}


def divides(sim: Simulation) -> bool:
    """Does each rank compute its part of space? Mode event puts all on every rank where that is no less work."""
    return bool(getattr(sim.near, "divided", True))


def counters(sim: Simulation) -> dict[str, float]:
    """All that counts up in a simulation, on this rank."""
    ranks, near = sim.ranks, sim.near
    searching = near and divides(sim) and "mutual_gravity" not in sim.forces
    counted = {
        "rows": ranks.rows,
        "fetches": near.searches if searching else sim.steps_done,
        "ghost_rows": near.ghost_rows if near else 0,
        "messages": ranks.messages,
        "reductions": ranks.reductions,
        "all_to_alls": ranks.all_to_alls,
    }
    return counted | {f"{PHASE}{name}": seconds for name, seconds in sim.timers.seconds.items()}


class Scaling:
    """Measures a scene on the ranks of a communicator. `quick`: short samples, for a look."""

    def __init__(self, scene: Scene, ranks: Communicator, quick: bool):
        self.scene, self.world = scene, ranks
        self.least = 0.02 if quick else SAMPLE
        self.subsets = {count: ranks.subset(count) for count in rank_counts(ranks.size)}
        self.cores = ranks.allgather((platform.node(), os.sched_getaffinity(0)))

    def oversubscribed(self, count: int) -> bool:
        """Have the first `count` ranks fewer cores than they are, on some machine?"""
        for node in {name for name, _ in self.cores[:count]}:
            ranks = [cores for name, cores in self.cores[:count] if name == node]
            if len(ranks) > len(set().union(*ranks)):
                return True
        return False

    def measure(self, settings: Iterable[tuple[float, int]], screen: Screen) -> dict[tuple[float, int], Point]:
        """The points of the settings (factor, ranks): `factor` times the particles of the scene on so many. Collective."""
        timers = {
            (factor, count): self.timer(self.scene if factor == 1 else scale_scene(self.scene, factor), self.subsets[count])
            for factor, count in settings
        }
        progress = screen.count("scaling", len(timers) * (1 + SAMPLES))
        time_in_turns(list(timers.values()), SAMPLES, self.least, lambda: progress("scaling: time"))
        screen.stop()
        parallel = [timer.sim for (_, count), timer in timers.items() if timer.sim and count > 1]
        self.divided = not parallel or any(divides(sim) for sim in parallel)
        return {setting: self.point(timer, setting[1]) for setting, timer in timers.items()}

    def timer(self, scene: Scene, ranks: Communicator | None) -> RankSubsetTimer:
        """Times the scene on `ranks`; None on the ranks that are not among them."""
        begin = lambda: Simulation(scene, comm=ranks.comm if ranks else None)  # noqa: E731
        return RankSubsetTimer(ranks or self.world, begin, max(scene.steps, 1), world=self.world, inside=ranks is not None)

    def point(self, timer: RankSubsetTimer, count: int) -> Point:
        """What the ranks of a timer found, put together. Collective."""
        own_part = (timer.a_step(), timer.sim.total) if timer.sim else None
        found = [part for part in self.world.allgather(own_part) if part]
        steps = [step for step, _ in found]
        names = [name for name in steps[0] if name.startswith(PHASE)]
        phases = {name.removeprefix(PHASE): float(np.mean([step[name] for step in steps])) for name in names}
        talk = [sum(step.get(f"{PHASE}{name}", 0.0) for name in TALK if count > 1) for step in steps]
        own = [sum(step[name] for name in names) - waited for step, waited in zip(steps, talk, strict=True)]
        seconds = timer.seconds
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
        ghosts = (FIELDS[name] for name in fields_of(self.scene) if FIELDS[name].ghost)
        return sum(8 * (self.scene.dimension if field.vector else 1) for field in ghosts)


def rank_counts(size: int) -> list[int]:
    """1, 2, 4 ... and all."""
    return sorted({*(1 << k for k in range(size.bit_length())), size})
