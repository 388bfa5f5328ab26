"""What the errors of any scene are measured by: a reference that is far better than what is asked for, and a floor.

The floor is what an error smaller than it does not mean: round-off grows as a displacement of the start does, a reference is
itself only so good, and where motion is chaotic a run is one of many that are all as right (their spread).

Names of errors, all relative numbers:
- state: largest distance of any particle from its place in the reference, at LOOKS moments, over the size of the motion
- energy: largest |E - E_true| over |E| of the start, or over the largest kinetic energy where |E| is below a hundredth of it
- collision rate, wall hits, kinetic energy: of the whole run, over those of the reference; height: over the height of fall
State is compared as long as a displaced start does not end up somewhere else; otherwise the others are.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import nan

import numpy as np

from particles_mpi.particles import Array
from particles_mpi.study.measuring.experiment import Errors
from particles_mpi.study.recommending.starts import Start
from particles_mpi.study.recommending.tracks import Track, apart

ROUND_OFF = 1e-15  # of places, a step and more


@dataclass
class Yardstick:
    """A reference over `span` (time units; `part` of the run). `errors(track)` measures, `floors` say how finely."""

    start: Start
    span: float
    part: float
    kind: str = ""  # "places", "ensemble" or "energy"
    reference: str = ""
    growth: float = nan
    size: float = 1.0
    floors: Errors = field(default_factory=dict)
    why: str = ""  # where the floor comes from
    order: float = nan  # of the leapfrog, as seen in the reference
    seconds: float = 0.0
    places: Array = field(default_factory=lambda: np.zeros(0))
    energy: Array = field(default_factory=lambda: np.zeros(0))
    scale: float = 0.0  # of energies
    means: Errors = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        """Of the errors that this scene has, the most telling first."""
        return list(self.floors)

    def errors(self, track: Track) -> Errors:
        """How wrong a run over the span is."""
        found: Errors = {}
        if "state" in self.floors:
            found["state"] = apart(track.places, self.places, self.start.length) / self.size
        if "energy" in self.floors:
            wrong = track.energies - track.energies[0] if self.start.conserves else track.energy - self.energy
            found["energy"] = float(np.abs(wrong).max()) / self.scale
        for name, value in observables(track).items():
            if name in self.means:
                found[name] = abs(value - self.means[name]) / self.scales[name]
        return found

    @property
    def scales(self) -> Errors:
        """What errors of observables are relative to: themselves, but a height has no zero of its own."""
        return {name: abs(mean) if name != "height" else self.size for name, mean in self.means.items()}

    def compare_energies(self, track: Track) -> None:
        """Take the energies of a good run as the true ones, if there is anything to compare."""
        start, kinetic = abs(float(track.energies[0])), float(track.kinetic.max())
        self.scale = start if start > 0.01 * kinetic else kinetic
        if self.scale > 0.0 and (self.start.forces or self.start.dissipates):
            self.energy = track.energy
            self.floors["energy"] = ROUND_OFF * 10.0


def observables(track: Track) -> Errors:
    """What chaotic motion is judged by."""
    return {
        "collision rate": track.collisions / track.duration,
        "wall hits": track.hits / track.duration,
        "kinetic energy": float(track.kinetic[1:].mean()),
        "height": float(track.heights.mean()),
    }
