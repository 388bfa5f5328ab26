"""The integrator `adaptive`: it resolves close encounters to round-off, with substeps as long as the present forces allow."""

from collections.abc import Callable

import numpy as np

from particles_mpi.errors import StateError
from particles_mpi.integrators.collocation import END, FORCES, MAXIMA, MOST_BLIND, STUCK, Work, begin, go_on, work_for
from particles_mpi.integrators.radau_tables import radau
from particles_mpi.kernels.geometry import wrap
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.signals import check_signals
from particles_mpi.particles import Array, Particles
from particles_mpi.timers import Timers

TOLERANCE = 1e-9  # of the highest coefficient over the largest acceleration, where a scene gives none


class Adaptive:
    """An integrator of order 15 that chooses the length of its substeps; `substeps` counts those taken."""

    def __init__(
        self, ranks: Communicator, tolerance: float, forces: Callable[[], Array | None], timers: Timers,
        box: tuple[Array, Array, Array] | None = None,
    ):  # fmt: skip
        """`forces`: called for the accelerations (n, d) at the present positions; it returns None if there are no forces.

        `box`: corners (d,), and lengths (d,) of periodic axes, if positions must be put into the box before forces are evaluated.
        """
        self.box = box
        self.ranks, self.sum_forces, self.timers = ranks, forces, timers
        self.tables = radau(tolerance)
        self.substeps = 0

    def advance(self, particles: Particles, h: float, drift: Callable[[float], None]) -> None:
        """Advance by h, in substeps. Each begins with what is known from the last one, but the first with nothing."""
        work = work_for(particles.position.size)
        x, v, force = particles.position.reshape(-1), particles.velocity.reshape(-1), np.empty(0)
        with self.timers("forces"):
            begin(x, h, work)
            need = FORCES
            while need != END:
                check_signals()
                if need == STUCK:
                    raise self.stuck(particles, work)
                if need == MAXIMA:
                    self.reduce(work)
                else:
                    force = self.accelerations(particles).reshape(-1)
                need = go_on(x, v, particles.dimension, force, work, self.tables)
        self.substeps += int(work.progress["substeps"][0])
        drift(0.0)  # what is done at the end of a drift, such as wrapping positions

    def reduce(self, work: Work) -> None:
        """Replace the numbers that decide on the next iteration by their maxima over all ranks. Collective."""
        names = ["noise", "change", "largest", "top"]
        largest = self.ranks.allreduce_max(np.array([work.progress[name][0] for name in names]))
        for name, value in zip(names, largest, strict=True):
            work.progress[name] = value

    def accelerations(self, particles: Particles) -> Array:
        """Accelerations at the present positions, 0 where there are no forces."""
        if self.box:
            wrap(particles.position, *self.box)  # this is safe: `collocation` computes each position again
        a = self.sum_forces()
        return np.zeros_like(particles.position) if a is None else a

    def stuck(self, particles: Particles, work: Work) -> StateError:
        """Return the error about a step that cannot go on. Collective."""
        done, length = float(work.progress["done"][0]), float(work.progress["length"][0])
        x = particles.position
        now = x.copy()
        x += length * particles.velocity  # no force acts between bodies at the same place before they part
        a = self.accelerations(particles)
        x[:] = now
        where, (strongest, apart) = f"time.integrator: {done:.6g} into the step", self.strongest_pull(particles, a)
        if work.progress["blind"][0] > MOST_BLIND:
            furthest = float(self.ranks.allreduce_max(np.array([np.abs(x).max(initial=0.0)]))[0])
            rounded = f"positions of {furthest:.1g} are rounded to {np.spacing(furthest):.1g}"
            return StateError(
                f"{where}, {rounded}, which hides the motion of {strongest}{apart}: move the start nearer to the origin"
            )
        meet = f"{strongest} meet{apart}" if apart else f"{strongest} is pulled too strongly"
        return StateError(
            f"{where}, steps get shorter than {length:.2g}: {meet}; softening helps gravity; other forces must be smooth"
        )

    def strongest_pull(self, particles: Particles, a: Array) -> tuple[str, str]:
        """Return texts: the particle with the largest acceleration and the one nearest to it; their distance. Collective."""
        size, ids = np.abs(a).max(axis=1), particles.id.tolist()
        mine = max(((size[i], -ids[i], particles.position[i]) for i in range(len(ids))), key=lambda one: one[:2], default=None)
        _, pulled, place = max((one for one in self.ranks.allgather(mine) if one), key=lambda one: one[:2])
        apart = np.sqrt(((particles.position - place) ** 2).sum(axis=1)).tolist()
        nearest = min(((distance, other) for distance, other in zip(apart, ids) if other != -pulled), default=None)
        others = [one for one in self.ranks.allgather(nearest) if one]
        if not others:
            return f"particle {-pulled}", ""
        distance, other = min(others)
        first, second = sorted((-pulled, other))
        return f"particles {first} and {second}", f", {distance:.1g} apart"
