"""H: effects on and off: the cost of each; an absent one costs nothing, and one with strength 0 changes no bit."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from particles_mpi import Simulation
from particles_mpi.kernels.motion import free_drift, kick
from particles_mpi.scene.effect_files import effect_names
from particles_mpi.study.experiment import Benchmark, Errors, Experiment, Setting, all_particles
from particles_mpi.study.timing import StepTimer, time_in_turns

N, QUICK_N, STEP, STEPS = 100_000, 20_000, 1e-3, 1000
BITS_N, BITS_STEPS = 300, 40  # particles and steps for the comparison of bits
COMPARISONS, QUICK_COMPARISONS = 41, 11  # samples by turns, to see a per cent, or a few
COMPARISON_SECONDS = 0.02  # of a sample
REFERENCE = "the program itself: the same scene without the effect; the same step without any code for other effects"
ACTIVE: dict[str, dict[str, Any]] = {  # each alone, or with what it needs
    "uniform_gravity": {"acceleration": [0.0, 0.0, -9.81]},
    "user_acceleration": {},
    "drag": {"rate": 0.2},
    "friction": {"strength": 0.01},
    "walls": {"restitution": 0.9},
    "collisions": {"restitution": 0.9},
}
INERT: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {  # effects, and what particles need, so that nothing happens
    "uniform_gravity": ({"acceleration": [0.0, 0.0, 0.0]}, {}),
    "user_acceleration": ({}, {"acceleration": [0.0, 0.0, 0.0]}),
    "drag": ({"rate": 0.0}, {}),
    "friction": ({"strength": 0.0}, {}),
    "mutual_gravity": ({"G": 0.0, "softening": 0.01}, {}),
    "collisions": ({}, {}),  # of points: no two of them meet
}
ERRORS = {
    "calls": "calls of all effects that the scene does not name, over the whole run",
    "messages": "messages between ranks in the steps",
    "bits": "numbers that differ between a run that names the effect with a coefficient of 0 and a run without it",
}


def gas(n: int, effects: dict[str, Any], radius: float = 0.0, step: float = STEP, **more: Any) -> dict[str, Any]:
    """Return the tables of a scene with particles all over a box."""
    side = 4.0 * (n / 32000) ** (1 / 3)  # the density of the headline
    spheres = {"count": n, "position": "random", "velocity": {"speed": 0.5}, "radius": radius, "mass": 0.3, **more}
    box, time = {"lower": [0.0] * 3, "upper": [side] * 3}, {"step": step, "steps": STEPS}
    return {"dimension": 3, "box": box, "time": time, "particles": [spheres], "effects": effects}


class Stripped:
    """A simulation under a uniform acceleration with a step that has no code for other effects, written by hand."""

    def __init__(self, sim: Simulation):
        self.sim = sim

    def steps(self, number: int) -> None:
        """Do kick, drift, kick `number` times, with the same timers as the program."""
        sim, p, h = self.sim, self.sim.rows, self.sim.h
        for drifts in number * (True, False):
            with sim.timers("forces"):
                a = sim.sum_forces()
            with sim.timers("kick"):
                kick(p.velocity, a, 0.5 * h)
            if drifts:
                with sim.timers("drift"):
                    free_drift(p.position, p.velocity, h)
        sim.steps_done += number


def bits_that_differ(benchmark: Benchmark, name: str) -> int:
    """Count the coordinates that differ between a run without the effect and one that names it with strength 0."""
    options, more = INERT[name]
    falling = {other: ACTIVE[other] for other in ("walls", "uniform_gravity") if other != name}
    ends = []
    for effects, own in ((falling, {}), (falling | {name: options}, more)):
        sim = benchmark.simulate(gas(BITS_N, effects, step=0.05, **own))
        sim.steps(BITS_STEPS)
        p = all_particles(sim)
        ends.append(np.concatenate([p.position, p.velocity]).view(np.int64))
    return int(np.count_nonzero(ends[0] != ends[1]))


def errors(benchmark: Benchmark, name: str, sim: Simulation) -> Errors:
    """Count calls of absent effects, messages in some steps, and numbers that differ with an effect of strength 0. Collective."""
    sim.step()
    messages = sim.ranks.messages
    sim.steps(10)
    absent = sum(sim.calls.get(other, 0) for other in effect_names() if other not in sim.scene.effects)
    sent = sim.ranks.total(sim.ranks.messages - messages)[0]
    differ = bits_that_differ(benchmark, name) if name in INERT else 0
    return {"calls": float(absent), "messages": float(sent), "bits": float(differ)}


def settings(benchmark: Benchmark, n: int) -> Iterator[Setting]:
    """Yield a gas without effects, with each effect alone, and with all of them."""
    own = "user_acceleration"  # forces that are not the same everywhere make every pair one that may rest
    named: dict[str, dict[str, Any]] = {"nothing": {}} | {name: {name: options} for name, options in ACTIVE.items()}
    named[f"all but {own}"] = {name: options for name, options in ACTIVE.items() if name != own}
    for curve, effects in (named | {"all of these": ACTIVE}).items():
        pushed: dict[str, Any] = {"acceleration": [0.0, 0.0, -1.0]} if own in effects else {}
        start = benchmark.simulate(gas(n, effects, 0.01 if "collisions" in effects else 0.0, **pushed))
        yield Setting(curve, float(n), start.copy, STEPS, partial(errors, benchmark, curve), seconds_of=1)


def absence(benchmark: Benchmark, n: int) -> tuple[float, float, float]:
    """Return (first quartile, median, third quartile) of the share of a step that is spent on absent effects.

    Samples of the program alternate with samples of `Stripped`, which has no code for them; the share is 1 - stripped/whole.
    """
    start = benchmark.simulate(gas(n * benchmark.ranks.size, {"uniform_gravity": ACTIVE["uniform_gravity"]}))

    def one_by_one() -> Simulation:
        """Return the simulation in single steps, because `Stripped` has no loop over many steps to compare with."""
        sim = start.copy()
        sim.many_steps = None
        return sim

    whole = StepTimer(benchmark.ranks, one_by_one, STEPS)
    less = StepTimer(benchmark.ranks, lambda: Stripped(start.copy()), STEPS)  # type: ignore[arg-type, return-value]
    time_in_turns([whole, less], QUICK_COMPARISONS if benchmark.quick else COMPARISONS, COMPARISON_SECONDS)
    low, middle, high = np.percentile([1.0 - b / a for a, b in zip(whole.samples, less.samples, strict=True)], (25, 50, 75))
    return float(low), float(middle), float(high)


def experiments(benchmark: Benchmark) -> list[Experiment]:
    """Measure H: what each effect costs, and what absent ones cost. Collective."""
    n = QUICK_N if benchmark.quick else N
    found = benchmark.compare("H", "Effects on and off, a step", settings(benchmark, n), ERRORS, REFERENCE, "particles")
    low, middle, high = absence(benchmark, n)
    each = ", ".join(f"{row.setting.curve} {row.seconds.median / n * 1e9:.1f}" for row in found.rows)
    absent, differ = (sum(row.errors[name] for row in found.rows) for name in ("calls", "bits"))
    found.answers = [
        f"nanoseconds a particle-step: {each}",
        f"effects not named: {absent:.0f} calls; code for them takes {middle:.1%} of a step of uniform_gravity (quartiles "
        f"{low:.1%} to {high:.1%})",
        "all of these cost more than their sum: where forces differ between positions, any two spheres may press one another,"
        " and lasting contacts are searched among all near pairs",
        f"effects named with strength 0: {differ:.0f} of all numbers differ from a run without them",
    ]
    return [found]
