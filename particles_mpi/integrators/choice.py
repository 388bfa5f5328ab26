"""The integrator that a scene names."""

from __future__ import annotations

from typing import Any

from particles_mpi.integrators.integrator import Integrator
from particles_mpi.integrators.leapfrog import Leapfrog
from particles_mpi.integrators.velocity_flow import Kick
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.scene.schema import Scene


def integrator_of(scene: Scene, ranks: Communicator, kick: Kick, rest: Any) -> Integrator:
    """The integrator of a scene; `rest` keeps contacts that last, if any do. One that is not named is not imported."""
    name = scene.time.integrator
    if name == "order4":
        from particles_mpi.integrators.order4 import Order4

        return Order4()
    if name == "adaptive":
        from particles_mpi.integrators.gauss_radau import TOLERANCE, Adaptive

        return Adaptive(ranks, scene.time.tolerance or TOLERANCE)
    if name == "taylor":
        from particles_mpi.integrators.taylor import Taylor

        return Taylor(kick)
    return Leapfrog(kick, rest)
