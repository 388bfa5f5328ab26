"""Seconds a phase."""

from __future__ import annotations

from time import perf_counter


class Phase:
    """A stop watch: `with phase: ...` adds to its seconds."""

    __slots__ = ("begin", "seconds")

    def __init__(self) -> None:
        self.begin = self.seconds = 0.0

    def __enter__(self) -> None:
        self.begin = perf_counter()

    def __exit__(self, *_: object) -> None:
        self.seconds += perf_counter() - self.begin


class Timers:
    """`with timers("search"): ...` adds to that phase's seconds; `timers.seconds` holds them. Phases do not nest."""

    def __init__(self) -> None:
        self.phases: dict[str, Phase] = {}

    def __call__(self, phase: str) -> Phase:
        found = self.phases.get(phase)
        if found is None:
            found = self.phases[phase] = Phase()
        return found

    @property
    def seconds(self) -> dict[str, float]:
        return {name: phase.seconds for name, phase in self.phases.items()}
