"""Wall-clock seconds spent in each phase of a run."""

from collections import defaultdict
from time import perf_counter


class Stopwatch:
    """`with stopwatch: ...` adds the seconds of the block to `seconds`."""

    def __init__(self) -> None:
        self.begin = self.seconds = 0.0

    def __enter__(self) -> None:
        self.begin = perf_counter()

    def __exit__(self, *_: object) -> None:
        self.seconds += perf_counter() - self.begin


class Timers:
    """`with timers("search"): ...` adds the seconds of the block to `timers.seconds["search"]`. Phases may not be nested."""

    def __init__(self) -> None:
        self.phases = defaultdict[str, Stopwatch](Stopwatch)

    def __call__(self, phase: str) -> Stopwatch:
        return self.phases[phase]

    @property
    def seconds(self) -> dict[str, float]:
        return {name: phase.seconds for name, phase in self.phases.items()}
