"""Timing on some of the ranks while the others sleep, with what the simulation does meanwhile: phases and counts."""

from __future__ import annotations

from dataclasses import dataclass, field

from particles_mpi.errors import SceneError, StoppedError
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.simulation import Simulation
from particles_mpi.study.measuring.clock import Watch


@dataclass
class Crew(Watch):
    """Times the steps of one setting on the first ranks of `world`, and notes phases and counts; the others sleep meanwhile."""

    world: Communicator = field(kw_only=True)
    inside: bool = field(kw_only=True)
    spans: list[dict[str, float]] = field(default_factory=list)  # what each sample took, on this rank

    def sample(self, least: float) -> float:
        """Seconds of a step, known to all of the world. Collective there."""
        if not self.samples:
            self.spans.clear()  # those of the warm-up
        self.span: dict[str, float] = {"steps": 0, "clocked": 0.0}
        seconds, error = 0.0, None
        if self.inside:
            try:
                seconds = super().sample(least)
            except (SceneError, StoppedError) as raised:  # on all of the crew together
                error = raised
        self.spans.append(self.span)
        self.world.sleeping_barrier()
        for slowest, failed in self.world.allgather((seconds, error)):
            seconds = max(seconds, slowest)
            if failed:
                raise failed
        return seconds

    def clock(self, sim: Simulation, steps: int) -> float:
        """The same, and what was done meanwhile goes into the span."""
        before = gauges(sim)
        seconds = super().clock(sim, steps)
        for name, value in gauges(sim).items():
            self.span[name] = self.span.get(name, 0) + value - before.get(name, 0)
        self.span["steps"] += steps
        self.span["clocked"] += seconds
        return seconds

    def a_step(self) -> dict[str, float]:
        """What a step takes and does on this rank. Phases, which come in lumps, have their share of all samples in the median."""
        steps, clocked = (sum(span[name] for span in self.spans) for name in ("steps", "clocked"))
        told = {}
        for name in dict.fromkeys(name for span in self.spans for name in span):
            whole = sum(span.get(name, 0) for span in self.spans)
            told[name] = whole / clocked * self.seconds.median if name.startswith("phase ") else whole / steps
        return told


def divides(sim: Simulation) -> bool:
    """Does each rank compute its part of space? Mode event puts all on every rank where that is no less work."""
    return bool(getattr(sim.near, "divided", True))


def gauges(sim: Simulation) -> dict[str, float]:
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
    return counted | {f"phase {name}": seconds for name, seconds in sim.timers.seconds.items()}
