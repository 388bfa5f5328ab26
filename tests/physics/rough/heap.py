"""A heap of 2000 spheres on a strip of fixed ones, from which spheres fall off: its start, and the slope that is left.

Lengths are in mean diameters, masses in those of a sphere of that diameter, and gravity is 1, so that the unit of time is
sqrt(diameter / gravity). Axis x runs along the strip and z upwards; along y space is periodic, so that both slopes are planes.
"""

from typing import NamedTuple

import numpy as np

SPACING = 1.12  # of the lattice: more than the largest diameter, 1.1, and twice the largest displacement
COLUMNS = (20, 10, 10)  # free spheres along x, y and z: 2000; below them one layer of fixed ones, 20 x 10
HALF_LENGTH = COLUMNS[0] * SPACING / 2.0
WIDTH = COLUMNS[1] * SPACING  # the period along y
FLOOR = -8.0  # height of the plane that takes what falls off the strip; the strip's centres are at about 0
DENSITY = 6.0 / np.pi  # mass 1 at diameter 1
RESTITUTION = 0.5
UNTIL = 80.0  # when next to nothing moves any more


class Start(NamedTuple):
    """The spheres at the start, at rest and apart from one another, in order of their ids; first those that are fixed."""

    position: np.ndarray  # (N, 3)
    radius: np.ndarray  # (N,)
    fixed: np.ndarray  # (N,) bool


class Slope(NamedTuple):
    """What is left on the strip."""

    angle: float  # degrees: slope of the straight line through the middle of the surface
    by_volume: float  # degrees: slope of the wedge on the same strip that has the same volume under its surface
    spheres: int  # free spheres left on the strip


def start(seed: int) -> Start:
    """A simple cubic lattice of spheres with radii between 0.45 and 0.55, above a strip of fixed spheres of radius 0.5.

    Free spheres are displaced by up to 0.005 along each axis, fixed ones by up to 0.15 up or down, so that the floor is rough.
    The random numbers are those of numpy's RandomState, whose stream never changes.
    """
    random = np.random.RandomState(seed)
    x = (np.arange(COLUMNS[0]) - (COLUMNS[0] - 1) / 2.0) * SPACING
    y = (np.arange(COLUMNS[1]) + 0.5) * SPACING
    z = 1.25 + np.arange(COLUMNS[2]) * SPACING
    strip = np.stack(np.meshgrid(x, y, [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
    free = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    strip[:, 2] += 0.3 * (random.random_sample(len(strip)) - 0.5)
    free += 0.01 * (random.random_sample(free.shape) - 0.5)
    radius = np.concatenate((np.full(len(strip), 0.5), 0.45 + 0.1 * random.random_sample(len(free))))
    return Start(np.concatenate((strip, free)), radius, np.arange(len(radius)) < len(strip))


def surface(position: np.ndarray, radius: np.ndarray, cell: float = 0.28) -> tuple[np.ndarray, np.ndarray]:
    """Height of the uppermost sphere's surface, seen from above, over points of a square grid: mean along y.

    Returns places (M,) along the strip and heights (M,). `position` (N, 3) and `radius` (N,) have the fixed spheres too. Where
    there is no sphere below a point, its height is 0.
    """
    along, across = round(2.0 * HALF_LENGTH / cell), round(WIDTH / cell)
    x = (np.arange(along) + 0.5) * (2.0 * HALF_LENGTH / along) - HALF_LENGTH
    y = (np.arange(across) + 0.5) * (WIDTH / across)
    height = np.zeros((along, across))
    for centre, r in zip(position, radius, strict=True):
        rows = np.flatnonzero(np.abs(x - centre[0]) < r)
        dy = (y - centre[1] + WIDTH / 2.0) % WIDTH - WIDTH / 2.0
        below = r * r - (x[rows] - centre[0])[:, None] ** 2 - dy[None] ** 2
        top = np.where(below > 0.0, centre[2] + np.sqrt(np.maximum(below, 0.0)), 0.0)
        height[rows] = np.maximum(height[rows], top)
    return x, height.mean(axis=1)


def slope(position: np.ndarray, radius: np.ndarray, middle: tuple[float, float] = (0.25, 0.8)) -> Slope:
    """Angle of the heap with these centres (N, 3) and radii (N,).

    The surface is folded about the middle of the strip. The angle is that of the straight line of least squares through the
    heights at distances between `middle` times half the strip's length: without the rounded top, and without the edge, where
    single spheres are missing. The other one is a check: heights are counted from that of the bare strip's mean surface.
    """
    on_strip = (position[:, 2] > -1.0) & (np.abs(position[:, 0]) < HALF_LENGTH)
    x, height = surface(position[on_strip], radius[on_strip])
    distance = np.abs(x) / HALF_LENGTH
    chosen = (distance > middle[0]) & (distance < middle[1])
    gradient = -np.polyfit(distance[chosen] * HALF_LENGTH, height[chosen], 1)[0]
    volume = np.maximum(height - 0.5, 0.0).mean() * 2.0 * HALF_LENGTH
    free = int(on_strip.sum()) - COLUMNS[0] * COLUMNS[1]
    return Slope(*np.degrees(np.arctan((gradient, volume / HALF_LENGTH**2))).tolist(), free)


def scene(seed: int, friction: float, mode: str = "event", step: float = 0.02, until: float = UNTIL) -> dict:
    """The tables of the scene for the program: the same spheres, laws and times as in reference/heap.lammps."""
    spheres = start(seed)
    law = {"restitution": RESTITUTION, "friction": friction}

    def population(chosen: np.ndarray, fixed: bool) -> dict:
        radius = spheres.radius[chosen]
        return {
            "position": spheres.position[chosen].tolist(),
            "radius": radius.tolist(),
            "mass": (DENSITY * np.pi / 6.0 * (2.0 * radius) ** 3).tolist(),
            "fixed": fixed,
        }

    return {
        "dimension": 3,
        "box": {"lower": [-HALF_LENGTH, 0.0, FLOOR], "upper": [HALF_LENGTH, WIDTH, 20.0], "periodic": [False, True, False]},
        "time": {"step": step, "end": until},
        "particles": [population(spheres.fixed, True), population(~spheres.fixed, False)],
        "effects": {
            "uniform_gravity": {"acceleration": [0.0, 0.0, -1.0]},
            "collisions": {"mode": mode, **law},
            "walls": {**law, "planes": [{"point": [0.0, 0.0, FLOOR], "normal": [0.0, 0.0, 1.0]}]},
        },
    }
