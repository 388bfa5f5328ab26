"""Whether the energy of a run has changed though it should not, by the rows of its diagnostics, and the remark that says so."""

from dataclasses import dataclass
from math import inf, isnan, nan
from typing import Any

NOTICEABLE = 0.01  # change of the energy, where there should be none, over the largest kinetic energy, that is printed
ROUND_OFF = 1e-9  # of the total energy, and more: what is at rest has no other kinetic energy
ADAPTIVE = ', or time.integrator = "adaptive"'


@dataclass
class Energies:
    """Energies in the diagnostics of a run: the `first` and `last` total, the largest kinetic one, the range of potentials."""

    first: float = nan
    last: float = nan
    kinetic: float = 0.0
    lowest: float = inf
    highest: float = -inf

    def add(self, total: float, kinetic: float) -> None:
        """Take note of a row."""
        self.first = total if isnan(self.first) else self.first
        self.last, self.kinetic = total, max(self.kinetic, kinetic)
        self.lowest, self.highest = min(self.lowest, total - kinetic), max(self.highest, total - kinetic)

    def remarks(self, effects: Any) -> list[str]:
        """Return a line if the energy changed, or rose where there are losses, by more than NOTICEABLE.

        This is relative to the largest kinetic energy, or to the change of the potential energy, whose zero is arbitrary.
        """
        change = self.last - self.first
        takes, largest = not effects.conserves_energy, max(self.kinetic, self.highest - self.lowest)
        least = max(NOTICEABLE * largest, ROUND_OFF * max(abs(self.first), abs(self.last)))
        if not effects.gives_no_energy or not (change if takes else abs(change)) > least:
            return []
        better = "" if effects.integrator == "adaptive" or effects.pairs or effects.walls or takes else ADAPTIVE
        why = "no effect adds any" if takes else "no effect adds or takes any"
        return [f"total energy: changed from {self.first:.4g} to {self.last:.4g}, though {why}: shorten time.step{better}"]
