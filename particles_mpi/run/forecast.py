"""How long a run will take, from the times of its own first steps; these belong to the run, so that measuring them costs nothing.

Later steps, frames, rows of diagnostics and checkpoints are assumed to take as long as those measured; time in which kernels are
compiled or loaded is not counted. Where the scene shows that later steps may cost more or less, the forecast is a range.
"""

from math import prod
from time import perf_counter
from typing import Any, NamedTuple, Self

from numba.core.event import TimingListener, register

from particles_mpi.scene.active import ActiveEffects
from particles_mpi.scene.plan import duration
from particles_mpi.scene.schema import Scene

MEASURED_SECONDS = 0.5  # seconds of steps that are enough for a forecast, if the first step did not take longer
TRUST = 1.5  # factor within which a forecast should be right
HEAPING = 0.9  # restitution below which falling particles soon lie in heaps
WRITING = {"output": "every", "diagnostics": "diagnostics_every", "checkpoint": "checkpoint_every"}  # phases and their periods


class Outlook(NamedTuple):
    """Later steps take between `least` and `most` times as long as the first ones; `reason`: why, if that exceeds TRUST."""

    least: float = 1.0 / TRUST
    most: float = TRUST
    reason: str = ""


def outlook(scene: Scene) -> Outlook:
    """The outlook for a scene; the factors are the largest ones that were measured with such scenes, rounded up."""
    effects = ActiveEffects(scene)
    if scene.time.integrator == "adaptive":
        return Outlook(0.3, 3.0, "steps get shorter where bodies come close, and how often that happens is not known")
    if effects.forces and effects.pairs:
        if prod(effects.pairs.loss) < HEAPING:
            return Outlook(1.0 / TRUST, 10.0, "forces make particles pile up, and later lasting contacts are not included")
        return Outlook(
            1.0 / TRUST, 4.0, "forces make particles faster and crowd them together, and later contacts are not included"
        )
    if effects.keeps_contacts:
        return Outlook(1.0 / TRUST, 3.0, "falling particles come to rest, and later lasting contacts are not included")
    return Outlook()


class Forecast(NamedTuple):
    """How long the time loop will take."""

    seconds: float  # if steps go on as they began
    least: float  # by the outlook
    most: float
    reason: str  # of the outlook
    step: float  # seconds of a step
    timed: int  # steps over which that was measured
    writing: float  # part of `seconds` for frames, diagnostics and checkpoints
    ranks: int
    phases: dict[str, float]  # seconds of a step by phase

    def __str__(self) -> str:
        """One line for the user."""
        takes = f"about {duration(self.seconds)}" if not self.reason else f"{duration(self.least)} to {duration(self.most)}"
        written = f"; {duration(self.writing)} in all for output" if self.writing > 0.0 else ""
        return (
            f"{takes} on {self.ranks} rank{'s' if self.ranks > 1 else ''}{f': {self.reason}' if self.reason else ''}"
            f" ({self.step * 1e3:.3g} ms a step, measured over {self.timed} step{'s' if self.timed > 1 else ''}{written})"
        )


class Mark(NamedTuple):
    """A run at one time: steps done, the clock, seconds spent to compile or load kernels, and those of each phase."""

    step: int
    clock: float
    loading: float
    phases: dict[str, float]

    def spent(self, since: Self, *names: str) -> float:
        """Seconds in the phases of these names since another mark."""
        return sum(self.phases.get(name, 0.0) - since.phases.get(name, 0.0) for name in names)


LOADING = TimingListener()  # of this process
register("numba:compiler_lock", LOADING)  # numba holds this lock while it compiles or loads a kernel


class Forecaster:
    """Measures the steps of a run up to step `last`, on one rank, from the moment it is made.

    `due_forecast` is to be called after each step and its output. It gives a forecast when enough steps were measured, after half
    of the steps at the latest, and again whenever the time since the start has doubled.
    """

    def __init__(self, sim: Any, last: int):
        self.sim, self.last = sim, last
        self.began = self.first = self.since = self.here()
        self.due, self.half, self.enough = 0.0, self.began.step + (last - self.began.step + 1) // 2, MEASURED_SECONDS
        self.loaded = 0.0  # seconds in which the first row of diagnostics loaded kernels
        self.outlook = outlook(sim.scene)

    def here(self) -> Mark:
        """The mark of the present moment."""
        loading = LOADING.duration if LOADING.done else 0.0
        return Mark(self.sim.steps_done, perf_counter(), loading, self.sim.timers.seconds)

    def reported(self) -> None:
        """To be called after the first row of diagnostics, before any step: only that row may have loaded kernels."""
        self.loaded = self.here().loading - self.began.loading

    def due_forecast(self) -> Forecast | None:
        """A forecast, or None if it is not time for one."""
        if perf_counter() < self.due and self.sim.steps_done < self.half:
            return None
        now = self.here()
        own = self.own(now)
        if self.first is self.began and now.step < self.last:
            # These steps contain what is done only once, and a search that serves many steps. Steps after them are measured, for
            # at least as long, so that searches count in proportion.
            self.first = self.since = now
            self.enough = max(MEASURED_SECONDS, own)
            return None
        if own < self.enough and now.step < self.half:
            self.due = perf_counter() + self.enough - own
            return None
        forecast = self.forecast(now, own)
        self.since, self.outlook, self.enough = now, Outlook(), MEASURED_SECONDS
        self.due, self.half = 2.0 * now.clock - self.began.clock, self.last
        return forecast

    def own(self, now: Mark) -> float:
        """Seconds spent in steps alone since the last mark."""
        loading = now.loading - self.since.loading - (self.loaded if self.since is self.began else 0.0)  # which WRITING has
        return now.clock - self.since.clock - loading - now.spent(self.since, *WRITING)

    def forecast(self, now: Mark, own: float) -> Forecast:
        """The forecast from the steps since the last mark, which took `own` seconds."""
        timed, left = now.step - self.since.step, self.last - now.step
        step, gone = own / timed, now.clock - self.began.clock
        to_write = sum(self.cost(name, now) * self.number(name, now.step, self.last) for name in WRITING)
        seen = self.outlook
        return Forecast(
            seconds=gone + left * step + to_write,
            least=gone + left * step * seen.least + to_write / TRUST,
            most=gone + left * step * seen.most + to_write * TRUST,
            reason=seen.reason,
            step=step,
            timed=timed,
            writing=now.spent(self.began, *WRITING) + to_write,
            ranks=self.sim.ranks.size,
            phases={name: now.spent(self.since, name) / timed for name in now.phases if name not in WRITING},
        )

    def number(self, name: str, begin: int, end: int) -> int:
        """How many frames, rows or checkpoints are written after step `begin` and up to step `end`."""
        every = getattr(self.sim.scene.output, WRITING[name])
        final = name != "output" and begin < end == self.last and end % every > 0
        return int(end // every - begin // every + final)

    def cost(self, name: str, now: Mark) -> float:
        """Seconds for one of them, without the first if there are others; a checkpoint counts as a frame at first."""
        number = self.number(name, self.first.step, now.step)
        if number and self.first is not self.began:
            return now.spent(self.first, name) / number
        number = self.number(name, self.began.step, now.step) + (name != "checkpoint" and self.began.step == 0)
        if number:
            return (now.spent(self.began, name) - (self.loaded if name == "diagnostics" else 0.0)) / number
        return self.cost("output", now) if name == "checkpoint" else 0.0
