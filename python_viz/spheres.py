"""Paint shaded spheres into an image: every pixel of every sphere is lit, and the nearest one wins (a z-buffer).

Radii are exact, while a scatter plot only has marker sizes in points. The loop over pixels is compiled at the first use.
"""

from collections.abc import Callable
from math import floor, sqrt

import numpy as np
from numba import njit

SAMPLES = 3  # an output pixel is the mean of SAMPLES x SAMPLES painted ones, which makes edges smooth
LIGHT = np.array([-0.42, 0.55, 0.72])  # towards the lamp; x right, y up, z to the viewer
LIGHT /= np.linalg.norm(LIGHT)
HALFWAY = LIGHT + np.array([0, 0, 1])
HALFWAY /= np.linalg.norm(HALFWAY)  # a surface facing this way mirrors the lamp into the eye


def compiled(function: Callable[..., None]) -> Callable[..., None]:
    """Compile a function, and keep it if there is a folder for that; else it is compiled anew in each start of a script."""
    try:
        kept: Callable[..., None] = njit(cache=True)(function)
    except RuntimeError:
        kept = njit(function)
    return kept


def paint_spheres(
    center: np.ndarray, radius: np.ndarray, depth: np.ndarray, thickness: np.ndarray,
    rgb: np.ndarray, outlined: np.ndarray, width: int, height: int,
) -> np.ndarray:  # fmt: skip
    """Return an RGBA image (height, width, 4), transparent where no sphere is; row 0 is the bottom.

    `center` (N, 2) and `radius` (N,) are in pixels; `depth` is the distance of the centres from the viewer and `thickness`
    the radius in the same unit. `outlined` spheres get a dark rim.
    """
    image = np.zeros((height, width, 4), np.float32)
    samples = height * SAMPLES, width * SAMPLES
    nearest, sphere = np.full(samples, np.inf, np.float32), np.full(samples, -1, np.int32)
    center, radius = center * SAMPLES, radius * SAMPLES
    _find_nearest(nearest, sphere, center, radius, depth, thickness)
    _shade(image, sphere, center, radius, rgb, outlined)
    return image


@compiled
def _find_nearest(nearest, sphere, center, radius, depth, thickness):  # type: ignore[no-untyped-def]
    """Find which sphere is seen at each sample, and at what distance."""
    high, wide = nearest.shape
    for i in range(len(radius)):
        r, right, up = radius[i], center[i, 0], center[i, 1]
        for row in range(max(0, floor(up - r)), min(high, floor(up + r) + 1)):
            for column in range(max(0, floor(right - r)), min(wide, floor(right + r) + 1)):
                x, y = (column + 0.5 - right) / r, (row + 0.5 - up) / r
                square = 1.0 - x * x - y * y
                if square >= 0.0 and depth[i] - thickness[i] * sqrt(square) < nearest[row, column]:
                    nearest[row, column] = depth[i] - thickness[i] * sqrt(square)
                    sphere[row, column] = i


@compiled
def _shade(image, sphere, center, radius, rgb, outlined):  # type: ignore[no-untyped-def]
    """Return the mean colour of each pixel's samples: ambient and diffuse light, darker limb, small highlight (Blinn-Phong)."""
    for row in range(sphere.shape[0]):
        for column in range(sphere.shape[1]):
            i = sphere[row, column]
            if i < 0:
                continue
            pixel, r = image[row // SAMPLES, column // SAMPLES], radius[i]
            x, y = (column + 0.5 - center[i, 0]) / r, (row + 0.5 - center[i, 1]) / r
            z = sqrt(1.0 - x * x - y * y)
            lit = (0.48 + 0.62 * max(x * LIGHT[0] + y * LIGHT[1] + z * LIGHT[2], 0.0)) * z**0.3
            strength = min(max(r / (6 * SAMPLES), 0.4), 1.0)  # dots of a few pixels keep the colour of the colour bar
            glint = 0.5 * strength * max(x * HALFWAY[0] + y * HALFWAY[1] + z * HALFWAY[2], 0.0) ** 40
            rim = outlined[i] and sqrt(x * x + y * y) > 1.0 - max(0.12, 1.5 * SAMPLES / r)
            for k in range(3):
                color = rgb[i, k] * (1.0 + strength * (lit - 1.0))
                color += (1.0 - min(max(color, 0.0), 1.0)) * glint
                pixel[k] += 0.05 if rim else color
            pixel[3] += 1.0
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            pixel = image[row, column]
            for k in range(3):
                pixel[k] = min(max(pixel[k] / max(pixel[3], 1.0), 0.0), 1.0)
            pixel[3] /= SAMPLES * SAMPLES
