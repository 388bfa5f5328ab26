"""The step that ends with the next collision of two particles: a root of (when it comes) - (how long the step is)."""

from __future__ import annotations

from typing import Any

import numpy as np

from particles_mpi.errors import SceneError

CLOSE = 1e-14  # of a step: how well a step that ends with a contact must know its own length
MOST_TRIES = 60


def next_length(tried: list[tuple[float, float]], longest: float) -> float:
    """The secant's guess of the step length h that ends with its contact, where (h, lateness) were tried."""
    (h, late) = tried[-1]
    guess = h + 0.5 * late
    if len(tried) > 1 and late != tried[-2][1]:
        guess = h - late * (h - tried[-2][0]) / (late - tried[-2][1])
    return guess if 0.0 <= guess < longest else h + 0.5 * late


def step_to_contact(sim: Any) -> tuple[int, int] | None:
    """Advance a simulation to its next collision; see `Simulation.step_to_collision`. Collective."""
    pairs = sim.active.pairs
    if pairs is None or pairs.options.mode != "event":
        raise SceneError('effects.collisions.mode: step_to_collision needs "event"')
    sim.take_changes()
    sim.particles.close()
    drift = sim.drift
    h, met, free = sim.h, drift.near.stop, not (sim.active.forces or sim.active.on_velocities)
    tried: list[tuple[float, float]] = []  # (length that was kicked for, how much later the contact came)
    for _ in range(MOST_TRIES):
        totals, calls = drift.totals.copy(), drift.calls.copy()
        before = None if free else sim.rows.select(np.arange(len(sim.rows)))
        sim.advance(h, stop=True)
        reached, met_none = float(drift.near.stopped[0]), met[1] < 0
        if met_none and h == sim.h:
            sim.particles.open()
            sim.steps_done += 1
            return None
        tried.append((h, reached - h))
        if before is None or (not met_none and abs(reached - h) <= CLOSE * sim.h):
            break
        sim.rows.replace(before.arrays)
        drift.totals.update(totals)
        drift.calls.clear()
        drift.calls.update(calls)
        h = next_length(tried, sim.h)
    sim.moment = sim.time + reached, sim.steps_done
    sim.particles.open()
    return int(met[1]), int(met[2])
