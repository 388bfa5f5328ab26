"""What stands around the particles of a run: its box, or the extent of its particles, and the walls that are no faces of it.

`paraview_script` fills it into the text of `view_paraview.py`, the script that shows a run in ParaView.
"""

from __future__ import annotations

from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from particles_mpi.particles import Array

FACE_TOLERANCE = 1e-9  # of the diagonal: a plane that is no further from the faces of the box is one of them, or outside


def in_space(values: ArrayLike) -> Array:
    """Vectors of any dimension as (x, y, z): missing coordinates are 0, those past the third are left out."""
    vectors = np.asarray(values, dtype=float)[..., :3]
    return np.concatenate([vectors, np.zeros((*vectors.shape[:-1], 3 - vectors.shape[-1]))], axis=-1)


class Scenery:
    """What stands around the particles of a scene, which is given as tables.

    lower, upper (3,): corners of the box, or where there is none the extent of the particles that is given; periodic (3,); real:
    has the scene a box?; walls: (polygon (m, 3), normal (3,)) of each.
    """

    def __init__(self, scene: dict[str, Any], lower: Array, upper: Array):
        box = scene.get("box")
        self.real, self.periodic = bool(box), np.zeros(3, bool)
        if box:
            lower, upper = in_space(box["lower"]), in_space(box["upper"])
            flags = box.get("periodic") or False
            flags = flags if isinstance(flags, list) else [flags] * len(box["lower"])
            self.periodic[: len(flags)] = flags[:3]
        elif not np.any(upper > lower):  # a single point, or no particle at all
            middle = np.where(np.isfinite(lower), lower, 0.0)
            lower, upper = middle - 1.0, middle + 1.0
        self.lower, self.upper = lower, upper
        options = (scene.get("effects") or {}).get("walls") or {}
        given = (options.get("planes") or []) if options.get("active", True) else []  # what is switched off is not there
        planes = [(in_space(plane["point"]), in_space(plane["normal"])) for plane in given if np.any(in_space(plane["normal"]))]
        self.walls: list[tuple[Array, Array]] = []
        for point, normal in planes:
            corners = section(point, normal, lower, upper)
            for other in planes:
                corners = in_front(corners, *other, FACE_TOLERANCE * float(np.linalg.norm(upper - lower)))
            if len(corners) > 1:
                self.walls.append((corners, normal))


def paraview_script(folder: Path, scene: dict[str, Any]) -> str:
    """The script that shows the run of a scene (as tables) in this folder."""
    around = Scenery(scene, np.zeros(3), np.zeros(3))
    facts = {
        "folder": str(folder.resolve()),
        "box": [around.lower.tolist(), around.upper.tolist()] if around.real else None,
        "walls": [corners.tolist() for corners, _ in around.walls] if around.real else [],
        "planar": scene["dimension"] < 3,
    }
    text = (Path(__file__).parent / "view_paraview.py").read_text(encoding="utf-8")
    return text.replace("RUN: dict = {}", f"RUN = {facts!r}")


def in_front(corners: Array, point: Array, normal: Array, close: float) -> Array:
    """What of a polygon (m, 3) is on the free side of a plane, or at most `close` behind it."""
    height = (corners - point) @ normal / np.linalg.norm(normal)
    kept = []
    for k in range(len(corners)):  # from the corner before to this one
        if min(height[k - 1], height[k]) < -close and max(height[k - 1], height[k]) > close:
            kept.append(corners[k - 1] + (corners[k] - corners[k - 1]) * height[k - 1] / (height[k - 1] - height[k]))
        if height[k] >= -close:
            kept.append(corners[k])
    return np.array(kept).reshape(-1, 3)


def section(point: Array, normal: Array, lower: Array, upper: Array) -> Array:
    """The corners (m, 3), in order, of the polygon in which a plane cuts a box; none if it only touches the box."""
    corners = np.array(list(product(*zip(lower, upper, strict=True))))
    height = (corners - point) @ normal / np.linalg.norm(normal)
    if np.all(height > -FACE_TOLERANCE * np.linalg.norm(upper - lower)):
        return np.zeros((0, 3))
    cuts = [a + (b - a) * s / (s - t) for (a, s), (b, t) in combinations(zip(corners, height, strict=True), 2)
            if np.count_nonzero(a != b) == 1 and s * t <= 0 and s != t]  # fmt: skip
    if not cuts:
        return np.zeros((0, 3))
    cut = np.unique(np.array(cuts), axis=0)
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    around = cut - cut.mean(axis=0)
    ordered: Array = cut[np.argsort(np.arctan2(around @ first, around @ np.cross(normal, first)))]
    return ordered
