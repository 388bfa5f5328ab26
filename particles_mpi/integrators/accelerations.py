"""The sum of all forces, kept as long as it holds."""

from __future__ import annotations

from collections import Counter

import numpy as np

from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Array, Particles, places_of
from particles_mpi.scene.effect import Force


class Accelerations:
    """The accelerations of this rank's particles by the `forces` of a scene, by name; `calls` counts how often each is asked.

    total (n, d): those of the last sum, or None; g (d,): the sum of those that are the same for all particles; `done`:
    interactions that were computed by forces that are no longer there.
    """

    def __init__(self, forces: dict[str, Force], ranks: Communicator, dimension: int, calls: Counter[str], done: int):
        self.forces, self.ranks, self.calls, self.done = forces, ranks, calls, done
        self.g: Array = np.zeros(dimension)
        self.total: Array | None = None
        self.known: tuple[int, ...] = ()  # version, edition and fingerprint of the rows that `total` belongs to
        self.look_at_forces()

    def look_at_forces(self) -> None:
        """What follows from the forces as they are now."""
        self.place_dependent = any(force.place_dependent for force in self.forces.values())
        self.collective = any(force.collective for force in self.forces.values())
        self.g[:] = sum((force.g for force in self.forces.values() if force.g is not None), np.zeros_like(self.g))

    def replace(self, name: str, force: Force) -> None:
        """Another force in the place of one."""
        self.done += self.forces[name].interactions
        self.forces[name] = force
        self.look_at_forces()

    def sum(self, p: Particles) -> Array | None:
        """Accelerations (n, d) at the present positions, or None without forces; summed anew if anyone moved. Collective."""
        if not self.forces:
            return None
        known = places_of(p) if self.place_dependent else (p.version, p.edition)
        same = known == self.known
        if self.collective:  # what one rank must sum anew, all do
            same = bool(self.ranks.allreduce_min(float(same))[0])
        if same:
            return self.total
        a = np.zeros_like(p.velocity)
        for name, force in self.forces.items():
            force.add(p, a)
            self.calls[name] += 1
        a[p.fixed != 0] = 0.0
        self.total, self.known = a, known
        return a

    def potentials(self, p: Particles) -> dict[str, Array]:
        """Potential energies (n,) by force, of those that have one. Collective."""
        found = {name: force.potential(p) for name, force in self.forces.items()}
        return {name: energy for name, energy in found.items() if energy is not None}

    @property
    def interactions(self) -> int:
        """Pairs, or what a tree puts in their place, that forces have computed so far."""
        return self.done + sum(force.interactions for force in self.forces.values())
