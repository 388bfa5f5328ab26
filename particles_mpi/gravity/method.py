"""Direct sum or tree, and with which opening angle: what each costs and how accurate it is, fitted to measurements.

Errors are the median over particles of the relative error of the acceleration. Measured for Plummer spheres and uniform cubes
of 1000 to a million particles and angles of 0.3 to 1: the fit is the larger of the two, within a factor of two up to 0.7.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log10

PAIR = 1.2  # ns of a pair in the direct sum
WORK = {"quadrupole": 1.4, "monopole": 1.0}  # ns of a particle on a list of the tree, which a group adds up
BUILD = 400.0  # ns a particle: keys, cells, walks
ERROR, SLOPE = 6e-3, 3.5  # error = ERROR * angle^SLOPE
SMALLEST = 0.1  # opening angle, below which a tree is no use
TREES = (1, 2, 3)  # dimensions that have trees


@dataclass(frozen=True)
class Choice:
    """`angle`: of the tree, or None for the direct sum; `cost`: ns a particle and evaluation; `words`: for the plan."""

    angle: float | None
    cost: float
    words: str


def choose(method: str, angle: float, accuracy: float, dimension: int, total: int, multipole: str = "quadrupole") -> Choice:
    """What `method` means for `total` particles; "auto" takes the cheapest that is as accurate as wanted, with quadrupoles."""
    direct = PAIR * total
    if method == "direct":
        return Choice(None, direct, "direct sum")
    if method == "auto":
        angle = min((accuracy / ERROR) ** (1.0 / SLOPE), 1.0)
    tree = tree_cost(angle, total, multipole)
    if method == "tree":
        return Choice(angle, tree, f"tree, opening angle {angle:.3g}" + (", monopoles" if multipole == "monopole" else ""))
    if dimension not in TREES or angle < SMALLEST or direct <= tree:
        why = "no more work than a tree" if dimension in TREES else f"there is no tree in dimension {dimension}"
        return Choice(None, direct, f"auto: direct sum, {why}")
    words = (
        f"tree, opening angle {angle:.2g} for a median error of {accuracy:.1g}; direct sum: {direct / tree:.2g} times the work"
    )
    return Choice(angle, tree, f"auto: {words}")


def tree_cost(angle: float, total: int, multipole: str) -> float:
    """ns a particle: lists grow with the logarithm of the number of particles, and never beyond all of them."""
    lists = 450.0 + 357.0 * angle**-2.2 * max(log10(max(total, 1)) - 2.8, 0.0)
    return BUILD + WORK[multipole] * min(lists, 450.0 + total)
