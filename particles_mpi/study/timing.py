"""Fair timing of simulations: warmed up, settings in turn, on the slowest rank, with medians and quartiles, without output.

A sample is as many consecutive steps as take SAMPLE_SECONDS. A run that has come to its end begins again, off the clock.
Settings that are compared take turns, a sample each, so that a disturbance of the machine meets all of them.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import nan
from time import perf_counter

import numpy as np

from particles_mpi.parallel.communicator import Communicator
from particles_mpi.simulation import Simulation

SAMPLES = 7  # of a setting
SAMPLE_SECONDS, QUICK_SAMPLE_SECONDS = 0.2, 0.02  # of a sample, at least


@dataclass(frozen=True)
class Seconds:
    """Seconds of one step (or of one evaluation of the forces): median and quartiles over the samples."""

    median: float
    low: float
    high: float

    def of(self, steps: int) -> Seconds:
        return Seconds(self.median * steps, self.low * steps, self.high * steps)


NOT_TIMED = Seconds(nan, nan, nan)


@dataclass
class StepTimer:
    """Times the steps of one setting.

    `begin` gives a simulation at its start (collective); it is timed over `steps` steps and then begun anew. With `by_forces`
    steps differ from one another, and seconds are those of one evaluation of the forces.
    """

    ranks: Communicator
    begin: Callable[[], Simulation]
    steps: int
    by_forces: bool = False
    sim: Simulation | None = None
    left: int = 0
    samples: list[float] = field(default_factory=list)

    def sample(self, sample_seconds: float) -> float:
        """Return the seconds of a step on the slowest rank, measured over at least `sample_seconds`. Collective."""
        clocked, steps, units, stride = 0.0, 0, 0, 1
        while clocked < sample_seconds:
            if self.sim is None or not self.left:
                self.sim, self.left = self.begin(), self.steps
            stride = min(stride, self.left)
            before = self.sim.work()["forces"] if self.by_forces else 0
            clocked += self.clock(self.sim, stride)
            evaluated = self.sim.work()["forces"] - before if self.by_forces else 0
            units += evaluated or stride  # without forces there are none to count
            steps += stride
            self.left -= stride
            stride = max(1, int(min((sample_seconds - clocked) * steps / max(clocked, 1e-9), 4.0 * steps)) + 1)
        return clocked / units

    def clock(self, sim: Simulation, steps: int) -> float:
        """Return the seconds that the slowest rank takes for these steps. Collective."""
        self.ranks.barrier()
        begin = perf_counter()
        sim.steps(steps)
        return self.ranks.largest(perf_counter() - begin)[0]

    @property
    def seconds(self) -> Seconds:
        """Return the seconds of one step, from all samples."""
        low, median, high = np.percentile(self.samples, (25, 50, 75))
        return Seconds(float(median), float(low), float(high))


def time_in_turns(
    timers: Sequence[StepTimer], samples: int, sample_seconds: float, progress: Callable[[], None] = lambda: None
) -> None:
    """Take `samples` samples of each timer in turn, after one that does not count; call `progress` after each. Collective."""
    gc.collect()
    gc.freeze()  # what is there need not be looked at again in each turn
    gc.disable()  # a collection within a sample would make that sample slower by chance
    try:
        for turn in range(samples + 1):
            gc.collect()
            for timer in timers if turn % 2 else timers[::-1]:  # each is first in half of the turns
                seconds = timer.sample(sample_seconds if turn else 0.25 * sample_seconds)
                if turn:
                    timer.samples.append(seconds)
                progress()
    finally:
        gc.unfreeze()
        gc.enable()
