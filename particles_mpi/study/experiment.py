"""Experiments: they compare settings of one problem: the errors that each makes, and its cost in seconds and in work."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from math import log, nan
from statistics import linear_regression
from typing import Any

import numpy as np

from particles_mpi import Scene, Simulation
from particles_mpi.measure import snapshot
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Particles
from particles_mpi.run.console import Screen
from particles_mpi.study.timing import NOT_TIMED, QUICK_SAMPLE_SECONDS, SAMPLE_SECONDS, SAMPLES, Seconds, StepTimer, time_in_turns

Errors = dict[str, float]
ENDLESS_STEPS = 10**9  # steps that are timed without a new start: all cost the same
ORDER_FLOOR = 1e-13  # errors below it say nothing of an order


@dataclass
class Setting:
    """One way to solve a problem.

    `curve`: name of the line of the plot that it lies on; `parameter`: what changes along that line (a step, a tolerance).
    `begin` gives a simulation at its start, `errors` runs one to the end and measures its errors (both collective, the same
    bits every time). `steps`: of the whole run; `by_forces`: steps differ, so evaluations of the forces are timed instead;
    `seconds_of`: seconds are reported of so many steps, if not of the whole run.
    """

    curve: str
    parameter: float
    begin: Callable[[], Simulation]
    steps: int
    errors: Callable[[Simulation], Errors]
    by_forces: bool = False
    seconds_of: int = 0


@dataclass
class Row:
    """A measured setting; its times are entered last. `orders`: of each error, from the setting before it on its curve."""

    setting: Setting
    errors: Errors
    work: dict[str, int]
    seconds: Seconds = NOT_TIMED
    orders: Errors = field(default_factory=dict)


@dataclass
class Experiment:
    """A table and a plot.

    `parameter`: name of what changes along a curve. `errors`: what each error is, by its name; the first one is plotted.
    `slopes`: of error against seconds, drawn to compare with. `floor`: smaller errors cannot be told from round-off or noise.
    `answers`: conclusions, a sentence each.
    """

    key: str
    title: str
    parameter: str
    errors: dict[str, str]
    reference: str
    rows: list[Row]
    slopes: tuple[float, ...] = ()
    floor: float = 0.0
    answers: list[str] = field(default_factory=list)

    @property
    def main_error(self) -> str:
        """Name of the error that is plotted."""
        return next(iter(self.errors))

    def curve(self, name: str) -> list[Row]:
        return [row for row in self.rows if row.setting.curve == name]

    @property
    def curves(self) -> list[str]:
        return list(dict.fromkeys(row.setting.curve for row in self.rows))

    def front(self) -> list[Row]:
        """The Pareto front, by seconds: rows that no other row beats both in seconds and in the main error."""
        best, front = float("inf"), []
        for row in sorted(self.rows, key=lambda r: (r.seconds.median, r.errors[self.main_error])):
            if row.errors[self.main_error] < best:
                best = row.errors[self.main_error]
                front.append(row)
        return front


class Benchmark:
    """Measures settings on the ranks of a communicator. `quick`: short samples and fewer settings, for a first look."""

    def __init__(self, comm: Any = None, quick: bool = False, samples: int = SAMPLES, quiet: bool = True):
        self.comm, self.ranks, self.quick = comm, Communicator(comm), quick
        self.samples, self.sample_seconds = samples, QUICK_SAMPLE_SECONDS if quick else SAMPLE_SECONDS
        self.screen = Screen(self.ranks.is_root, quiet)

    def on_few(self, few: bool, work: Callable[[Benchmark], Any]) -> Any:
        """`work(self)`; for `few` bodies, which more ranks would only slow down, on rank 0 alone: None elsewhere. Collective."""
        if not few or self.ranks.size == 1:
            return work(self)
        alone = Benchmark(Communicator.alone().comm, self.quick, self.samples)
        alone.screen = self.screen
        return self.ranks.run_on_root(lambda: work(alone))

    def simulate(self, tables: dict[str, Any]) -> Simulation:
        """Return the simulation of a scene given as tables. Collective."""
        return Simulation(Scene.from_dict(tables), comm=self.comm)

    def at_end(self, tables: dict[str, Any], *fields: str) -> dict[str, Any]:
        """Return the fields of all particles at the end of a scene (tables), as the start of another scene. Collective."""
        sim = self.simulate(tables)
        sim.run()
        p = all_particles(sim)
        return {name: p[name].tolist() for name in fields}

    def setting(
        self, curve: str, parameter: float, tables: dict[str, Any], errors: Callable[[Simulation], Errors], **options: Any
    ) -> Setting:
        """Return the setting that computes a scene (tables) from its start; `options`: other fields of Setting."""
        time = tables["time"]
        defaults = {"steps": time.get("steps", 0), "by_forces": time.get("integrator") == "adaptive"}
        return Setting(curve, parameter, lambda: self.simulate(tables), errors=errors, **(defaults | options))

    def compare(
        self, key: str, title: str, settings: Iterable[Setting], errors: dict[str, str], reference: str, parameter: str = "step",
        **more: Any,
    ) -> Experiment:  # fmt: skip
        """Return the experiment: errors of all settings, then their times, in turn; `more`: its other fields. Collective."""
        settings = list(settings)
        progress = self.screen.count(title, len(settings) * (2 + self.samples))
        rows = []
        for setting in settings:
            progress(f"{title}: errors, {setting.curve}")
            sim = setting.begin()
            before = sim.work()
            found = setting.errors(sim)
            rows.append(Row(setting, found, {kind: count - before[kind] for kind, count in sim.work().items()}))
        self.time(rows, lambda: progress(f"{title}: time"))
        return Experiment(key, title, parameter, errors, reference, rows, **more)

    def time(self, rows: list[Row], progress: Callable[[], None], sample_seconds: float | None = None) -> None:
        """Measure times in turn, and enter times and orders into the rows; end the progress bar. Collective.

        `sample_seconds`: the least seconds of a sample, if other than the benchmark's.
        """
        timers = [StepTimer(self.ranks, row.setting.begin, row.setting.steps, row.setting.by_forces) for row in rows]
        time_in_turns(timers, self.samples, sample_seconds or self.sample_seconds, progress)
        self.screen.stop()
        for row, timer in zip(rows, timers, strict=True):
            units = (row.setting.by_forces and row.work["forces"]) or row.setting.steps  # without forces steps are what is timed
            row.seconds = timer.seconds.of(row.setting.seconds_of or units)
        observe_orders(rows)


def observe_orders(rows: list[Row]) -> None:
    """Enter the order of each error from one row of a curve to the next: log of the ratio of errors over that of parameters."""
    last: dict[str, Row] = {}  # of each curve
    for row in rows:
        before, last[row.setting.curve] = last.get(row.setting.curve), row
        for name, error in row.errors.items():
            row.orders[name] = nan
            if before and min(before.errors[name], error) > ORDER_FLOOR and before.setting.parameter != row.setting.parameter:
                ratio = before.setting.parameter / row.setting.parameter
                row.orders[name] = log(before.errors[name] / error) / log(ratio)


def slope(rows: Sequence[Row], error: str) -> float:
    """Least-squares slope of log error against log parameter; not a number from fewer than two points."""
    points = {log(row.setting.parameter): log(row.errors[error]) for row in rows if row.errors[error] > 0.0}
    return linear_regression(list(points), list(points.values())).slope if len(points) > 1 else nan


def all_particles(sim: Simulation) -> Particles:
    """All particles in id order, on every rank. Collective."""
    return snapshot.gather_all(sim.ranks, sim.particles)


def total_count(sim: Simulation, counter: str) -> int:
    """A counter of the simulation ("collisions", "wall_hits", "missed"), summed over all ranks. Collective."""
    return sim.ranks.total(sim.totals[counter])[0]


def distance(a: Any, b: Any) -> float:
    """The distance between two points, or between two sets of points taken as one."""
    return float(np.sqrt(((np.asarray(a) - np.asarray(b)) ** 2).sum()))
