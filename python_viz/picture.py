"""The picture of a frame: marbles with true radii in their box. Used by plot_frame.py (one frame) and animate.py (all)."""

from argparse import ArgumentParser
from collections.abc import Callable, Iterable
from itertools import product

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from run_files import finite, spaced
from spheres import paint_spheres

from particles_mpi import Run
from particles_mpi.results.frame import Frame, one_number_each
from particles_mpi.results.scenery import Scenery, in_space

HEADING, LETTER = 13, 0.1  # size of the letters of the heading, and how wide one is, in inches; long titles have smaller ones
LEAST_HEADING = 2.0  # size of letters that still can be drawn, with the fewest pixels per inch
SMALLEST = 1.0  # pixels: smaller marbles are drawn with this radius, and the caption says so
POINT, MANY_POINTS = 6.0, 1000  # pixels: the radius of a point; where there are more than so many, all cover as much as these
LEAST_HIGH = 1.0  # inches of the room for a line
MARGIN = 0.04  # of the extent of the marbles, around it, where the scene has no box
FINEST = 1e-13  # of the largest coordinate: less of it around the marbles could not be told from round-off
LEAST_RANGE = 1e-3  # of the largest value: what differs by less has one colour, and not those of its round-off
HAZE = 0.4  # share of white in the colour of the furthest marbles
SIGNED = "coolwarm"  # the colour map of vectors of one component that have both signs; zero is in its middle
WALLS, LINE = ("#f4f5f7", "#f8f9fa", "#e9ebef"), "#4a5260"
SQUARE = np.array([(0, 0), (0, 1), (1, 1), (1, 0)])
# what --color offers: the values, their label, the colour map, and the percentile of the values that gets its last colour
COLORS: dict[str, tuple[Callable[[Frame], np.ndarray], str, str, float]] = {
    "speed": (lambda frame: frame.speed, "speed", "plasma", 99.5),
    "energy": (lambda frame: 0.5 * frame.mass * frame.speed**2, "kinetic energy of a marble", "viridis", 99.5),
    "mass": (lambda frame: frame.mass, "mass", "cividis", 100),
    "id": (lambda frame: frame.id.astype(float), "id", "viridis", 100),
    "radius": (lambda frame: frame.radius, "radius", "cividis", 100),
}


def color_of(name: str) -> tuple[Callable[[Frame], np.ndarray], str, str, float]:
    """Return an entry of `COLORS`, or one for any other field of the frames: its values, or the lengths of its vectors.

    Vectors of one component, such as spins in the plane, have a sign.
    """

    def values(frame: Frame) -> np.ndarray:
        if name not in frame.fields:
            raise IndexError(f"--color {name}: frame {frame.index} has {', '.join(dict.fromkeys([*COLORS, *frame.fields]))}")
        return one_number_each(frame[name])

    return COLORS.get(name, (values, name, "plasma", 99.5))


def coordinates(low: float, high: float) -> tuple[str, str]:
    """Return the coordinates of the ends of an edge as text, with enough digits to tell them apart."""
    ratio = max(abs(low), abs(high)) / (high - low) if high > low else 1.0
    digits = min(3 + int(np.log10(max(ratio, 1.0))), 16)
    return f"{low:.{digits}g}", f"{high:.{digits}g}"


def add_picture_options(parser: ArgumentParser) -> None:
    offered = f"what the colour shows: {', '.join(COLORS)}, or any field of the frames, such as spin or a column of your effect"
    parser.add_argument("--color", default="speed", metavar="NAME", help=f"{offered} (default: speed)")
    parser.add_argument("--view", type=finite, nargs=2, default=(-60, 20), metavar=("AZIMUTH", "ELEVATION"),
                        help="direction of the viewer, in degrees, for runs in space (default: -60 20)")  # fmt: skip


class Camera:
    """Maps positions to the picture: (u, v) in data units at the centre of the box, distance from the eye, magnification."""

    def __init__(self, lower: np.ndarray, upper: np.ndarray, planar: bool, azimuth: float, elevation: float) -> None:
        a, e = np.radians([azimuth, elevation])
        right = np.array([-np.sin(a), np.cos(a), 0])
        to_eye = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        self.planar = planar
        self.axes = np.eye(3) if planar else np.array([right, np.cross(to_eye, right), to_eye])
        self.center = np.zeros(3) if planar else (lower + upper) / 2
        self.distance = 2.2 * float(np.linalg.norm(upper - lower))
        self.eye = self.center + self.distance * self.axes[2]

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        turned = (points - self.center) @ self.axes.T
        depth = self.distance - turned[:, 2]
        magnify = np.ones(len(points)) if self.planar else self.distance / np.where(depth > 0, depth, np.nan)
        return turned[:, :2] * magnify[:, None], depth, magnify


class Picture:
    """One figure of a run: box, walls, colour bar. `draw(frame)` paints the marbles; view and colours stay the same."""

    def __init__(self, run: Run, frames: Iterable[Frame], color: str, view: tuple[float, float], dpi: int) -> None:
        """`frames` are all that will be drawn: they set the range of the colours, and of space where the scene has no box."""
        self.title, scene = run.title, run.about.get("scene", {})
        self.value, self.label, self.colormap, self.top = color_of(color)
        self.survey(frames)
        around = Scenery(scene, self.lower, self.upper)
        margin = 0.0 if around.real else self.margin(around.lower, around.upper)
        self.lower, self.upper = around.lower - margin, around.upper + margin
        if self.planar:
            self.lower[2] = self.upper[2] = 0
        self.camera = Camera(self.lower, self.upper, self.planar, *view)
        self.make_figure(dpi)
        self.draw_box(around.real, around.periodic)
        for corners, normal in around.walls:
            self.draw_wall(corners, normal)

    def margin(self, lower: np.ndarray, upper: np.ndarray) -> float:
        """Return the room around this extent of the marbles."""
        return max(MARGIN * np.max(upper - lower), FINEST * np.abs([lower, upper]).max())

    def survey(self, frames: Iterable[Frame]) -> None:
        """Find the range of values, the extent of space and the largest radius over the frames."""
        self.planar, self.largest, signed = True, 0.0, False
        ranges = []
        self.lower, self.upper = np.full(3, np.inf), np.full(3, -np.inf)
        for frame in frames:
            values = self.value(frame)
            if self.label in frame.fields and frame[self.label].ndim > 1:
                signed = frame[self.label].shape[1:] == (1,)
                self.label = self.label if signed else f"|{self.label}|"  # the length of a vector
            position = in_space(frame.position)
            good = np.isfinite(position).all(axis=1)
            if good.any():
                radius, position = frame.radius[good, None], position[good]
                self.planar &= not position[:, 2].any()
                self.largest = max(self.largest, radius.max())
                self.lower = np.minimum(self.lower, (position - radius).min(axis=0))
                self.upper = np.maximum(self.upper, (position + radius).max(axis=0))
            values = values[np.isfinite(values)]
            if len(values):
                high, size = (np.percentile(x, self.top, method="higher") for x in (values, np.abs(values)))
                ranges.append((-values.min(), high, values.max(), size))
        below, high, highest, size = np.array(ranges or [(0, 1, 1, 1)]).max(axis=0)
        low = lowest = -below
        if signed and lowest < 0.0 < highest:
            low, high, self.colormap = -size, size, SIGNED
        middle, half = 0.5 * (high + low), 0.5 * (high - low)
        half = max(half, 0.5 * LEAST_RANGE * max(abs(high), abs(low)))
        self.colors = ScalarMappable(Normalize(middle - half, middle + half), self.colormap)
        self.extend = ("neither", "max", "min", "both")[2 * (lowest < low) + (highest > high)]

    def make_figure(self, dpi: int) -> None:
        """Make a figure that fits the box, with room for the colour bar and the caption."""
        corners = self.camera.project(np.array(list(product(*zip(self.lower, self.upper, strict=True)))))[0]
        span = np.ptp(corners, axis=0)
        across, up = (0.02, 0.02) if self.planar else (0.08, 0.055)  # room for the labels of the edges
        room = self.largest + np.array([across, up]) * span.max()
        (left, bottom), (right, top) = corners.min(axis=0) - room, corners.max(axis=0) + room
        aspect = (top - bottom) / (right - left)
        wide = max(4.5, min(8, 7 / aspect))
        high, (margin, foot) = max(LEAST_HIGH, min(7, wide * aspect)), (0.7, 0.9) if self.planar else (0.05, 0.4)
        self.figure = plt.figure(figsize=(wide + margin + 1.2, high + foot + 0.5), dpi=dpi)
        width, height = self.figure.get_size_inches()
        self.axes = self.figure.add_axes((margin / width, foot / height, wide / width, high / height))
        self.axes.grid(False)
        self.axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal", anchor="C")
        self.axes.apply_aspect()
        place = self.axes.get_position()
        tall = max(0.8 * place.height, 0.9 * LEAST_HIGH / height)
        bar = self.figure.add_axes((place.x1 + 0.2 / width, 0.5 * (place.y0 + place.y1 - tall), 0.18 / width, tall))
        shown = self.figure.colorbar(self.colors, cax=bar, label=self.label, extend=self.extend)
        shown.formatter.set_useOffset(False)
        shown.outline.set_visible(False)
        middle = (place.x0 + place.x1) / 2
        self.heading = self.figure.text(
            middle, place.y1 + 0.12 / height, "", ha="center", va="bottom", fontsize=HEADING, parse_math=False
        )
        self.letters = int(2.0 * min(middle, 1.0 - middle) * width / LETTER)
        self.caption = self.figure.text(middle, 0.15 / height, "", ha="center", fontsize=9, color=LINE)
        self.marbles = self.axes.imshow(np.zeros((1, 1, 4)), extent=(left, right, bottom, top), origin="lower", zorder=3)

    def draw_box(self, real: bool, periodic: np.ndarray) -> None:
        """Draw the box (periodic faces dashed, walls behind the marbles filled); without a box, the marbles' extent, dotted."""
        periodic = periodic if real else np.ones(3, bool)
        faces = np.array([self.lower, self.upper])
        front = (self.camera.eye > self.camera.center).astype(int)  # for each axis the side of the box that faces the viewer
        axes = [0, 1] if self.planar else [0, 1, 2]
        for axis in axes:
            others = [k for k in axes if k != axis]
            for sides in product((0, 1), repeat=len(others)):
                edge = faces.copy()
                edge[:, others] = faces[sides, others]
                near = not self.planar and bool(np.all(sides == front[others]))
                style = ":" if not real else "--" if periodic[others].all() else "-"
                self.axes.plot(*self.project(edge).T, color=LINE, lw=0.8, ls=style, zorder=4 if near else 2)
        for wall in [2] if self.planar else [axis for axis in axes if not periodic[axis]]:
            corners = np.insert(SQUARE, wall, 1 - front[wall], axis=1)
            self.axes.fill(*self.project(faces[corners, range(3)]).T, color=WALLS[wall], zorder=0)
        if self.planar:
            self.axes.set(xlabel="x", ylabel="y")
            if self.upper[1] == self.lower[1]:  # a line
                self.axes.set(ylabel="", yticks=[])
            self.axes.tick_params(length=0)
            self.axes.spines[:].set_visible(False)
        else:
            self.axes.set_axis_off()
            verticals = [(s, t, 0) for s, t in product((0, 1), repeat=2)]
            leftmost = min(verticals, key=lambda sides: self.project(faces[[sides], range(3)])[0, 0])
            for axis, sides in enumerate([(0, front[1], 0), (front[0], 0, 0), leftmost]):
                self.label_edge(faces, axis, sides)

    def label_edge(self, faces: np.ndarray, axis: int, sides: tuple[int, ...]) -> None:
        """Write the name of the axis and the coordinates of its ends outside one edge of the box."""
        edge = faces[sides, range(3)] * np.ones((2, 1))
        edge[:, axis] = faces[:, axis]
        start, end = ends = self.project(edge)
        out = np.array([start[1] - end[1], end[0] - start[0]])
        out *= (self.largest + 0.035 * np.ptp(self.axes.get_xlim())) / max(np.linalg.norm(out), 1e-300)
        out *= np.sign(out @ (ends.mean(axis=0) - self.project(self.camera.center[None])[0])) or 1
        first, last = coordinates(*faces[:, axis])
        inset = 0 if axis == 2 else 0.04  # the numbers of x and y meet at one corner
        for along, text, size in [(inset, first, 9), (0.5, "xyz"[axis], 12), (1 - inset, last, 9)]:
            x, y = start + along * (end - start) + out
            self.axes.text(x, y, text, ha="center", va="center", color=LINE, fontsize=size)

    def draw_wall(self, corners: np.ndarray, normal: np.ndarray) -> None:
        """Draw a wall that is not a face of the box, in grey; in front of the marbles if the viewer is behind it."""
        before = (self.camera.eye - corners[0]) @ normal < 0 and not self.planar
        self.axes.fill(*self.project(corners).T, facecolor="#9aa3b080", edgecolor=LINE, lw=1.2, zorder=4 if before else 2)

    def project(self, points: np.ndarray) -> np.ndarray:
        return self.camera.project(points)[0]

    def draw(self, frame: Frame) -> None:
        """Paint the marbles of a frame; those outside the picture, or at nan, are counted in the caption."""
        place = self.axes.get_window_extent()
        width, height = round(place.width), round(place.height)
        left, right, bottom, _ = self.marbles.get_extent()
        pixel = (right - left) / width
        uv, depth, magnify = self.camera.project(in_space(frame.position))
        center, radius = (uv - [left, bottom]) / pixel, frame.radius * magnify / pixel
        seen = np.all((center > -radius[:, None]) & (center < [width, height] + radius[:, None]), axis=1)
        point = min(max(POINT * (MANY_POINTS / max(len(seen), 1)) ** 0.5, SMALLEST), POINT)
        least = np.where(frame.radius > 0, SMALLEST, point)
        points = int(np.count_nonzero(seen & (frame.radius == 0)))
        small = int(np.count_nonzero(radius[seen] < SMALLEST)) - points
        rgb = self.colors.to_rgba(self.value(frame))[:, :3]
        if not self.planar:
            half = np.linalg.norm(self.upper - self.lower) / 2
            far = np.clip((depth - self.camera.distance + half) / (2 * half), 0, 1)[:, None]
            rgb = rgb + (1 - rgb) * HAZE * far
        self.marbles.set_data(paint_spheres(center[seen], np.maximum(radius, least)[seen], depth[seen], frame.radius[seen],
                                            rgb[seen], frame.fixed[seen] != 0, width, height))  # fmt: skip
        heading = f"{self.title} · t = {frame.time:.6g} · frame {frame.index}"
        self.heading.set(text=heading, fontsize=max(LEAST_HEADING, HEADING * min(1.0, self.letters / len(heading))))
        missing, fixed = len(seen) - int(seen.sum()), int(frame.fixed.sum())
        notes = [f"{spaced(len(seen))} marble" + "s" * (len(seen) != 1)]
        notes += ["true radii"] if points < len(seen) else []
        notes += [f"three of {d} axes: spheres may seem to overlap"] if (d := frame.position.shape[1]) > 3 else []
        notes += [f"{spaced(points)} of them points, drawn with radius {point:.2g} pixels"] if points else []
        notes += [f"{spaced(small)} of them too small to see, drawn with radius {SMALLEST:g} pixel"] if small else []
        notes += [f"{fixed} fixed (dark rim)"] if fixed else []
        notes += [f"{missing} not in the picture"] if missing else []
        self.caption.set_text(" · ".join(notes))
