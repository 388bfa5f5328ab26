"""A page that shows a run: one HTML file with the frames, the curves and the plan in it, that needs no network.

`page.html` is its skeleton, `spheres.js` draws spheres by WebGL; `frames.js`, `stage.js`, `charts.js` and `controls.js` are what
the user sees and does. What they show is put together here: a header as JSON, and of each frame the columns as one block of
bytes, in base64.
"""

from __future__ import annotations

import json
import re
from base64 import b64encode
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from particles_mpi.errors import SceneError
from particles_mpi.output.replacing import replace_text
from particles_mpi.particles import Array
from particles_mpi.results.curves import curves
from particles_mpi.results.frame import one_number_each
from particles_mpi.results.scenery import Scenery, in_space

HERE = Path(__file__).parent
BASE64 = 4 / 3  # bytes of text for a byte
PAGE_BYTES = 50_000_000  # bytes of a page
FOR_THE_REST = 2_000_000  # bytes of it that are no frames
LEAST_FRAMES = 60  # that are kept before particles are left out
TOP_PERCENTILE = 99.5  # percentile of a changing quantity that has the last colour: a few fast ones would make all others alike
COLOUR_MAPS = ("viridis", "cividis", "plasma")  # of colours: brightness rises along them, for those who see few colours too
DARKEST = 0.15  # of a map: what is darker is hard to see
MOST_TRAILS = 60  # particles at most that have trails


class Choice(NamedTuple):
    """What a page shows: numbers of frames; of how many particles one; kind of numbers (f4, u2); what is left out."""

    frames: list[int]
    every: int
    kind: str
    notes: list[str]


class PageColumn(NamedTuple):
    """A quantity of each particle in the page: a stored number n of this `type` means offset + scale * n.

    constant: stored once, for all frames; low, high: values of the first and the last colour, or None where no colour tells it.
    """

    name: str
    type: str
    constant: bool
    offset: Any = 0.0
    scale: Any = 1.0
    low: float | None = None
    high: float | None = None


def write_page(run: Any, path: Path | None = None) -> Path:
    """Write the page of a `Run`, as view.html into its folder if no path is given. Raises SceneError for one without frames."""
    path = path or run.folder / "view.html"
    text = page(run)
    try:
        replace_text(path, text)
    except OSError as error:
        raise SceneError(f"{path}: cannot be written ({error.strerror})") from None
    return path


def page(run: Any, largest: int = PAGE_BYTES) -> str:
    """The page of a run as text. `run`: a `Run`, or what has its properties and frames."""
    return assemble(run, largest)[0]


def assemble(run: Any, largest: int, live: bool = False) -> tuple[str, list[PageColumn], int]:
    """(page, columns, of how many particles one is in it). live: more frames will be sent to it, in which anything may change."""
    counts = [len(frame) for frame in run]
    if not counts:
        raise SceneError(f"{run.folder}: no frame yet")
    known = len(quantities(run[0]))
    moving = known if live else changing(run)
    choice = choose(counts, moving, (largest - FOR_THE_REST) / BASE64, known - moving)
    columns, lower, upper = survey(run, choice, live)
    header = {**described(run, choice), **surroundings(run, lower, upper), "columns": [c._asdict() for c in columns]}
    constant = pack(run[choice.frames[0]], [c for c in columns if c.constant], choice.every)
    changed = [c for c in columns if not c.constant]
    blocks = [pack(run[k], changed, choice.every) for k in choice.frames]
    parts = {path.name: path.read_text(encoding="utf-8") for path in HERE.glob("*.js")}
    parts["title"] = run.title.replace("&", "&amp;").replace("<", "&lt;")
    parts["header"] = json.dumps(header | {"constant": constant}, allow_nan=False).replace("</", "<\\/")
    parts["frames"] = json.dumps(blocks)
    text = re.sub(r"/\* (\S+) \*/", lambda found: parts[found[1]], (HERE / "page.html").read_text(encoding="utf-8"))
    return text, columns, choice.every


def changing(run: Any) -> int:
    """How many numbers of a particle, besides its position, are not the same in the first frame and the last; at least one."""
    first, last = quantities(run[0]), quantities(run[-1])
    return max(1, sum(name not in last or not np.array_equal(values, last[name]) for name, values in first.items()))


def choose(counts: list[int], quantities: int, room: float, constant: int = 0) -> Choice:
    """What of frames with these counts of particles goes into `room` bytes, if each particle has so many `quantities`, and
    besides so many that are `constant`: numbers of four bytes, which are there once.

    Numbers of two bytes come before fewer frames, and these before fewer particles.
    """
    frames, notes = list(range(len(counts))), list[str]()
    rows, once = sum(counts), 4 * constant * max(counts)
    if 4 * (3 + quantities) * rows + once <= room:
        return Choice(frames, 1, "f4", notes)
    row_bytes = 2 * (3 + quantities)
    notes.append("positions and colours are rounded to 1/65535 of their range")
    stride = min(int(-(-row_bytes * rows // max(room - once, 1.0))), max(1, len(counts) // LEAST_FRAMES))
    if stride > 1:
        frames = frames[::stride]
        notes.append(f"one frame in {stride} is shown: {len(frames)} of {len(counts)}")
    rows = sum(counts[k] for k in frames)
    every = max(1, int(-(-(row_bytes * rows + once) // room)))
    if every > 1:
        notes.append(f"one particle in {every} is shown")
    return Choice(frames, every, "u2", notes)


def quantities(frame: Any) -> dict[str, Array]:
    """What is known of each particle as one number, (N,) each: id, fields, lengths of vectors; speed in place of velocity.

    Vectors of one component, such as spins in the plane, have a sign; lengths of others are called "|spin|".
    """
    found = {"id": frame.id}
    for name in frame.fields:
        if name in ("position", "id", "velocity"):
            continue
        values = frame[name] if name != "fixed" else frame[name].astype(float)
        length = values.ndim > 1 and values.shape[1:] != (1,)
        found[f"|{name}|" if length else name] = values if values.ndim == 1 else one_number_each(values)
    return found | {"speed": frame.speed}


def survey(run: Any, choice: Choice, live: bool = False) -> tuple[list[PageColumn], Array, Array]:
    """(columns, lower, upper): how numbers are stored, their ranges over the frames, and the extent (3,) of the spheres.

    live: more frames are to come, in which anything may change.
    """
    lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
    ranges: dict[str, list[Array]] = {}
    first = quantities(run[choice.frames[0]])
    constant = dict.fromkeys(first, not live)
    for k in choice.frames:
        frame = run[k]
        position, radius = in_space(frame.position), frame.radius[:, None]
        lower = np.minimum(lower, (position - radius).min(axis=0, initial=np.inf))
        upper = np.maximum(upper, (position + radius).max(axis=0, initial=-np.inf))
        now = quantities(frame)
        for name, values in (now | {"energy": 0.5 * frame.mass * frame.speed**2}).items():
            values = values[np.isfinite(values)]
            if len(values):
                low, top, high = values.min(), np.percentile(values, TOP_PERCENTILE), values.max()
                ranges.setdefault(name, []).append(np.array([low, top, high], float))
            if name in constant:
                constant[name] &= np.array_equal(now[name], first[name])
    if not np.all(np.isfinite(lower) & np.isfinite(upper)):
        lower, upper = np.full(3, -1.0), np.ones(3)
    middle, size = 0.5 * (lower + upper), np.maximum(upper - lower, 1e-300)
    if choice.kind == "f4":
        columns = [PageColumn("position", "f4", False, middle.tolist(), [1.0, 1.0, 1.0])]
    else:
        columns = [PageColumn("position", "u2", False, lower.tolist(), (size / 65535).tolist())]
    for name in [*first, "energy"]:  # the last one is computed by the page
        lows, tops, highs = np.array(ranges.get(name, [np.array([0.0, 1.0, 1.0])])).T
        same, low, high = constant.get(name, False), float(lows.min()), float(highs.max())
        others = {"id": "i4" if high < 2**31 else "f8", "fixed": "u1", "energy": ""}
        kind = others.get(name, "f4" if same else choice.kind)
        offset, scale = (low, (high - low) / 65535 or 1.0) if kind == "u2" else (0.0, 1.0)
        shown = (None, None) if name == "fixed" else (low, high if same or name == "id" else float(tops.max()))
        columns.append(PageColumn(name, kind, same or name == "energy", offset, scale, *shown))
    return columns, lower, upper


def pack(frame: Any, columns: list[PageColumn], every: int) -> str:
    """The numbers of these columns in base64: the count of particles, then column after column, each from a multiple of 8 on."""
    kept = frame.id % every == 0
    now = {"position": in_space(frame.position), **quantities(frame)}
    parts = [np.array([int(kept.sum())], "<i8").tobytes()]
    for column in columns:
        if not column.type:
            continue
        values = (now[column.name][kept] - np.array(column.offset)) / np.array(column.scale)
        if column.type[0] in "ui":
            values = np.nan_to_num(values, posinf=0.0, neginf=0.0)
        whole = values.round() if column.type[0] in "ui" else values
        block = whole.astype(f"<{column.type}").tobytes()
        parts.append(block + bytes(-len(block) % 8))
    return b64encode(b"".join(parts)).decode()


def described(run: Any, choice: Choice) -> dict[str, Any]:
    """Title, clock, what the run does, curves, and what the page leaves out."""
    from matplotlib import colormaps  # takes half a second to import

    about, rows = run.about, run.columns
    scene, plan = about.get("scene", {}), about.get("plan", {})
    frames = [run[k] for k in choice.frames]
    notes = list(choice.notes)
    if not run.ended:
        now = f"at t = {frames[-1].time:.6g}, when this page was made"
        notes.insert(0, f"The run had been stopped, or was still going on, {now}; make the page again to see more")
    if run.dimension > 3:
        notes.append(f"the first three of {run.dimension} axes are shown")
    facts = [f"{max(len(frame) for frame in frames):_} particles".replace("_", "\u202f"), f"dimension {run.dimension}"]
    if "time" in scene:
        facts += [f"step {scene['time']['step']:g}", scene["time"].get("integrator", "leapfrog")]
    if "ranks" in about:
        facts.append(f"{about['ranks']} rank" + "s" * (about["ranks"] != 1))
    running = plan.get("effects") or [{"effect": name, "law": "", "calls": ""} for name in scene.get("effects", {})]
    maps = {name: (colormaps[name](np.linspace(DARKEST, 1, 256))[:, :3] * 255).round().astype(np.uint8) for name in COLOUR_MAPS}
    return {
        "title": run.title,
        "facts": facts,
        "notes": notes,
        "times": [frame.time for frame in frames],
        "numbers": choice.frames,
        "planar": run.dimension < 3,
        "trails": min(len(frames[0]), len(frames[-1])) <= MOST_TRAILS,
        "effects": [[row["effect"], row.get("law", ""), row.get("calls", "")] for row in running],
        "not_run": [row["effect"] for row in plan.get("not_run", [])],
        "curves": curves(rows),
        "maps": {name: b64encode(colors.tobytes()).decode() for name, colors in maps.items()},
    }


def surroundings(run: Any, lower: Array, upper: Array) -> dict[str, Any]:
    """Box and walls; lower, upper: the extent of the spheres."""
    around = Scenery(run.about.get("scene", {}), lower, upper)
    low, high = np.minimum(lower, around.lower), np.maximum(upper, around.upper)  # open walls let spheres out of the box
    return {
        "box": {"lower": around.lower.tolist(), "upper": around.upper.tolist(), "real": around.real},
        "periodic": around.periodic.tolist(),
        "extent": [low.tolist(), high.tolist()],
        "walls": [{"corners": corners.tolist(), "normal": normal.tolist()} for corners, normal in around.walls],
    }
