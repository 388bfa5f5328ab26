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


def step_to_collision(self: Any) -> tuple[int, int] | None:
    """Advance to the next collision of two particles, or by one step if there is none before its end. Collective.

    Returns the ids of the two that met, the lower one first, or None; `sim.time` is the moment. It is the end of a whole
    leapfrog step of the length that ends with the contact, found by iteration where forces make that depend on itself.
    Needs collisions in mode event. Collisions at the same moment come one call after the other.
    """
    pairs = self.active.pairs
    if pairs is None or pairs.options.mode != "event":
        raise SceneError('effects.collisions.mode: step_to_collision needs "event"')
    self.take_changes()
    self.particles.close()
    h, near, free = self.h, self.near, not (self.active.forces or self.active.on_velocities)
    tried: list[tuple[float, float]] = []  # (length that was kicked for, how much later the contact came)
    for _ in range(MOST_TRIES):
        totals, calls = self.totals.copy(), self.calls.copy()
        before = None if free else self.rows.select(np.arange(len(self.rows)))
        self.advance(h, stop=True)
        reached, met_none = float(near.stopped[0]), near.stop[1] < 0
        if met_none and h == self.h:
            self.particles.open()
            self.steps_done += 1
            return None
        tried.append((h, reached - h))
        if before is None or (not met_none and abs(reached - h) <= CLOSE * self.h):
            break
        self.rows.replace(before.arrays)
        self.totals.update(totals)
        self.calls.clear()
        self.calls.update(calls)
        h = next_length(tried, self.h)
    self.moment = self.time + reached, self.steps_done
    self.particles.open()
    return int(near.stop[1]), int(near.stop[2])
