"""A run read back: `Run("out/marbles")` has its frames, diagnostics and scene, also while it is going on."""

from __future__ import annotations

import csv
import json
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from particles_mpi.errors import SceneError
from particles_mpi.output.read_frames import FrameReader

if TYPE_CHECKING:  # particles brings numba, which takes longer to import than a frame to read
    from particles_mpi.particles import Array

FILES = ("trajectory.vtkhdf", "diagnostics.csv", "run.json")


class Frame:
    """The N particles at one time, in the order of their ids: `frame.position` (N, d), `frame.velocity`, `frame.mass` (N,).

    index: number of the frame; time; step: of the run; fields: names of all that is stored. A field is read from the file when it
    is asked for, as `frame.mass` or `frame["mass"]`.
    """

    def __init__(self, run: Run, index: int):
        known = run.frames.index()
        self.index, self.time, self.step = index, float(known.times[index]), int(known.steps[index])
        self.count = int(known.counts[index])
        self.fields = ("position", *(n for n in known.fields if n != "position" and not n.endswith("_full")))
        self._reader, self._d = run.frames, run.dimension

    def __len__(self) -> int:
        return self.count

    def __getattr__(self, name: str) -> Array:
        if name.startswith("_"):
            raise AttributeError(name)
        stored = self._reader.index().fields
        if name == "position" and name not in stored:
            name_in_file = "Points"  # d <= 3
        else:
            name_in_file = f"{name}_full" if f"{name}_full" in stored else name
        if name_in_file in stored or name_in_file == "Points":
            values = self._reader.column(name_in_file, self.index)
            values = np.ascontiguousarray(values[:, : self._d]) if values.ndim > 1 else values
        elif name == "fixed":  # stored only if a particle is
            values = np.zeros(self.count, np.uint8)
        else:
            raise AttributeError(f"frame {self.index} has no field {name!r}; stored are {', '.join(self.fields)}")
        vars(self)[name] = values
        return values

    def __getitem__(self, name: str) -> Array:
        values: Array = getattr(self, name)
        return values

    @property
    def speed(self) -> Array:
        """(N,)"""
        speed: Array = np.linalg.norm(self.velocity, axis=1)
        return speed

    def __repr__(self) -> str:
        return f"Frame({self.index}: t = {self.time:g}, {self.count} particles; {', '.join(self.fields)})"


class Run:
    """The folder of a run: `len(run)` frames at `run.times`; `run[k]` is a `Frame` (k < 0 from the end), `run[a:b]` a list.

    Nothing is kept open, and each access looks anew: of a run that is going on it sees the frames and rows that are whole.
    Raises SceneError, one line, for what is not there, and IndexError for a frame that is not.
    """

    def __init__(self, folder: str | Path):
        self.folder = Path(folder)
        if not any((self.folder / name).is_file() for name in FILES):
            raise SceneError(f"{self.folder}: holds no run" if self.folder.is_dir() else f"{self.folder}: no such folder")
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
            return [Frame(self, i) for i in range(*k.indices(count))]
        if not -count <= k < count:
            there = f"frames 0 to {count - 1}" if count else "no frame yet"
            raise IndexError(f"{self.folder}: no frame {k}: the run has {there}")
        return Frame(self, k % count)

    @property
    def about(self) -> dict[str, Any]:
        """The content of run.json: the scene and, once the run has ended, its plan, timers and counts; {} if there is none."""
        path = self.folder / "run.json"
        try:
            told: dict[str, Any] = json.loads(path.read_text()) if path.is_file() else {}
        except (OSError, ValueError) as error:
            raise SceneError(f"{path}: cannot be read: {error}") from None
        return told

    @property
    def ended(self) -> bool:
        """Has the run reached its end? Then run.json has the timers."""
        return "timers" in self.about

    @property
    def dimension(self) -> int:
        """d, or 3 if there is no run.json: that is what the frames have."""
        return int(self.about.get("scene", {}).get("dimension", 3))

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
        return Scene.from_dict(about["scene"])

    @property
    def columns(self) -> dict[str, Array]:
        """diagnostics.csv by column, (rows,) each. A last row that is still being written is left out."""
        path = self.folder / "diagnostics.csv"
        try:
            header, *rows = csv.reader(path.read_text().rpartition("\n")[0].splitlines())
            return {name: _numbers(np.array([row[k] for row in rows])) for k, name in enumerate(header)}
        except (OSError, ValueError, IndexError) as error:
            raise SceneError(f"{path}: cannot be read: {error}") from None

    @property
    def diagnostics(self) -> Any:
        """diagnostics.csv as a pandas.DataFrame. ImportError without pandas."""
        return _library("pandas").DataFrame(self.columns)

    def to_xarray(self, *fields: str) -> Any:
        """Frames as an xarray.Dataset over time and id (all ids there ever were), vectors over axis too; of these fields, or all.

        Where a particle is not there at a time, its numbers are NaN. Everything is held in memory. ImportError without xarray.
        """
        xarray, frames = _library("xarray"), self[:]
        if not frames:
            raise SceneError(f"{self.folder}: no frame yet")
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
            variables[name] = ("time", "id", "axis")[: values.ndim], values
        axis = list("xyz")[: self.dimension] if self.dimension <= 3 else list(range(self.dimension))
        along = {"axis": axis} if any("axis" in dims for dims, _ in variables.values()) else {}
        coordinates = {"time": [frame.time for frame in frames], "id": ids, **along}
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
        raise ImportError(f"{name} is not installed: pip install 'particles-mpi[analysis]'") from None
