"""The built-in experiments: what accuracy costs in time, problem by problem, each against a solution that is known."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from particles_mpi.study.measuring.experiment import Experiment, Lab

CHAPTERS = {"A": "orbits", "B": "encounters", "C": "fluid", "D": "tree", "F": "softening", "G": "losses", "H": "effects"}


def experiments(keys: str = "") -> dict[str, Callable[[Lab], list[Experiment]]]:
    """What each letter measures, for the letters of `keys` or for all; `measure(lab)` of a chapter gives its experiments."""
    chosen = [key for key in CHAPTERS if not keys or key in keys.upper()]
    return {key: import_module(f"particles_mpi.study.accuracy.{CHAPTERS[key]}").measure for key in chosen}
