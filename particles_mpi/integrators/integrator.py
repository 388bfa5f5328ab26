"""What an integrator is: it advances particles by one step, and asks for forces and drifts as it needs them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from particles_mpi.particles import Array, Particles
from particles_mpi.timers import Timers

Forces = Callable[[], Array | None]  # accelerations (n, d) at the positions of this moment, or None


Drift = Callable[[float], None]  # positions over a time


class Integrator(Protocol):
    """Advances particles by a step of length h, calling for forces and drifts as it needs them. Collective."""

    def advance(self, particles: Particles, h: float, forces: Forces, drift: Drift, timers: Timers) -> None: ...
