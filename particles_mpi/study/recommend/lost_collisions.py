"""How many collisions a scene has, and how many mode `rewind` loses: counts those of its first steps in both modes."""

from math import sqrt
from typing import NamedTuple

from particles_mpi import Scene, Simulation
from particles_mpi.errors import SceneError, StoppedError
from particles_mpi.parallel.agreement import await_all
from particles_mpi.study.experiment import Benchmark, total_count
from particles_mpi.study.recommend.methods import EVENT
from particles_mpi.study.recommend.runs import counted_seconds, variant


class BesideEvent(NamedTuple):
    """Collisions in mode `rewind` (`found`) and in mode `event` (`exact`) in the first `steps`, and how many the two had when
    they last had the same number."""

    steps: int = 0
    found: int = 0
    exact: int = 0
    same: int = 0

    def __str__(self) -> str:
        """Return a text: the share that is lost, as far as chance lets it be seen: N collisions scatter by less than sqrt(N)."""
        if not self.steps:
            return "not measured, because a step takes too long or mode event refuses the scene"
        if not self.exact:
            return f"no collision in the first {self.steps} steps"
        if self.same == self.exact:
            return f"none of the {self.exact} collisions of the first {self.steps} steps is lost, compared with mode event"
        noise, lost = 2.0 / sqrt(self.exact), 1.0 - self.found / self.exact
        beside = f"of their rate over {self.steps} steps, compared with mode event"
        if lost > noise:
            return f"collisions are lost, about {lost:.1g} {beside}"
        if not self.same:
            return f"less than {noise:.1g} of the collisions are lost: {self.exact} in {self.steps} steps can show no more"
        return f"none of the first {self.same} collisions is lost, and less than {noise:.1g} {beside}"


def beside_event(benchmark: Benchmark, scene: Scene, seconds: float) -> BesideEvent:
    """Count collisions in the scene's own mode and in mode `event`, from its start, in the same steps. Collective.

    Steps are made until `counted_seconds` of these runs together reach `seconds`. Nothing is compared in 0 s, or if mode `event`
    refuses the scene, or stops.
    """
    done = found = exact = same = 0
    try:
        modes = [EVENT] if scene.effects["collisions"].mode == "event" else [{}, EVENT]
        runs = [Simulation(variant(scene, {}, changes), comm=benchmark.comm) for changes in modes]
        while done < scene.steps and sum(map(counted_seconds, runs)) < seconds:
            number = min(max(done, 1), scene.steps - done)
            for sim in runs:
                sim.steps(number)
            done += number
            found, exact = (total_count(sim, "collisions") for sim in (runs[0], runs[-1]))
            same = exact if found == exact else same
    except (SceneError, StoppedError) as error:
        await_all(benchmark.ranks, error)
        return BesideEvent()
    return BesideEvent(done, found, exact, same)
