"""The reference of a scene: by the adaptive method of order 15, by steps ever shorter, as an ensemble, or what is conserved.

A start that is displaced a little tells how chaotic the motion is, and with that what can be compared at all.
"""

from itertools import pairwise
from math import inf, nan, sqrt
from typing import Any

import numpy as np

from particles_mpi import Scene, Simulation
from particles_mpi.errors import SceneError, StoppedError
from particles_mpi.kernels.geometry import image_shifts
from particles_mpi.parallel.agreement import await_all
from particles_mpi.particles import Array
from particles_mpi.study.recommend.error_metric import ROUND_OFF, ErrorMetric, energy_scale
from particles_mpi.study.recommend.methods import DIRECT, EVENT
from particles_mpi.study.recommend.runs import (
    DISPLACEMENT,
    LEAST_SNAPSHOTS,
    Record,
    Start,
    TooLongError,
    counted_seconds,
    follow,
    variant,
    whole_parts,
)

STOPS = 13  # of `adaptive` between two snapshots, to look at where the particles are
TIGHT, LOOSE = 1e-9, 1e-7  # tolerances of `adaptive`: both lead to round-off, of which their difference is a sample
SATURATED = 1e-2  # of the size: a displaced start that ends so far away has nothing to do with the start any more
CHAOTIC_GROWTH = 1e4  # growth from which spheres that collide are a gas: another order of contacts is as good as this one
ENSEMBLE_DISPLACEMENT = 1e-4  # of the size or the speed: members of an ensemble, which soon have nothing to do with one another
MOST_FOR_DIRECT_SUM = 3000  # for which a reference is computed by the direct sum, over all pairs
ENSEMBLE_REFINEMENT, MOST_HALVINGS = 4, 9  # reference of a chaotic scene: steps that much shorter; of others: halvings at most
ENSEMBLE_SIZE = 8  # runs
NOISE = 10.0  # times what round-off can change: differences above are differences
LEAST_ORDER, SLOWEST_ORDER = 1.5, 0.25  # of differences between steps: below the first they are not extrapolated; at least
REFERENCE_SHARE = 1.0 / 3.0  # of the seconds given are for the reference


def reference(start: Start, seconds: float, error: str = "") -> ErrorMetric:
    """Return the error metric of a scene, in a third of the seconds given; of its first part if they are too few. Collective.

    All seconds here are `counted_seconds`, so that the reference is the same each time and on any ranks.

    `error`: the only one that matters; the energy of the start needs no better solution.
    """
    if start.total == 0 or start.scene.steps == 0:
        raise SceneError("particles: nothing moves in this scene, so there is nothing to measure")
    seconds = REFERENCE_SHARE * seconds
    if start.conserves and not start.contacts and start.forces and (error == "energy" or start.total > MOST_FOR_DIRECT_SUM):
        return by_conserved_energy(start, seconds)
    found = by_order_15(start, seconds) if start.smooth else None
    if found and found.part == 1.0:
        return found
    by_leapfrog = by_steps(start, seconds)  # which may be affordable for longer, where not all digits are wanted
    doubtful = by_leapfrog.order < LEAST_ORDER
    return found if found and (found.part >= by_leapfrog.part or doubtful) else by_leapfrog


def exact_scene(start: Start, steps: int, duration: float, **time: Any) -> Scene:
    """Return the scene with contacts in order of time, forces over all pairs, and so many steps; `time`: other keys of [time]."""
    default = {"end": None, "integrator": "leapfrog", "tolerance": None}
    return variant(start.scene, default | {"step": duration / steps, "steps": steps, **time}, EVENT | DIRECT)


def affordable(start: Start, cost: float, seconds: float) -> ErrorMetric:
    """Return an empty error metric over the part of the run that can be measured: all, a half, a quarter and so on.

    `cost`: counted seconds that a unit of simulated time takes; `seconds`: how many there are.
    """
    part = 1.0
    while part * start.duration * cost > seconds and part * start.scene.steps > LEAST_SNAPSHOTS:
        part *= 0.5
    return ErrorMetric(start, part)


def cost(start: Start, sim: Simulation, seconds: float, longer: float = 1.0) -> float:
    """Return the seconds per unit of simulated time, from `seconds` of steps, each `longer` than the last. Collective."""
    sim.step()
    passed, spent, rates, number, before = 0.0, 0.0, [0.0], 1, counted_seconds(sim)
    while spent < seconds and passed < start.duration:
        sim.steps(number)
        now = counted_seconds(sim)
        took, before = max(now - before, 0.0), now  # those that come to rest, and wake, are counted as they are now
        rates.append(took / (number * sim.h))
        passed, spent = passed + number * sim.h, spent + took
        sim.h *= longer
        number *= 2 if longer == 1.0 and spent < 0.1 * seconds else 1  # few bodies: many steps cost little more than one
    return rates[-1] if longer > 1.0 else float(np.median(rates[1:] or rates))


def by_order_15(start: Start, seconds: float) -> ErrorMetric | None:
    """Return a reference by `adaptive`, if paths are smooth; None if it does not get through."""

    def simulate_adaptive(tolerance: float, duration: float, snapshots: int, shifted: int = 0) -> Simulation:
        scene = exact_scene(start, STOPS * snapshots, duration, integrator="adaptive", tolerance=tolerance)
        return start.simulate(scene, shifted, duration)

    def over_span(found: ErrorMetric, tolerance: float, shifted: int = 0, patience: float = inf) -> Record:
        return follow(start, simulate_adaptive(tolerance, found.span, found.snapshots, shifted), found.snapshots, patience)

    try:
        probe = simulate_adaptive(TIGHT, LEAST_SNAPSHOTS * min(start.scene.time.step, start.duration), LEAST_SNAPSHOTS)
        found = affordable(start, 3.0 * cost(start, probe, 0.02 * seconds, 2.0), seconds)
        while True:
            try:
                tight = over_span(found, TIGHT, patience=0.5 * seconds)
                break
            except TooLongError:  # close encounters came later
                found.part *= 0.5
                if found.part * start.scene.steps < 1.0:
                    return None
        loose, displaced = (over_span(found, LOOSE, shifted) for shifted in (0, 1))
    except StoppedError as error:
        await_all(start.benchmark.ranks, error)
        return None
    found.reference = f"adaptive, tolerance {TIGHT:g}"
    set_limits(found, tight, start.apart(loose.places, displaced.places), start.apart(tight.places, loose.places))
    return found


def by_steps(start: Start, seconds: float) -> ErrorMetric:
    """Return a reference by ever shorter leapfrog steps, extrapolated; from an ensemble if motion is chaotic."""
    probe = start.simulate(exact_scene(start, start.scene.steps, start.duration))
    fine = ENSEMBLE_REFINEMENT if start.forces or start.dissipates else 1  # contacts alone are exact at any step
    price = cost(start, probe, 0.02 * seconds)
    found = affordable(start, price * (ENSEMBLE_SIZE * fine + 4.0), seconds)
    needed = start.drag.max(initial=0.0) * found.span  # with fewer steps drag stops particles within a step
    steps = max(
        start.scene.steps * found.part, min(needed, seconds / (price * start.scene.time.step * (ENSEMBLE_SIZE * fine + 4.0)))
    )
    steps = whole_parts(steps, found.snapshots)
    scene = exact_scene(start, steps, found.span)
    first, displaced = (follow(start, start.simulate(scene, shifted, found.span), found.snapshots) for shifted in (0, 1))
    found.size = first.motion
    parted = start.apart(first.places, displaced.places)
    found.growth = parted / (DISPLACEMENT * found.size)
    if found.growth < (CHAOTIC_GROWTH if "collisions" in start.scene.effects else SATURATED / DISPLACEMENT):
        best, uncertainty, last = converge(found, first, steps, 0.5 * seconds)
        if uncertainty < SATURATED * found.size:
            set_limits(found, last, parted, uncertainty)
            n = first.places.size
            found.places = best[:n].reshape(first.places.shape)
            if "energy" in found.limits and not start.conserves:
                found.energy = best[n:]
                found.limits["energy"] += uncertainty / found.size
            return found
        if start.untravelled(found.span / last.steps) > SATURATED * found.size:
            raise SceneError("effects.drag: stops particles within the shortest steps that there is time for: shorten time.step")
        found.why = f"places change by {uncertainty / found.size:.1g} of the size with shorter steps"
    return by_ensemble(found, first, steps, fine)


def converge(found: ErrorMetric, first: Record, steps: int, seconds: float) -> tuple[Array, float, Record]:
    """Return (positions and energies at steps of length zero, how far they may be off, the last run), by halving steps."""
    start = found.start
    limit = max(found.growth, 1.0) * ROUND_OFF * found.size
    records, column = [first], [places_and_energies(first, first, start.length)]
    best, uncertainty, better, spent = column[0], np.inf, True, 0.0
    while len(column) < 3 or (len(column) <= MOST_HALVINGS and uncertainty > limit and better and 3.0 * spent < seconds):
        records.append(follow(start, start.simulate(exact_scene(start, steps * 2 ** len(column), found.span)), found.snapshots))
        column.append(places_and_energies(records[-1], first, start.length))
        value, change = extrapolated(column)
        change += start.late(found.span / records[-1].steps)
        better = change < 0.6 * uncertainty or start.events  # if not, round-off or corners are all that is left
        by_chance = change > max(uncertainty, NOISE * limit)  # the last two agreed, as where an event falls into the same step
        if by_chance or change <= uncertainty:
            best, uncertainty, better = value, change, better or by_chance
        spent += records[-1].counted
    one, two = (start.apart(a.places, b.places) for a, b in pairwise(records[:3]))
    has_order = min(one, two) > NOISE * limit
    found.order = float(np.log2(one / two)) if has_order else nan
    seen = f"order {found.order:.2f}" if has_order else "the step makes no error"
    found.reference = f"{method_in_words(start)}, steps of 1 to 1/{2 ** (len(column) - 1)}, extrapolated ({seen})"
    before, after = (float(np.abs(new - old).max(initial=0.0)) for old, new in pairwise(column[-3:]))
    if after > NOISE * limit and before < after * 2.0**LEAST_ORDER:  # not of second order: the rest is a series of such changes
        uncertainty = max(uncertainty, after / (max(before / after, 2.0**SLOWEST_ORDER) - 1.0))
    return best, uncertainty + start.untravelled(found.span / records[-1].steps), records[-1]


def method_in_words(start: Start) -> str:
    """Return the method of `exact_scene` in one word."""
    return "event" if "collisions" in start.scene.effects else "leapfrog"


def places_and_energies(record: Record, first: Record, length: Array) -> Array:
    """Return positions and energies in one array; on periodic axes the image that is nearest to the first."""
    x = record.places - image_shifts(record.places - first.places, length)
    return np.concatenate([x.ravel(), record.energy])


def extrapolated(column: list[Array]) -> tuple[Array, float]:
    """Return the limit of values at steps h, h/2, h/4 ... with errors in even powers of h (Romberg), and its uncertainty.

    Where higher powers do not help (corners in a motion) fewer are taken: those whose last two values are closest.
    """
    rows: list[list[Array]] = [[column[0]]]
    for value in column[1:]:
        row: list[Array] = [value]
        for k, before in enumerate(rows[-1], 1):
            row.append(row[-1] + (row[-1] - before) / (4.0**k - 1.0))
        rows.append(row)
    earlier, last = rows[-2:]
    changes = [float(np.abs(new - old).max(initial=0.0)) for old, new in zip(earlier, last, strict=False)]
    best = int(np.argmin(changes))
    return last[best], changes[best]


def set_limits(found: ErrorMetric, record: Record, parted: float, uncertainty: float) -> None:
    """Set the resolution limits of a reference that may be wrong by `uncertainty`; a displaced start ends `parted` from it
    (both lengths)."""
    found.size = record.motion
    found.growth = parted / (DISPLACEMENT * found.size)
    found.places = record.places
    chaos, own = max(found.growth, 1.0) * ROUND_OFF, uncertainty / found.size
    if found.growth * DISPLACEMENT > SATURATED or own > SATURATED:
        found.why = f"chaos: starts that are {DISPLACEMENT:g} of the size apart end {found.growth * DISPLACEMENT:.1g} of it apart"
    else:
        found.limits["state"] = 2.0 * (chaos + own)
        sensitive = f"round-off: a displaced start ends {found.growth:.2g} times as far away"
        found.why = sensitive if chaos > own else f"two references differ by {own:.1g}"
    found.add_energy(record)


def by_conserved_energy(start: Start, seconds: float) -> ErrorMetric:
    """Return a metric of the energy alone, which must not change, over as many of the scene's own steps as are affordable."""
    probe = start.simulate(start.scene)
    rows = [probe.measure()]
    found = affordable(start, 8.0 * cost(start, probe, 0.05 * seconds), seconds)
    rows.append(probe.measure())
    found.reference, found.why = "the energy of the start", "round-off of a sum"
    found.scale = energy_scale(start, *(np.array([row[name] for row in rows]) for name in ("total_energy", "kinetic")))
    if found.scale > 0.0:
        found.limits["energy"] = ROUND_OFF * max(sqrt(start.total), 10.0)
    return found


def by_ensemble(found: ErrorMetric, first: Record, steps: int, fine: int) -> ErrorMetric:
    """Return a metric of observables: the mean of runs with nearly equal starts, and their spread as the resolution limit."""
    start, members = found.start, ENSEMBLE_SIZE // 2 if found.start.benchmark.quick else ENSEMBLE_SIZE
    scene = exact_scene(start, steps * fine, found.span)
    runs = [
        follow(start, start.simulate(scene, number, found.span, ENSEMBLE_DISPLACEMENT), found.snapshots).observables
        for number in range(members)
    ]
    for name in runs[0]:
        column = np.array([run[name] for run in runs])
        found.means[name] = float(column.mean())
        scale, deviation = found.scale_of(name), float(column.std(ddof=1))
        constant = name == "kinetic energy" and not start.forces and start.conserves
        if scale == 0.0 or constant or (name == "height" and "uniform_gravity" not in start.scene.effects):
            del found.means[name]
        else:
            found.limits[name] = 2.0 * deviation * sqrt(1.0 + 1.0 / members) / scale
    if start.conserves:
        found.add_energy(first)
    found.reference = f"{method_in_words(start)}, steps of 1/{fine}, mean of {members} runs"
    why = found.why or "chaos"
    found.why = f"{why}: {members} runs from starts {ENSEMBLE_DISPLACEMENT:g} apart differ by that"
    return found
