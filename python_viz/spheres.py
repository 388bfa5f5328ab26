"""Paint shaded spheres into an image: every pixel of every sphere is lit, and the nearest one wins (a z-buffer in numpy).

32 000 spheres take about a second, and radii are exact where a scatter plot only has marker sizes in points.
"""

import numpy as np

SAMPLES = 3  # an output pixel is the mean of SAMPLES x SAMPLES painted ones, which makes edges smooth
LIGHT = np.array([-0.42, 0.55, 0.72])  # towards the lamp; x right, y up, z to the viewer
HALFWAY = LIGHT / np.linalg.norm(LIGHT) + [0, 0, 1]
HALFWAY /= np.linalg.norm(HALFWAY)  # a surface facing this way mirrors the lamp into the eye
HALF = np.float32(0.5)  # from the corner of a pixel to its middle
FRAGMENTS = 300_000  # painted at once: few enough for the cache


def paint_spheres(
    center: np.ndarray, radius: np.ndarray, depth: np.ndarray, thickness: np.ndarray,
    rgb: np.ndarray, outlined: np.ndarray, width: int, height: int,
) -> np.ndarray:  # fmt: skip
    """Return an RGBA image (height, width, 4), transparent where no sphere is; row 0 is the bottom.

    `center` (N, 2) and `radius` (N,) are in pixels; `depth` is the distance of the centres from the viewer and `thickness`
    the radius in the same unit. `outlined` spheres get a dark rim.
    """
    wide, high = width * SAMPLES, height * SAMPLES
    image: np.ndarray = np.zeros((high * wide, 4), np.float32)
    nearest = np.full(high * wide, np.inf, np.float32)
    center, radius, depth, thickness = (a.astype(np.float32) for a in (center * SAMPLES, radius * SAMPLES, depth, thickness))
    reach = np.ceil(radius).astype(int)
    for size in np.unique(reach)[::-1]:  # large ones first: they hide most, and what is hidden costs little
        steps = np.arange(-size, size + 1)
        right, up = (grid.ravel() for grid in np.meshgrid(steps, steps))
        same = np.flatnonzero(reach == size)
        same = same[np.argsort(depth[same], kind="stable")]
        for some in np.array_split(same, 1 + len(same) * len(right) // FRAGMENTS):
            column = np.floor(center[some, 0]).astype(int)[:, None] + right
            row = np.floor(center[some, 1]).astype(int)[:, None] + up
            x = (column + HALF - center[some, 0, None]) / radius[some, None]
            y = (row + HALF - center[some, 1, None]) / radius[some, None]
            square = 1 - x * x - y * y
            inside = (square >= 0) & (column >= 0) & (column < wide) & (row >= 0) & (row < high)
            sphere = some[np.nonzero(inside)[0]]
            x, y, z, pixel = x[inside], y[inside], np.sqrt(square[inside]), row[inside] * wide + column[inside]
            distance = depth[sphere] - thickness[sphere] * z
            order = np.flatnonzero(distance < nearest[pixel])
            order = order[np.argsort(-distance[order], kind="stable")]  # far to near: of two writes to a pixel the last stays
            front, sphere = pixel[order], sphere[order]
            nearest[front] = distance[order]
            normal = np.stack([x, y, z], axis=1)[order]
            image[front, :3] = shade(normal, rgb[sphere], outlined[sphere], radius[sphere])
            image[front, 3] = 1
    image = image.reshape(height, SAMPLES, width, SAMPLES, 4).mean(axis=(1, 3))
    image[..., :3] /= np.maximum(image[..., 3:], 1e-6)
    return image.clip(0, 1)


def shade(normal: np.ndarray, rgb: np.ndarray, outlined: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Colour of points on spheres: ambient and diffuse light, a darker limb, a small highlight (Blinn-Phong)."""
    lit = (0.48 + 0.62 * np.clip(normal @ (LIGHT / np.linalg.norm(LIGHT)), 0, None)) * normal[:, 2] ** 0.3
    strength = np.clip(radius / (6 * SAMPLES), 0.4, 1)  # dots of a few pixels keep the colour of the colour bar
    glint = 0.5 * strength * np.clip(normal @ HALFWAY, 0, None) ** 40
    color: np.ndarray = rgb * (1 + strength * (lit - 1))[:, None]
    color += (1 - np.clip(color, 0, 1)) * glint[:, None]
    rim = np.hypot(normal[:, 0], normal[:, 1]) > 1 - np.maximum(0.12, 1.5 * SAMPLES / radius)
    color[rim & outlined] = 0.05
    return color
