"""How wrong a run is, against a reference that is far better; and the smallest error that can be measured.

An error is below the resolution limit if it cannot be told from round-off, which grows like a displacement of the start, from the
error of the reference itself, or, where motion is chaotic, from the spread of runs that are equally right.

Names of errors, all relative numbers:
- state: largest distance of any particle from its place in the reference, at the snapshots (up to 16, evenly over the run), over
  the size of the motion
- energy: largest |E - E_true| over |E| of the start; where that is small, or has an arbitrary zero, as under all forces but
  `mutual_gravity`, over the largest kinetic energy, or the largest change of the potential one
- collision rate, wall hits, kinetic energy: of the whole run, over those of the reference; height: over the height of fall
States are compared if a displaced start ends up at nearly the same place; otherwise the other errors are used.
"""

from dataclasses import dataclass, field
from math import nan

import numpy as np

from particles_mpi.errors import SceneError
from particles_mpi.particles import Array
from particles_mpi.study.experiment import Errors
from particles_mpi.study.recommend.runs import STATISTICS, Record, Start

ROUND_OFF = 1e-15  # of places, a step and more
ERROR_NAMES = ("state", "energy", *STATISTICS)


@dataclass
class ErrorMetric:
    """A reference and how errors are measured against it.

    part: of the run that it covers; reference: what it is, for people; growth: factor by which a small displacement of the start
    grows; size: of the motion; limits: the resolution limit of each error, the most telling error first; why: where the limits
    come from; order: of the leapfrog, as seen in the reference; places (snapshots, N, d), energy (snapshots,): of the reference;
    scale: of energies; means: of the observables, if it is an ensemble.
    """

    start: Start
    part: float
    reference: str = ""
    growth: float = nan
    size: float = 1.0
    limits: Errors = field(default_factory=dict)
    why: str = ""
    order: float = nan
    places: Array = field(default_factory=lambda: np.zeros(0))
    energy: Array = field(default_factory=lambda: np.zeros(0))
    scale: float = 0.0
    means: Errors = field(default_factory=dict)

    @property
    def span(self) -> float:
        """The time that the reference covers."""
        return self.part * self.start.duration

    @property
    def snapshots(self) -> int:
        """The number of snapshots of runs over the span."""
        return self.start.snapshots(self.part)

    def errors(self, record: Record) -> Errors:
        """Return the errors of a run over the span."""
        found: Errors = {}
        if "state" in self.limits:
            found["state"] = self.start.apart(record.places, self.places) / self.size
        if "energy" in self.limits:
            wrong = record.energies - record.energies[0] if self.start.conserves else record.energy - self.energy
            found["energy"] = float(np.abs(wrong).max()) / self.scale
        return found | {name: abs(record.observables[name] - mean) / self.scale_of(name) for name, mean in self.means.items()}

    def scale_of(self, name: str) -> float:
        """Return the scale of an observable's error: its own value, or the size of the motion for a height, which has no zero."""
        return abs(self.means[name]) if name != "height" else self.size

    def difference(self, error: str, one: Record, other: Record) -> float:
        """Return how far two runs are apart in any error but `state`, for which `runs.apart_all_along` compares positions."""
        if error == "energy":
            return abs(self.errors(one)[error] - self.errors(other)[error])
        return abs(one.observables[error] - other.observables[error]) / self.scale_of(error)

    def add_energy(self, record: Record) -> None:
        """Take the energies of a good run as the true ones, if there is anything to compare."""
        self.scale = energy_scale(self.start, record.energies, record.kinetic)
        if self.scale > 0.0 and (self.start.forces or self.start.dissipates):
            self.energy = record.energy
            self.limits["energy"] = ROUND_OFF * 10.0

    def share(self, error: str) -> float:
        """Return the share of the tolerance for the measured part: errors of positions grow at least as the time."""
        return self.part if error == "state" else 1.0

    def choose(self, tolerance: float, error: str) -> Errors:
        """Return the errors that a tolerance is for, each with what it may be in the measured part, the most telling one first.

        `error`: the only one; "": all that can be measured so finely. Raises SceneError if it, or the most telling one, cannot.
        """
        first = error or next(iter(self.limits), "")
        if first not in self.limits:
            there = "; ".join(self.limits) or "none"
            raise SceneError(f"--error {error or 'any'}: cannot be measured here ({self.why}); use one of: {there}")
        finest = {name: limit / self.share(name) for name, limit in self.limits.items()}
        if tolerance < finest[first]:
            finer = [f"{name} {limit:.1g}" for name, limit in finest.items() if name != first]
            others = f"; limits with other --error: {', '.join(finer)}" if finer else ""
            below = (
                f"--tolerance {tolerance:g} is below what can be measured here: {first} {finest[first]:.1g} ({self.why}){others}"
            )
            raise SceneError(below)
        return {name: tolerance * self.share(name) for name in ([error] if error else finest) if finest[name] <= tolerance}


def energy_scale(start: Start, energies: Array, kinetic: Array) -> float:
    """Return what errors of the energy are relative to, see above. `energies`, `kinetic` (n,): at moments of a run."""
    first, most = abs(float(energies[0])), max(float(kinetic.max()), float(np.ptp(energies - kinetic)))
    return first if first > 0.01 * most and set(start.forces) <= {"mutual_gravity"} else most
