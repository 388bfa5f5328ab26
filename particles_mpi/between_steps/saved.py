"""A simulation as a whole: copied, compared, printed, saved and read back, with the same bits from there on."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Self

import numpy as np

from particles_mpi.between_steps.state import State
from particles_mpi.contacts.drift import COUNTS
from particles_mpi.measure import snapshot
from particles_mpi.output.checkpoint import load
from particles_mpi.parallel.agreement import raising_together, same_on_all
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Array, Particles
from particles_mpi.scene.schema import Scene


class Saved(State):
    """A state that can be copied and saved."""

    def metadata(self) -> dict[str, Any]:
        """Clock, counts over all ranks, and scene, as plain data: what a state is besides its particles. Collective."""
        self.take_changes()
        totals = self.ranks.allreduce_sum(np.array([self.totals[name] for name in COUNTS])).tolist()
        clock = {"step": self.steps_done, "moment": self.moment, "h": self._h, "observed": self.observed}
        kept = self.rest.saved() if self.rest else []
        counts = {"totals": totals, "next_id": self.next_id, "additions": self.additions}
        return {**clock, **counts, "kept": kept, "scene": self.scene.to_dict()}

    @classmethod
    def restored(cls, scene: Scene, ranks: Communicator, everyone: Particles, metadata: dict[str, Any]) -> Self:
        """The simulation that `metadata` tells of, with these particles (in id order on every rank). Collective."""
        sim = cls.__new__(cls)
        sim.begin(scene, ranks, everyone.select(np.arange(*ranks.share(len(everyone)))), metadata["next_id"])
        sim.steps_done, sim._h, sim.additions = metadata["step"], metadata["h"], metadata["additions"]
        sim.moment = metadata["moment"][0], metadata["moment"][1]
        sim.observed = list(metadata["observed"])
        if sim.rest and metadata["kept"]:
            sim.rest.restore(metadata["kept"], sim.rows.id)
        if ranks.is_root:  # counts are sums over ranks: one rank carries those from before
            sim.totals.update(zip(COUNTS, metadata["totals"], strict=True))
        return sim

    @classmethod
    def read(cls, ranks: Communicator, arrays: dict[str, Array], metadata: dict[str, Any]) -> Self:
        """The simulation of a state that every rank has read from a file: it must be the same on all."""
        same_on_all(ranks, metadata, arrays)
        with raising_together(ranks):
            scene = Scene.from_dict(metadata["scene"])
            return cls.restored(scene, ranks, Particles(scene.dimension, arrays), metadata)

    @classmethod
    def resume(cls, path: str | Path, comm: Any = None) -> Self:
        """The run that wrote the checkpoint, where it stood, on any number of ranks; the same bits from there on."""
        ranks = Communicator(comm)
        with raising_together(ranks):
            arrays, saved = load(Path(path))
            metadata = {name: json.loads(str(saved[name])) for name in snapshot.METADATA}
        sim = cls.read(ranks, arrays, metadata)
        sim.reported, sim.written = json.loads(saved["reported"]), json.loads(saved["written"])
        return sim

    def copy(self) -> Self:
        """Another simulation in the same state. Collective."""
        metadata = self.metadata()
        return self.restored(self.scene, self.ranks, snapshot.gather_all(self.ranks, self.rows), metadata)

    def to_json(self, path: str | Path, indent: int | None = None) -> None:
        """Save scene and state, exact to the bit; compact, or readable with `indent`. Collective."""
        metadata = self.metadata()
        snapshot.save_json(Path(path), self.ranks, self.rows, metadata, indent)

    @classmethod
    def from_json(cls, path: str | Path, comm: Any = None) -> Self:
        """What `to_json` saved, on any number of ranks."""
        ranks = Communicator(comm)
        with raising_together(ranks):
            arrays, metadata = snapshot.load_json(Path(path))
        return cls.read(ranks, arrays, metadata)

    def __eq__(self, other: object) -> bool:
        """The same scene, time, step length and particles, to the bit. Collective."""
        if not isinstance(other, Saved):
            return NotImplemented
        for sim in (self, other):
            sim.take_changes()
        mine, theirs = (snapshot.gather_all(sim.ranks, sim.rows) for sim in (self, other))
        clocks = [(sim.time, sim.h, sim.next_id) for sim in (self, other)]
        return self.scene == other.scene and clocks[0] == clocks[1] and snapshot.same(mine, theirs)

    __hash__ = None  # type: ignore[assignment]

    def __str__(self) -> str:
        self.particles.collect()
        return f"{self!r}\n{snapshot.table(self.rows)}"

    def __repr__(self) -> str:
        return f"Simulation({self.scene.title!r}: {self.total} particles, step {self.steps_done}, time {self.time:g})"
