"""A symplectic integrator of order four."""

from __future__ import annotations

from particles_mpi.integrators.integrator import Drift, Forces
from particles_mpi.kernels.motion import kick
from particles_mpi.particles import Particles
from particles_mpi.timers import Timers


class Order4:
    """SRKN_6^b of S. Blanes and P. C. Moan, J. Comput. Appl. Math. 142, 313 (2002): fourth order, six forces a step.

    Kicks and drifts by turns, symmetric and symplectic, for forces that do not depend on velocities. One drift goes back in
    time, so nothing may happen on the way.
    """

    B = (0.0829844064174052, 0.396309801498368, -0.0390563049223486)
    A = (0.245298957184271, 0.604872665711080)
    KICKS = (*B, 1.0 - 2.0 * sum(B), *B[::-1])
    DRIFTS = (*A, 0.5 - sum(A), 0.5 - sum(A), *A[::-1])

    def advance(self, particles: Particles, h: float, forces: Forces, drift: Drift, timers: Timers) -> None:
        """Seven kicks, six drifts between them."""
        for stage, weight in enumerate(self.KICKS):
            if stage:
                drift(self.DRIFTS[stage - 1] * h)
            with timers("forces"):
                a = forces()
            with timers("kick"):
                if a is not None:
                    kick(particles.velocity, a, weight * h)
