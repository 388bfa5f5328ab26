"""Predicts what a run will cost and how wrong it will be; `check` prints it.

The first half second of the run is tried, with output, for the forecast of seconds; a short run at steps of h, h/2 and h/4
gives the errors. Takes two to five seconds. How short it is follows from `counted_seconds`, and from no clock: the errors of a
scene are the same each time, unless its steps take too long to measure any. The energy under collisions is that of the trial.
"""

import os
import sys
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from math import isfinite, log2
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np

from particles_mpi import Scene, Simulation
from particles_mpi.errors import Interrupted, SceneError, StoppedError
from particles_mpi.integrators.gauss_radau import TOLERANCE
from particles_mpi.output.files import failing_together
from particles_mpi.parallel.agreement import await_all
from particles_mpi.run.forecast import Forecast
from particles_mpi.run.job import Job
from particles_mpi.scene.schema import TOLERANCES
from particles_mpi.study.experiment import Benchmark, total_count
from particles_mpi.study.recommend.error_metric import ROUND_OFF, energy_scale
from particles_mpi.study.recommend.lost_collisions import beside_event
from particles_mpi.study.recommend.methods import DIRECT
from particles_mpi.study.recommend.reference import MOST_FOR_DIRECT_SUM
from particles_mpi.study.recommend.runs import LEAST_SNAPSHOTS, Changes, Record, Start, follow, variant
from particles_mpi.study.timing import StepTimer, time_in_turns

ERROR_SECONDS = 0.8  # `counted_seconds` for errors, about
MOST_ERROR_SECONDS = 3.0  # seconds that errors may take where steps take long; more is not tried
LONGEST_TIMED_STEP = 0.03  # seconds: of longer ones it is not measured what each effect costs, which takes copies and time
LONGER = 4  # times as many steps are tried next, where errors took so little time
COST_SAMPLES = 4  # of a step without each effect
COST_SECONDS, COST_STEPS = 0.03, 6  # least seconds and steps of a sample: some have a search that serves several steps
LEAST_SHARE = 0.03  # of a step: less is not told from the noise
COMPILED_IF_LONGER = 3.0  # if a trial takes longer kernels were compiled, and it is done again
MOST_TO_REPEAT = 100_000  # particles for which it is
CHAOS_AFTER = 15.0  # collisions of a particle, after which its place means nothing: round-off has grown to the size of it


@dataclass
class Prediction:
    """How long a run takes (None if nothing happens, or if it stops at once), and how wrong it will be, line by line.

    costs: the share of a step that each effect takes, in words; "" where steps take too long to find out.
    """

    forecast: Forecast | None
    errors: list[str]
    costs: str = ""


def predict(sim: Simulation, benchmark: Benchmark) -> Prediction:
    """Try a simulation that has just begun, on its ranks, which are those of the benchmark. Collective; the same on all ranks.

    No rank holds more of it than its own share, unless steps are so short that errors can be measured.
    """
    scene, ranks = sim.scene, sim.ranks
    if not sim.total or not scene.steps:
        return Prediction(None, ["predicted: nothing happens in this run"])
    try:
        judged = sim.active.pairs and sim.active.forces and sim.active.conserves_energy
        first = sim.measure() if judged else {}
        start, began = sim.copy() if sim.total <= MOST_TO_REPEAT else None, perf_counter()
        forecast = rehearse(sim)
        compiled = perf_counter() - began > COMPILED_IF_LONGER + 10.0 * forecast.step  # a run will find those kernels
        if start and ranks.any(compiled):
            forecast = rehearse(start)
        costs = costs_of(sim, forecast.step)
        errors = (
            predict_contacts(sim, benchmark, forecast.step) + (energy_change(sim, first) if first else [])
            if "collisions" in scene.active
            else predict_steps(benchmark, scene, forecast.step)
        )
    except StoppedError as error:
        await_all(ranks, error)
        return Prediction(None, [f"predicted: stops within the first steps: {str(error).splitlines()[0]}"])
    return Prediction(forecast, errors, costs)


def rehearse(sim: Simulation) -> Forecast:
    """Return the forecast for the whole run from a trial of its first half second, with output. Collective.

    It writes into a folder that is gone afterwards; where runs write theirs, if one may, for disks differ in speed.
    """
    ranks = sim.ranks
    with failing_together(ranks, "cannot write into the working directory"):
        place = Path.cwd() if os.access(Path.cwd(), os.W_OK) else None
        made = TemporaryDirectory(prefix=".check-", dir=place, ignore_cleanup_errors=True) if ranks.is_root else nullcontext("")
    with made as folder:
        job = Job(sim, Path(ranks.bcast(folder)), rehearsal=True)
        job.run()
    forecast: Forecast | None = ranks.bcast(job.forecast)
    if forecast is None:
        raise Interrupted("stopped before the prediction was complete")
    return forecast


def costs_of(sim: Simulation, step: float) -> str:
    """Return a text: the time that a step saves without each effect, measured in turn from the present state; `step`: seconds.

    Effects share some work (walls are looked for with collisions, for instance), so shares need not add up. Collective.
    """
    if step > LONGEST_TIMED_STEP:
        return ""
    timers = {}
    for name in ("", *sim.scene.active):
        begin = partial(without_effect, sim, name)
        try:
            twin = begin()
            twin.steps(COST_STEPS)  # the first ones contain what is done only once
        except (SceneError, StoppedError) as error:  # nothing can be without it
            await_all(sim.ranks, error)
            continue
        timers[name] = StepTimer(sim.ranks, begin, sys.maxsize, sim=twin, left=sys.maxsize)
    if "" not in timers:
        return ""
    try:
        time_in_turns(list(timers.values()), COST_SAMPLES, max(COST_SECONDS, COST_STEPS * step))
    except StoppedError as error:  # without some effect it goes nowhere
        await_all(sim.ranks, error)
        return ""
    whole = timers.pop("").seconds.median
    shares = {name: 1.0 - timer.seconds.median / whole for name, timer in timers.items()}
    return ", ".join(
        f"{name} {1e3 * step * share:.2g} ms ({share:.0%})" if share > LEAST_SHARE else f"{name} less than {LEAST_SHARE:.0%}"
        for name, share in sorted(shares.items(), key=lambda item: -item[1])
    )


def without_effect(sim: Simulation, name: str) -> Simulation:
    """Return a copy in which this effect is switched off, if one is named. Collective."""
    twin = sim.copy()
    if name:
        twin.effects[name].active = False
    return twin


def predict_contacts(sim: Simulation, benchmark: Benchmark, step: float) -> list[str]:
    """Return lines about the errors of collision rates, and of positions after many collisions, from the first steps;
    `step`: seconds of one.
    Collective."""
    scene, options, h = sim.scene, sim.scene.effects["collisions"], sim.scene.time.step
    movable = sim.ranks.total(np.count_nonzero(sim.rows.fixed == 0))[0]
    compared = beside_event(benchmark, scene, 0.5 * ERROR_SECONDS if step <= LONGEST_TIMED_STEP else 0.0)
    found, steps = (compared.exact, compared.steps) if compared.steps else (total_count(sim, "collisions"), sim.steps_done)
    rate = 2.0 * found / (max(movable, 1) * steps * h)
    active = sim.active
    forced = active.forces or active.on_velocities or active.events
    if rate == 0.0:
        return ["predicted error: no collision in the first steps"]
    if options.mode == "event":
        order = "in a user's flow they are first order" if active.flows else "the motion between them is second order"
        what = f"; {order} in the step" if forced else ""
        lines = [f"predicted error: contacts are exact in mode event{what}"]
    else:
        lines = [f"predicted error: {compared} ({rate * h:.2g} collisions per particle in a step, passes {options.passes})"]
    many = rate * scene.steps * h
    orderly = scene.dimension == 1 and not forced  # spheres on a line hand their velocities on: errors grow as the time only
    if many > CHAOS_AFTER and not orderly:
        lines.append(
            f"chaos: {many:.0f} collisions per particle in all, at the rate of the first steps; after about {CHAOS_AFTER:.0f}, "
            f"t = {CHAOS_AFTER / rate:.2g}, positions mean nothing, only averages over many particles do"
        )
    return lines


def energy_change(sim: Simulation, first: dict[str, Any]) -> list[str]:
    """Return a line with the change of the total energy, which should be constant, in the steps done. Collective.

    `first`: what `measure` gave at the start. The change is relative to the larger kinetic energy of the two moments.
    """
    now = sim.measure()
    kinetic = max(first["kinetic"], now["kinetic"])
    if not (kinetic > 0.0 and isfinite(now["total_energy"])):
        return []
    change = abs(now["total_energy"] - first["total_energy"]) / kinetic
    return [f"predicted error: energy changes by {change:.1g} of the kinetic energy until t = {sim.time:.3g}"]


def predict_steps(benchmark: Benchmark, scene: Scene, step: float) -> list[str]:
    """Return a line: errors of positions and energy over as much of the run as time allows; `step`: seconds of one."""
    if scene.steps < LEAST_SNAPSHOTS:
        return [f"predicted error: not measured, the run has fewer than {LEAST_SNAPSHOTS} steps"]
    adaptive = scene.time.integrator == "adaptive"
    runs, steps = 1 + 1 if adaptive else 1 + 2 + 4, LEAST_SNAPSHOTS  # at h, h/2 and h/4
    if 2.0 * runs * steps * step > MOST_ERROR_SECONDS:  # snapshots cost as much as steps
        return ["predicted error: not measured, because a step takes too long; use study recommend"]
    start = Start(benchmark, scene)
    while True:
        snapshots = start.snapshots(steps / scene.steps)
        steps -= steps % snapshots
        records = [follow(start, start.simulate(refined(scene, steps, 0)), snapshots)]
        if LONGER * runs * records[0].counted > ERROR_SECONDS or steps + LEAST_SNAPSHOTS > scene.steps - scene.steps % snapshots:
            break
        steps = min(LONGER * steps, scene.steps)
    records += [follow(start, start.simulate(refined(scene, steps, k)), snapshots) for k in range(1, 2 if adaptive else 3)]
    span = steps * scene.time.step
    return [describe_differences(start, records, span) + error_of_tree(start, records[0], steps)]


def error_of_tree(start: Start, record: Record, steps: int) -> str:
    """Return a text: how far a run with a tree is from one with the direct sum in the same steps; "" if no tree is used."""
    gravity = start.scene.effects.get("mutual_gravity")
    if not (gravity and gravity.active and gravity.choice(start.scene, start.total).angle):
        return ""
    if start.total > MOST_FOR_DIRECT_SUM:
        return "; the error of the tree is added to it"
    snapshots = len(record.places)
    exact = follow(start, start.simulate(refined(start.scene, steps, 0, DIRECT)), snapshots)
    return f"; the tree adds {start.apart(record.places, exact.places) / record.motion:.1g}"


def refined(scene: Scene, steps: int, halvings: int, effects: Changes | None = None) -> Scene:
    """Return the scene's first `steps`, each cut into 2^halvings; for `adaptive` with a tolerance 10^halvings tighter, from its
    own one, or ten times the tightest, on."""
    time: dict[str, Any] = {"steps": steps, "end": None}
    if scene.time.integrator == "adaptive":
        tolerance = max(scene.time.tolerance or TOLERANCE, 10.0 * TOLERANCES[0]) / 10.0**halvings
        time["tolerance"] = max(tolerance, TOLERANCES[0])  # not past it by an ulp
    else:
        time |= {"step": scene.time.step / 2**halvings, "steps": steps * 2**halvings}
    return variant(scene, time, effects)


def describe_differences(start: Start, records: list[Record], span: float) -> str:
    """Return Richardson's estimate as text, from runs at steps h, h/2 and h/4 over a `span`; for `adaptive`, what a tighter
    tolerance changes.

    With the differences d1 of h and h/2, d2 of h/2 and h/4, the order is p = log2(d1/d2), the error of h is d1 2^p/(2^p - 1).
    """
    size, where = records[0].motion, f"t = {span:.3g}"
    one, *finer = (start.apart(a.places, b.places) / size for a, b in pairwise(records))
    if start.scene.time.integrator == "adaptive":
        wrong = f"positions wrong by {max(one, ROUND_OFF):.1g} of the size of the motion at {where}"
        return f"predicted error: {wrong}, as a tighter tolerance shows"
    (two,) = finer
    later = "not measured later" if span <= 0.99 * start.duration else ""
    left_out = start.untravelled(span / records[0].steps) / size
    largest = float(np.abs(records[0].places).max(initial=0.0))
    round_off = max(1e3, records[-1].steps * largest / size) * ROUND_OFF
    if left_out > max(one, two):
        stops = f"positions wrong by {left_out:.1g} of the size of the motion, because drag stops particles within a step"
        return f"predicted error: {stops}" + (f" ({later})" if later else "")
    if one <= two or two <= 100.0 * ROUND_OFF or max(one, two) <= 1e3 * ROUND_OFF:
        coarse = f"about {max(one, two):.1g} of the size of the motion, without an order: steps are too long"
        what = "round-off only" if max(one, two) <= round_off else coarse
        return f"predicted error: positions at {where}: {what}" + (f" ({later})" if later else "")
    order = log2(one / two)
    error = one * 2.0**order / (2.0**order - 1.0)
    line = f"predicted error: positions wrong by {error:.1g} of the size of the motion at {where}, order {order:.1f}"
    if later:
        line += f" ({later}: {error * start.duration / span:.1g} at the end if errors grow evenly)"
    if start.conserves and start.forces:
        energies, scale = records[0].energies, energy_scale(start, records[0].energies, records[0].kinetic)
        line += f"; energy {float(np.abs(energies - energies[0]).max()) / scale:.1g} until then" if scale > 0.0 else ""
    return line
