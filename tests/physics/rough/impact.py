"""Oblique impacts of rough spheres: how fast their surfaces slip before and after, and what was measured.

Before an impact the surfaces at the point of contact approach with the velocity u_n along the normal and slip with u_t across
it. With psi_1 = u_t/|u_n| before and psi_2 = u_t'/|u_n| after it, u_n being that before in both, the law of O. Walton and
R. Braun, J. Rheol. 30, 949 (1986), is two straight lines. For equal spheres, or a sphere and a wall, with I = q m R^2:

    psi_2 = -beta_0 psi_1                                  where the surfaces stick,
    psi_2 = psi_1 - mu (1 + e) (1 + 1/q)                   where they slide:

the impulse mu J_n, J_n = m* (1 + e) |u_n|, changes the slip by mu J_n (1 + 1/q)/m*, m* being the reduced mass. Of the two the
smaller impulse acts, which leaves the larger psi_2. S. Foerster and others measured both lines: Phys. Fluids 6, 1108 (1994).
"""

import csv
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

SOLID = {2: 0.5, 3: 0.4}  # q = I/(m R^2) of a disc in the plane and of a sphere in space


class Surface(NamedTuple):
    """Normal restitution e, Coulomb's friction mu, tangential restitution beta_0."""

    restitution: float
    friction: float
    tangential: float


def measured() -> dict[str, tuple[Surface, Surface]]:
    """By material, the parameters of reference/impacts.csv and their scatter."""
    text = (Path(__file__).parent / "reference" / "impacts.csv").read_text()
    rows = csv.DictReader(line for line in text.splitlines() if not line.startswith("#"))
    return {
        row["material"]: (
            Surface(*(float(row[key]) for key in ("e", "mu", "beta_0"))),
            Surface(*(float(row[f"{key}_scatter"]) for key in ("e", "mu", "beta_0"))),
        )
        for row in rows
    }


def slip_after(psi: np.ndarray, surface: Surface, inertia: float) -> np.ndarray:
    """psi_2 of psi_1 >= 0 (n,)."""
    sliding = psi - surface.friction * (1.0 + surface.restitution) * (1.0 + 1.0 / inertia)
    return np.maximum(-surface.tangential * psi, sliding)


def slides_from(surface: Surface, inertia: float) -> float:
    """The psi_1 where both lines meet."""
    return surface.friction * (1.0 + surface.restitution) * (1.0 + 1.0 / inertia) / (1.0 + surface.tangential)


def band(psi: np.ndarray, surface: Surface, scatter: Surface, inertia: float) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest psi_2 (n,) that the parameters allow within their scatter.

    psi_2 falls with each parameter wherever it depends on it, so that the corners of their ranges are its extremes.
    """
    corners = product(*((value - s, value + s) for value, s in zip(surface, scatter, strict=True)))
    curves = [slip_after(psi, Surface(*corner), inertia) for corner in corners]
    return np.min(curves, axis=0), np.max(curves, axis=0)
