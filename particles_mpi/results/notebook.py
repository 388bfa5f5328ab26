"""The page of a run in a notebook: of a `Run`, or of a simulation, which adds its frames to it while it goes on."""

from __future__ import annotations

import html
import json
from importlib import import_module
from time import perf_counter
from typing import Any
from uuid import uuid4

import numpy as np

from particles_mpi.errors import SceneError
from particles_mpi.parallel.agreement import raising_together
from particles_mpi.parallel.exchange import in_id_order
from particles_mpi.particles import Array, field
from particles_mpi.results.curves import EVENTS, curves
from particles_mpi.results.frame import Frame
from particles_mpi.results.page import Choice, assemble, pack, survey

NOTEBOOK_PAGE_BYTES = 12_000_000  # bytes of a page: a notebook keeps it
HEIGHT = 620  # pixels
SENDING_PAUSE = 0.2  # seconds at least between two messages to a page


class Shown:
    """The page of a run, as a notebook shows it."""

    def __init__(self, run: Any, live: bool = False):
        self.name = f"particles_{uuid4().hex}"
        self.text, self.columns, self.every = assemble(run, NOTEBOOK_PAGE_BYTES, live)

    def _repr_html_(self) -> str:
        style = f"width: 100%; height: {HEIGHT}px; border: 1px solid #dfe3e8"
        return f'<iframe id="{self.name}" style="{style}" srcdoc="{html.escape(self.text)}"></iframe>'


class LiveView:
    """The frames of a running simulation in a notebook: from now on, one every so many steps, as a `Run` has them.

    While the simulation goes on, rank 0 sends new frames to the page, a few times a second. At the end of a run the page is made
    again with all frames, so that a saved notebook has them. Every method is collective.
    """

    ended, folder = True, "simulation"

    def __init__(self, sim: Any, every: int):
        self.every, self.title, self.dimension = every, sim.scene.title or "Simulation", sim.scene.dimension
        self.about = {"scene": sim.scene.to_dict(), "ranks": sim.ranks.size}
        self.frames, self.rows = list[Frame](), dict[str, list[Any]]()
        self.counts = self._counts(sim)
        self.display: Any = None
        with raising_together(sim.ranks):
            self.display = _display() if sim.ranks.is_root else None
        self.take(sim)
        if self.display:
            self.make()
            self.place, self.mail = (self.display.display(what, display_id=True) for what in (self.shown, self.display.HTML("")))

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, k: int) -> Frame:
        return self.frames[k]

    @property
    def columns(self) -> dict[str, Array]:
        """What a `Run` has from diagnostics.csv."""
        return {name: np.array(values) for name, values in self.rows.items()}

    def _counts(self, sim: Any) -> Array:
        counts: Array = sim.ranks.allreduce_sum(np.array([sim.totals[name] for name in EVENTS]))
        return counts

    def take(self, sim: Any) -> None:
        """Keep a frame, and a row of diagnostics, on rank 0."""
        row, counts = {"time": sim.time, **sim.measure()}, self._counts(sim)
        row |= dict(zip(EVENTS, counts - self.counts, strict=True))
        self.counts = counts
        arrays = in_id_order(sim.ranks, {n: a for n, a in sim.rows.arrays.items() if field(n).output}, sim.ids, 1)
        if self.display:
            for name, value in row.items():
                self.rows.setdefault(name, []).append(value)
            read = {name: np.array(column) for name, column in arrays.items()}.__getitem__
            self.frames.append(Frame(len(self.frames), sim.time, sim.steps_done, len(arrays["id"]), list(arrays), read))

    def due(self, step: int) -> int:
        """The step after this one at which it takes a frame."""
        return (step // self.every + 1) * self.every

    def after_step(self, sim: Any) -> None:
        """Take a frame if the step is a multiple of `every`, and send new frames to the page. Collective.

        Messages are at least SENDING_PAUSE seconds apart.
        """
        if sim.steps_done % self.every == 0:
            self.take(sim)
            if self.display and perf_counter() - self.last > SENDING_PAUSE:
                self.send()

    def make(self) -> None:
        """The page of all frames so far."""
        self.shown = Shown(self, live=True)
        self.ranges = {c.name: (c.low, c.high) for c in self.shown.columns if c.low is not None and c.high is not None}
        self.sent, self.last = len(self.frames), perf_counter()

    def send(self) -> None:
        """Tell the page of the frames that it does not have yet."""
        new = list(range(self.sent, len(self.frames)))
        for c in survey(self, Choice(new, 1, "f4", []), live=True)[0]:
            if c.name in self.ranges and c.low is not None and c.high is not None:
                low, high = self.ranges[c.name]
                self.ranges[c.name] = min(low, c.low), max(high, c.high)
        shown = self.shown
        blocks = [{"block": pack(self[k], shown.columns, shown.every), "time": self[k].time, "number": k} for k in new]
        message = json.dumps({"frames": blocks, "ranges": self.ranges, "curves": curves(self.columns)})
        there = f"document.getElementById({shown.name!r})"
        self.mail.update(self.display.HTML(f"<script>{there}?.contentWindow.postMessage({message}, '*')</script>"))
        self.sent, self.last = len(self.frames), perf_counter()

    def finish(self) -> None:
        """At the end of a run."""
        if self.display and len(self.frames) > 1:
            self.make()
            self.mail.update(self.display.HTML(""))
            self.place.update(self.shown)


def _display() -> Any:
    """The module that shows things in a notebook."""
    try:
        if import_module("IPython").get_ipython():
            return import_module("IPython.display")
    except ImportError:
        pass
    raise SceneError("view: works only in a notebook; elsewhere run with output=FOLDER, then use: particles-mpi view FOLDER")
