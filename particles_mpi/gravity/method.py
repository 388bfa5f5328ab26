"""The choice of direct sum or tree, and of the opening angle: formulas for cost and error, fitted to measurements.

The error is the median relative error of the acceleration, measured for Plummer spheres and uniform cubes of 1000 to a million
particles with angles from 0.3 to 1; the formula follows the larger of the two, within a factor of two up to an angle of 0.7.
"""

from dataclasses import dataclass

PAIR_NS = 0.6  # ns for a pair in the direct sum
BUILD_NS, NEAREST = 600.0, 0.25  # ns a particle for keys, cells and their nearest neighbours; and most for each of all particles
FAR_NS = {"quadrupole": 130.0, "monopole": 110.0}  # ns a particle for all that is not near, at an opening angle of 1
STEEP = 2.5  # the power of 1/angle by which that grows
ERROR, SLOPE = 6e-3, 3.5  # error = ERROR * angle^SLOPE
SMALLEST_ANGLE = 0.1  # opening angle below which a tree is of no use
TREES = (1, 2, 3)  # dimensions in which there is a tree


@dataclass(frozen=True)
class Choice:
    """`angle`: opening angle of the tree, None for the direct sum; `cost`: ns a particle; `words`: for the plan."""

    angle: float | None
    cost: float
    words: str


def choose(method: str, angle: float, accuracy: float, dimension: int, total: int, multipole: str = "quadrupole") -> Choice:
    """Return what `method` means for `total` particles; "auto": the cheaper one with an error of at most `accuracy`."""
    direct = PAIR_NS * total
    if method == "direct":
        return Choice(None, direct, "direct sum")
    if method == "auto":
        angle = min((accuracy / ERROR) ** (1.0 / SLOPE), 1.0)
    tree = tree_cost(angle, total, multipole)
    if method == "tree":
        return Choice(angle, tree, f"tree, opening angle {angle:.3g}" + (", monopoles" if multipole == "monopole" else ""))
    if dimension not in TREES or angle < SMALLEST_ANGLE or direct <= tree:
        why = "no more work than a tree" if dimension in TREES else f"there is no tree in dimension {dimension}"
        return Choice(None, direct, f"auto: direct sum, {why}")
    words = (
        f"tree, opening angle {angle:.2g} for a median error of {accuracy:.1g}; direct sum: {direct / tree:.2g} times the work"
    )
    return Choice(angle, tree, f"auto: {words}")


def tree_cost(angle: float, total: int, multipole: str) -> float:
    """What the tree costs, ns a particle: in proportion to `total` while that is small, then by the angle alone."""
    return BUILD_NS + min(FAR_NS[multipole] * angle**-STEEP, NEAREST * total)
