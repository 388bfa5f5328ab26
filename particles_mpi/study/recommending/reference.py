"""How the reference of a scene comes about: by order 15, by steps ever shorter, as an ensemble, or as what is conserved.

A start that is displaced a little tells how chaotic the motion is, and with that what can be compared at all (see `yardstick`).
"""

from __future__ import annotations

from itertools import pairwise
from math import nan, sqrt
from time import perf_counter

import numpy as np

from particles_mpi import Scene, Simulation
from particles_mpi.errors import SceneError, StoppedError
from particles_mpi.kernels.geometry import image_shifts
from particles_mpi.particles import Array
from particles_mpi.study.recommending.error_metric import ROUND_OFF, Yardstick, observables
from particles_mpi.study.recommending.starts import DIRECT, SHIFT, Start, spread, variant
from particles_mpi.study.recommending.tracks import LOOKS, TooLongError, Track, apart, extrapolated, follow, whole

TIGHT, LOOSE = 1e-9, 1e-7  # tolerances of `adaptive`: both lead to round-off, of which their difference is a sample
SATURATED = 1e-2  # of the size: a displaced start that ends so far away has nothing to do with the start any more
WILD = 1e4  # growth from which spheres that collide are a gas: another order of contacts is as good as this one
APART = 1e-4  # of the size or the speed: members of an ensemble, which soon have nothing to do with one another
MOST_PARTICLES = 3000  # for which a reference is computed by the direct sum, over all pairs
FINE, LEVELS = 4, 9  # reference of a chaotic scene: steps that much shorter; of others: halvings at most
MEMBERS = 8  # of an ensemble
SHARE = 1.0 / 3.0  # of the seconds given are for the reference


def timing(start: Start, steps: int, duration: float, fine: str) -> dict[str, object]:
    """The [time] of a run of so many steps."""
    time: dict[str, object] = {"step": duration / steps, "steps": steps, "integrator": fine}
    return time


def exact(start: Start) -> dict[str, dict[str, object] | None]:
    """Changes of effects for a reference: contacts in order of time, forces over all pairs."""
    changes: dict[str, dict[str, object] | None] = {}
    if "collisions" in start.scene.effects:
        changes["collisions"] = {"mode": "event", "passes": None}
    if "mutual_gravity" in start.scene.effects:
        changes["mutual_gravity"] = DIRECT
    return changes


def steady(start: Start, steps: int, duration: float) -> Scene:
    """The scene by the leapfrog, as exact otherwise as it can be."""
    return variant(start.scene, timing(start, steps, duration, "leapfrog"), exact(start))


def adaptive(start: Start, tolerance: float, duration: float) -> Scene:
    """The scene at order 15."""
    time = timing(start, LOOKS, duration, "adaptive") | {"tolerance": tolerance}
    return variant(start.scene, time, exact(start))


def reference(start: Start, seconds: float, error: str = "") -> Yardstick:
    """The yardstick of a scene, in about a third of the seconds given; of its first part if that is too little. Collective.

    `error`: the only one that matters; the energy of the start needs no better solution.
    """
    if start.total == 0 or start.scene.steps == 0:
        raise SceneError("particles: nothing moves in this scene: there is nothing to measure")
    began, ranks = perf_counter(), start.lab.ranks
    seconds = SHARE * seconds
    if start.conserves and not start.contacts and start.forces and (error == "energy" or start.total > MOST_PARTICLES):
        found = conserved(start, seconds)
    else:
        found = (by_order_15(start, seconds) if start.free else None) or by_steps(start, seconds)
    found.seconds = float(ranks.allreduce_max(perf_counter() - began)[0])
    return found


def affordable(start: Start, cost: float, seconds: float) -> Yardstick:
    """The span that can be measured, where a unit of time costs so many seconds: all of it, or a half, a quarter ..."""
    part = 1.0
    while part * start.duration * cost > seconds and part * start.scene.steps > LOOKS:
        part *= 0.5
    return Yardstick(start, part * start.duration, part)


def rate(start: Start, sim: Simulation, seconds: float, longer: float = 1.0) -> float:
    """Seconds that a unit of time takes: over `seconds` of steps, each `longer` than the last. Collective."""
    sim.step()  # compiled
    passed, took, rates = 0.0, 0.0, [0.0]
    while took < seconds and passed < start.duration:
        began = perf_counter()
        sim.step()
        rates.append(float(sim.ranks.allreduce_max(perf_counter() - began)[0]) / sim.h)
        passed, took = passed + sim.h, took + rates[-1] * sim.h
        sim.h *= longer
    return rates[-1] if longer > 1.0 else float(np.median(rates[1:] or rates))  # a kernel may be loaded on the way


def by_order_15(start: Start, seconds: float) -> Yardstick | None:
    """Reference by `adaptive`, where paths are smooth; None where it does not get through."""
    try:
        probe = start.simulate(adaptive(start, TIGHT, LOOKS * min(start.scene.time.step, start.duration)))
        found = affordable(start, 3.0 * rate(start, probe, 0.02 * seconds, 2.0), seconds)
        while True:
            try:
                tight = follow(start, start.simulate(adaptive(start, TIGHT, found.span)), 0.5 * seconds)
                break
            except TooLongError:  # close encounters came later
                found = Yardstick(start, 0.5 * found.span, 0.5 * found.part)
        loose = follow(start, start.simulate(adaptive(start, LOOSE, found.span)))
        moved = follow(start, start.simulate(adaptive(start, LOOSE, found.span), 1, found.span))
    except StoppedError:
        return None
    found.reference = f"adaptive, tolerance {TIGHT:g}"
    settle(found, tight, apart(loose.places, moved.places, start.length), apart(tight.places, loose.places, start.length))
    return found


def by_steps(start: Start, seconds: float) -> Yardstick:
    """Reference by ever shorter steps of the leapfrog, extrapolated; of an ensemble where motion is chaotic."""
    probe = start.simulate(steady(start, start.scene.steps, start.duration))
    fine = FINE if start.forces or start.dissipates else 1  # contacts alone are exact at any step
    found = affordable(start, rate(start, probe, 0.02 * seconds) * (MEMBERS * fine + 4.0), seconds)
    steps = whole(start.scene.steps * found.part)
    first = follow(start, start.simulate(steady(start, steps, found.span)))
    moved = follow(start, start.simulate(steady(start, steps, found.span), 1, found.span))
    found.size = motion(start, first) or 1.0
    parted = apart(first.places, moved.places, start.length)
    found.growth = parted / (SHIFT * found.size)
    if found.growth < (WILD if "collisions" in start.scene.effects else SATURATED / SHIFT):
        best, wrong, last = converge(found, first, steps, 0.5 * seconds)
        if wrong < SATURATED * found.size:
            settle(found, last, parted, wrong)
            n = first.places.size
            found.places, energy = best[:n].reshape(first.places.shape), best[n:]
            if "energy" in found.floors and not start.conserves:
                found.energy = energy
                found.floors["energy"] += wrong / found.size
            return found
    return ensemble(found, first, steps, steps * fine)


def converge(found: Yardstick, first: Track, steps: int, seconds: float) -> tuple[Array, float, Track]:
    """(places and energies at steps of length zero, how far they may be off, the last run), by halving steps."""
    start, began = found.start, perf_counter()
    floor = max(found.growth, 1.0) * ROUND_OFF * found.size
    tracks, column, took = [first], [packed(first, first, found.start.length)], 0.0
    best, wrong, better = column[0], np.inf, True
    while len(column) < 3 or (len(column) <= LEVELS and wrong > floor and better and 3.0 * took < seconds):
        tracks.append(follow(start, start.simulate(steady(start, steps * 2 ** len(column), found.span))))
        column.append(packed(tracks[-1], first, found.start.length))
        value, change = extrapolated(column)
        better = change < 0.5 * wrong  # if not, round-off or corners are all that is left
        if change <= wrong:
            best, wrong = value, change
        took = float(start.lab.ranks.allreduce_max(perf_counter() - began)[0])
    one, two = (apart(a.places, b.places, found.start.length) for a, b in pairwise(tracks[:3]))
    found.order = float(np.log2(one / two)) if two > floor else nan
    kind = "event" if "collisions" in start.scene.effects else "leapfrog"
    seen = f"order {found.order:.2f}" if two > floor else "no error of the step"
    found.reference = f"{kind}, steps of 1 to 1/{2 ** (len(column) - 1)}, extrapolated ({seen})"
    return best, wrong, tracks[-1]


def packed(track: Track, first: Track, length: Array) -> Array:
    """Places and energies in a row; on periodic axes the image that is nearest to the first."""
    x = track.places - image_shifts(track.places - first.places, length)
    return np.concatenate([x.ravel(), track.energy])


def motion(start: Start, track: Track) -> float:
    """Size of the motion: root of the mean square distance of the particles that move, at the looks, from the middle of them
    at the start. For one particle this is how far it gets."""
    movable = start.particles.fixed == 0
    rows = start.particles.position[movable]
    return spread(track.places[:, movable], rows.mean(axis=0)) if len(rows) else 0.0


def settle(found: Yardstick, track: Track, parted: float, wrong: float) -> None:
    """Floors of a reference that may be wrong by `wrong`, while a displaced start ends `parted` from it (lengths)."""
    found.size = motion(found.start, track) or 1.0
    found.growth = parted / (SHIFT * found.size)
    found.places = track.places
    chaos, own = max(found.growth, 1.0) * ROUND_OFF, wrong / found.size
    if found.growth * SHIFT > SATURATED or own > SATURATED:
        found.kind = "energy"
        found.why = f"chaos: starts {SHIFT:g} of the size apart end {found.growth * SHIFT:.1g} of it apart"
    else:
        found.kind = "places"
        found.floors["state"] = 2.0 * (chaos + own)
        grown = f"chaos: a displaced start ends {found.growth:.2g} times as far away"
        found.why = grown if chaos > own else f"two references differ by {own:.1g}"
    found.compare_energies(track)


def conserved(start: Start, seconds: float) -> Yardstick:
    """The energy alone, which must not change: as long as the scene's own steps are affordable some times over."""
    probe = start.simulate(start.scene)
    row = probe.measure()
    found = affordable(start, 8.0 * rate(start, probe, 0.05 * seconds), seconds)
    found.kind, found.reference = "energy", "the energy of the start"
    found.why = "round-off of a sum"
    energy, kinetic = abs(row["total_energy"]), row["kinetic"]
    found.scale = energy if energy > 0.01 * kinetic else kinetic
    found.floors = {"energy": ROUND_OFF * max(sqrt(start.total), 10.0)} if found.scale > 0.0 else {}
    return found


def ensemble(found: Yardstick, first: Track, coarse: int, steps: int) -> Yardstick:
    """Observables of runs whose starts differ by next to nothing: their mean, and their spread as the floor."""
    start, members = found.start, MEMBERS // 2 if found.start.lab.quick else MEMBERS
    found.kind = "ensemble"
    scene = steady(start, steps, found.span)
    runs = [follow(start, start.simulate(scene, number, found.span, APART)) for number in range(members)]
    values = [observables(run) for run in runs]
    for name in values[0]:
        column = np.array([value[name] for value in values])
        found.means[name] = float(column.mean())
        scale, wide = found.scales[name], float(column.std(ddof=1))
        dull = name == "kinetic energy" and not start.forces and start.conserves
        if scale == 0.0 or dull or (name == "height" and "uniform_gravity" not in start.scene.effects):
            del found.means[name]
        else:
            found.floors[name] = 2.0 * wide * sqrt(1.0 + 1.0 / members) / scale
    if start.conserves:
        found.compare_energies(first)
    kinds = "event" if "collisions" in start.scene.effects else "leapfrog"
    found.reference = f"{kinds}, steps of 1/{steps // coarse}, mean of {members} runs"
    found.why = f"chaos: {members} runs from starts {APART:g} apart differ by so much"
    return found
