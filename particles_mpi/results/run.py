"""A run read back: `Run("out/marbles")` has its frames, diagnostics and scene, also while it is going on."""

from __future__ import annotations

import csv
import json
from contextlib import suppress
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, overload

import numpy as np

from particles_mpi.errors import SceneError
from particles_mpi.output.read_frames import FrameReader
from particles_mpi.particles import BUILT_IN, FULL, Array
from particles_mpi.results.frame import Frame

ROTATION = "spin"  # the field with a component for each plane of two axes
FILES = ("trajectory.vtkhdf", "diagnostics.csv", "run.json")


class Run:
    """The folder of a run: `len(run)` frames at `run.times`; `run[k]` is a `Frame` (k < 0 from the end), `run[a:b]` a list.

    No file is kept open, and each access reads again: of a run that is still going on it sees the frames and rows that are whole.
    Raises SceneError, one line, for what does not exist, and IndexError for a frame that does not.
    """

    def __init__(self, folder: str | Path):
        self.folder = Path(folder)
        if not any((self.folder / name).is_file() for name in FILES):
            raise SceneError(f"{self.folder}: {'holds no run' if self.folder.exists() else 'no such folder'}")
        self.frames = FrameReader(self.folder / FILES[0])

    @property
    def times(self) -> Array:
        """(S,): the time of each frame."""
        return self.frames.index().times

    def __len__(self) -> int:
        return len(self.times)

    @overload
    def __getitem__(self, k: int) -> Frame: ...

    @overload
    def __getitem__(self, k: slice) -> list[Frame]: ...

    def __getitem__(self, k: int | slice) -> Frame | list[Frame]:
        count = len(self)
        if isinstance(k, slice):
            return [self[i] for i in range(*k.indices(count))]
        if not isinstance(k, int | np.integer):
            raise TypeError(f"{self.folder}: {k!r} is neither the number of a frame nor a slice")
        if not -count <= k < count:
            there = f"frames 0 to {count - 1}" if count else "no frame yet"
            raise IndexError(f"{self.folder}: no frame {k}: the run has {there}")
        index, k = self.frames.index(), k % count
        fields = ("position", *(name for name in index.fields if name != "position" and not name.endswith(FULL)))
        place = float(index.times[k]), int(index.steps[k]), int(index.counts[k])
        return Frame(k, *place, fields, partial(self._column, k))

    def _column(self, k: int, name: str) -> Array:
        """A field as the simulation has it: (N,), or with components (N, .), those of a vector being d.

        In files vectors have three components, and beyond three axes a second column with all of them; a spin in the plane is
        the third of three components. An orientation in the plane is an angle, (N,).
        """
        stored = self.frames.index().fields
        whole = name if name == "position" else name + FULL
        shown = "Points" if name == "position" else name
        values = self.frames.column(whole if whole in stored else shown, k)
        if values.ndim == 1 or self.dimension > 2:
            return values
        return np.ascontiguousarray(values[:, 2:] if self._turns(name) else values[:, : self.dimension])

    def _turns(self, name: str) -> bool:
        """Has a field a component for each plane of two axes? A column of an effect's file is as the file says."""
        if name == ROTATION or name in BUILT_IN:
            return name == ROTATION
        with suppress(SceneError):
            return name in (columns := self.scene.columns) and columns[name].rotation
        return False

    def view(self) -> Any:
        """The page of `particles-mpi view` in a notebook: the last expression of a cell is shown."""
        from particles_mpi.results.notebook import Shown

        return Shown(self)

    @property
    def about(self) -> dict[str, Any]:
        """The content of run.json: scene and plan and, once the run has ended, its timers and counts; {} if there is none."""
        path = self.folder / "run.json"
        try:
            about: dict[str, Any] = json.loads(path.read_text()) if path.is_file() else {}
        except (OSError, ValueError) as error:
            raise SceneError(f"{path}: cannot be read: {error}") from None
        return about

    @property
    def ended(self) -> bool:
        """Has the run reached its end? If not, it is going on, was stopped, or killed."""
        about = self.about
        return bool(about.get("ended", "timers" in about))  # earlier versions did not write it

    @property
    def dimension(self) -> int:
        """d, or 3 if there is no run.json: that is what the frames have."""
        return int(self.about.get("scene", {}).get("dimension", 3))

    @property
    def periodic_length(self) -> Array:
        """(d,): length of the box along periodic axes, 0 along the others."""
        box = self.about.get("scene", {}).get("box")
        return np.subtract(box["upper"], box["lower"]) * (box.get("periodic") or False) if box else np.zeros(self.dimension)

    @property
    def title(self) -> str:
        """The title of the scene, else the name of the folder."""
        return self.about.get("scene", {}).get("title") or self.folder.resolve().name

    @property
    def scene(self) -> Any:
        """The `Scene` as it was run."""
        from particles_mpi.scene.schema import Scene

        if "scene" not in (about := self.about):
            raise SceneError(f"{self.folder / 'run.json'}: has no scene")
        return Scene.from_dict(about["scene"], Path(about.get("folder", "")))

    @property
    def columns(self) -> dict[str, Array]:
        """diagnostics.csv by column, (rows,) each. A last row that is still being written is left out."""
        path = self.folder / "diagnostics.csv"
        try:
            lines = path.read_text().rpartition("\n")[0].splitlines()
            if not lines:
                raise ValueError("it has no whole line")
            header, *rows = csv.reader(lines)
            if header[:2] != ["step", "time"]:
                raise ValueError("its columns do not begin with step,time")
            return {name: _numbers(np.array([row[k] for row in rows])) for k, name in enumerate(header)}
        except (OSError, ValueError, IndexError) as error:
            raise SceneError(f"{path}: cannot be read: {error}") from None

    @property
    def diagnostics(self) -> Any:
        """diagnostics.csv as a pandas.DataFrame. ImportError without pandas."""
        return _library("pandas").DataFrame(self.columns)

    def to_xarray(self, *fields: str) -> Any:
        """Frames as an xarray.Dataset over time and id (all ids there ever were), vectors over axis too; of these fields, or all.

        What has other components than the axes, as the orientations of rough spheres in space, is over those, "NAME_component".
        Where a particle is not there at a time, its numbers are NaN. Everything is held in memory. ImportError without xarray.
        """
        xarray, frames = _library("xarray"), self[:]
        if not frames:
            raise SceneError(f"{self.folder}: no frame yet")
        if missing := [name for name in fields if name not in frames[0].fields]:
            raise KeyError(f"{self.folder}: no field {missing[0]!r}; stored are {', '.join(frames[0].fields)}")
        names = [name for name in fields or frames[0].fields if name != "id"]
        ids = np.unique(np.concatenate([frame.id for frame in frames]))
        constant = all(len(frame) == len(ids) for frame in frames)
        variables = {}
        for name in names:
            first = frames[0][name]
            kind = first.dtype if constant else np.result_type(first.dtype, float)
            values = np.full((len(frames), len(ids), *first.shape[1:]), 0 if constant else np.nan, kind)
            for k, frame in enumerate(frames):
                values[k, np.searchsorted(ids, frame.id)] = frame[name]
            along = "axis" if first.shape[1:] == (self.dimension,) else f"{name}_component"
            variables[name] = ("time", "id", along)[: values.ndim], values
        axis = list("xyz")[: self.dimension] if self.dimension <= 3 else list(range(self.dimension))
        axes = {"axis": axis} if any("axis" in dims for dims, _ in variables.values()) else {}
        coordinates = {"time": [frame.time for frame in frames], "id": ids, **axes}
        return xarray.Dataset(variables, coordinates, {"title": self.title})

    def __repr__(self) -> str:
        return f"Run({str(self.folder)!r}: {self.title})"


def _numbers(texts: Array) -> Array:
    """Integers, or else floats. ValueError if they are neither."""
    try:
        return texts.astype(np.int64)
    except ValueError:
        return texts.astype(float)


def _library(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError:
        raise ImportError(f"{name} is not installed: pip install {name}") from None
