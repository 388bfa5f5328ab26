"""How velocities change between contacts, so that a contact reflects the velocity that its partners have at its own moment.

In a step, forces, drag and friction act before and after the drift, and within it paths are straight segments. The velocity v
of a segment is that of the middle of the step. At a contact, a time tau later (or earlier, tau < 0), the true velocity is

    w = v + (a - k v - alpha v/(m |v|)) tau + O(tau^2).

A contact takes v to w, applies its law to w, and takes the result back to the middle of the step. Bounces are then of
second order in the step under any force and with any loss. If v itself were reflected, every bounce would change the
energy by up to m a h v, which is first order. Effects on velocities other than drag and friction are not part of w, for their
rate after the contact is not known here: an effect that does no work changes no energy in bounces all the same, but their
direction has an error of first order.
"""

from __future__ import annotations

from math import copysign
from typing import NamedTuple

import numpy as np

from particles_mpi.kernels.jit import lean_inner
from particles_mpi.particles import Array

LONGEST_CHANGE = 0.5  # times the time in which drag and friction would stop a particle: see `change`


class Rates(NamedTuple):
    """dv/dt = a - k v - alpha v/(m |v|)."""

    a: Array  # (n, d) at the start of the step; one row if it is the same for all, no row if nothing changes velocities
    k: Array  # (n,) rates of drag, filled in by `of`; no row without drag
    alpha: float  # strength of friction, or 0
    t_mid: float  # the middle of the step, as a time from the start of the drift

    def of(self, arrays: dict[str, Array]) -> Rates:
        """Return the same rates with the values that differ from particle to particle, from these fields."""
        a = arrays.get("total_acceleration", self.a) if len(self.a) else self.a
        return self._replace(a=a, k=arrays["drag"] if len(self.k) else self.k)


def no_rates(dimension: int) -> Rates:
    """Nothing changes velocities."""
    return Rates(np.empty((0, dimension)), np.empty(0), 0.0, 0.0)


@lean_inner
def change(speed, k, b, time):
    """(decay, force_time): in a time of either sign dv/dt = a - k v - b v/|v| takes v to v decay + a force_time.

    `speed`: the length of v. The implicit midpoint rule with friction as a drag of the rate b/|v|: second order, exact for
    constant a without drag and friction and for friction alone, and with linear drag the way back is the exact inverse. Where
    drag and friction would stop the particle within the time, there is no way back that is not a huge speed; times are cut to
    half of that.
    """
    if b > 0.0 and speed == 0.0:
        return 1.0, 0.0
    rate = k + (b / speed if b > 0.0 else 0.0)
    if rate == 0.0:
        return 1.0, time
    if rate * abs(time) > LONGEST_CHANGE:
        time = copysign(LONGEST_CHANGE / rate, time)
    half = 0.5 * time * (k + (b / (speed - 0.5 * b * time) if b > 0.0 else 0.0))
    return (1.0 - half) / (1.0 + half), time / (1.0 + half)


@lean_inner
def row_of(i, rates):
    """The row of `rates.a` that holds the acceleration of particle i."""
    return i if len(rates.a) > 1 else 0


@lean_inner
def change_of(i, speed2, w, time, rates):
    """`change` of particle i, whose speed has the square `speed2`; w = 1/m, 0 if it is fixed: then nothing changes."""
    if w == 0.0:
        return 1.0, 0.0
    k = rates.k[i] if len(rates.k) > 0 else 0.0
    return change(speed2**0.5, k, rates.alpha * w, time)
