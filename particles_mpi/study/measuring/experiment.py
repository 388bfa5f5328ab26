"""What an experiment is: settings of the same problem, the errors that each makes, what each costs in seconds and in work."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import log, nan
from typing import Any

from particles_mpi import Scene, Simulation
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.run.console import Screen
from particles_mpi.study.measuring.clock import SAMPLE, SAMPLES, Seconds, Watch, time_in_turns

Errors = dict[str, float]
ROUND_OFF = 1e-13  # errors below it say nothing of an order


@dataclass
class Setting:
    """One way to solve a problem.

    `curve`: the settings that lie on one line of the plot; `knob`: the value that changes along it, and `finer` whether it
    grows as errors shrink. `begin` gives a simulation at the start, `errors` runs one to the end and tells how wrong it is
    (both collective; the same bits every time). `steps`: of the whole run, after which timing begins anew; `by_forces`: they
    differ, so evaluations of the forces are timed; `told`: seconds are told of so many steps, not of the whole run.
    """

    curve: str
    knob: float
    begin: Callable[[], Simulation]
    steps: int
    errors: Callable[[Simulation], Errors]
    by_forces: bool = False
    told: int = 0
    more: dict[str, Any] = field(default_factory=dict)


@dataclass
class Row:
    """A setting, measured. `orders`: of each error, from the setting before it on its curve."""

    setting: Setting
    errors: Errors
    orders: Errors
    seconds: Seconds
    work: dict[str, int]


@dataclass
class Experiment:
    """A table and a plot. `errors`: what each error is, by name, the first one is the plot's; `slopes`: guides in time."""

    key: str
    title: str
    knob: str
    errors: dict[str, str]
    reference: str
    rows: list[Row]
    slopes: tuple[float, ...] = ()
    floor: float = 0.0  # what an error smaller than it does not mean
    answers: list[str] = field(default_factory=list)
    figure: str = ""  # SVG, once drawn

    def curve(self, name: str) -> list[Row]:
        """The rows of one curve, in their order."""
        return [row for row in self.rows if row.setting.curve == name]

    @property
    def curves(self) -> list[str]:
        """Names, in order of appearance."""
        return list(dict.fromkeys(row.setting.curve for row in self.rows))

    def front(self, error: str | None = None) -> list[Row]:
        """The Pareto front: rows that no other row beats in both seconds and error, by seconds."""
        error = error or next(iter(self.errors))
        best, front = float("inf"), []
        for row in sorted(self.rows, key=lambda r: (r.seconds.median, r.errors[error])):
            if row.errors[error] < best:
                best = row.errors[error]
                front.append(row)
        return front


class Lab:
    """Measures settings on the ranks of a communicator. `quick`: short samples, for a look."""

    def __init__(self, comm: Any = None, quick: bool = False, samples: int = SAMPLES, screen: Screen | None = None):
        self.comm, self.ranks, self.quick = comm, Communicator(comm), quick
        self.samples, self.least = samples, 0.02 if quick else SAMPLE
        self.screen = screen or Screen(self.ranks.is_root, True)

    def alone(self) -> Lab:
        """This rank's own, for problems of a few bodies that more ranks would only slow down."""
        return Lab(Communicator.alone().comm, self.quick, self.samples, self.screen)

    def simulate(self, tables: dict[str, Any]) -> Simulation:
        """The simulation of a scene given as tables."""
        return Simulation(Scene.from_dict(tables), comm=self.comm)

    def measure(self, name: str, settings: Sequence[Setting]) -> list[Row]:
        """Errors of all settings, then their times, by turns. Collective."""
        told = self.screen.count(name, len(settings) * (2 + self.samples))
        errors, work = [], []
        for setting in settings:
            told(f"{name}: errors, {setting.curve}")
            sim = setting.begin()
            before = sim.work()
            errors.append(setting.errors(sim))
            work.append({what: count - before[what] for what, count in sim.work().items()})
        return self.clocked(settings, errors, work, lambda: told(f"{name}: time"))

    def clocked(
        self, settings: Sequence[Setting], errors: Sequence[Errors], work: Sequence[dict[str, int]], told: Callable[[], None]
    ) -> list[Row]:
        """Times of settings whose errors and work are known, by turns; ends the progress bar. Collective."""
        watches = [Watch(self.ranks, setting.begin, setting.steps, setting.by_forces) for setting in settings]
        time_in_turns(watches, self.samples, self.least, told)
        self.screen.stop()
        rows = []
        for setting, wrong, done, watch in zip(settings, errors, work, watches, strict=True):
            units = setting.told or (done["forces"] if setting.by_forces else setting.steps)
            rows.append(Row(setting, wrong, {}, watch.seconds.of(units), done))
        for curve in dict.fromkeys(setting.curve for setting in settings):
            observe_orders([row for row in rows if row.setting.curve == curve])
        return rows


def observe_orders(rows: list[Row]) -> None:
    """Order of each error from one row to the next: log of the ratio of errors over that of the knobs, as it is seen."""
    for before, row in zip([None, *rows], rows, strict=False):
        for name, error in row.errors.items():
            row.orders[name] = nan
            if before and min(before.errors[name], error) > ROUND_OFF and before.setting.knob != row.setting.knob:
                row.orders[name] = log(before.errors[name] / error) / log(before.setting.knob / row.setting.knob)


def slope(rows: Sequence[Row], error: str) -> float:
    """Least-squares slope of log error against log knob."""
    points = [(log(row.setting.knob), log(row.errors[error])) for row in rows if row.errors[error] > 0.0]
    if len(points) < 2:
        return nan
    x, y = (sum(p[k] for p in points) / len(points) for k in (0, 1))
    spread = sum((p[0] - x) ** 2 for p in points)
    return sum((p[0] - x) * (p[1] - y) for p in points) / spread if spread else nan
