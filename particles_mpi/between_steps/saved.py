"""A simulation as a whole: copied, compared, printed, saved and read back, with the same bits from there on."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any, Self

import numpy as np

from particles_mpi.between_steps.membership import Membership
from particles_mpi.contacts.drift import COUNTS, WORK
from particles_mpi.contacts.notes import ContactNotes
from particles_mpi.contacts.warm_start import NOTHING, Memory
from particles_mpi.errors import SceneError
from particles_mpi.measure import snapshot
from particles_mpi.measure.diagnostics import Since
from particles_mpi.measure.energy_change import Energies
from particles_mpi.output.checkpoint import Checkpoint
from particles_mpi.output.files import identity_of
from particles_mpi.parallel.agreement import raising_together, same_on_all
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import allgather_rows, by_destination, holders, in_id_order, send_rows
from particles_mpi.particles import Particles
from particles_mpi.scene.schema import Scene


def require_effect_files(scene: Scene, before: dict[str, str], path: str | Path) -> None:
    """Raise SceneError if the file of an effect has changed since `path` was written; before: `Scene.digests` of that time."""
    now = scene.digests()
    if other := [name for name in before if before[name] != now.get(name)]:
        raise SceneError([f"effects.{name}.file: has changed since {path} was written" for name in other])


class Saved(Membership):
    """A state that can be copied and saved."""

    def metadata(self) -> dict[str, Any]:
        """Return clock, counts over all ranks, and scene, as plain data: the state without particles and contacts. Collective."""
        self.take_changes()
        observed = {reader: asdict(since) for reader, since in self.output_record.observed.items()}
        marks = [since[mark] for since in observed.values() for mark in ("mixed", "changed")]  # by the script of this rank
        sums = self.ranks.allreduce_sum(np.array([*(self.totals[name] for name in COUNTS), *marks])).tolist()
        of_all = iter(sums[len(COUNTS) :])
        for since in observed.values():
            since.update(mixed=next(of_all) > 0, changed=next(of_all) > 0)
        clock = {"step": self.steps_done, "moment": self.clock_start, "h": self._h, "observed": observed}
        counted = {"totals": sums[: len(COUNTS)], "reported": self.output_record.reported, "notes": asdict(self.drift.notes())}
        return {**clock, **counted, "next_id": self.next_id, "additions": self.additions, "scene": self.scene.to_dict()}

    def lasting_contacts(self) -> Memory:
        """Return the impulses of the lasting contacts of this rank's particles."""
        return self.persistent.history.remembered() if self.persistent else NOTHING

    @classmethod
    def restored(cls, scene: Scene, ranks: Communicator, rows: Particles, metadata: dict[str, Any], contacts: Memory) -> Self:
        """Make the simulation that `metadata` describes, with these particles on this rank, and their contacts. Collective."""
        sim = cls.__new__(cls)
        sim.begin(scene, ranks, rows, metadata["next_id"])
        sim.steps_done, sim._h, sim.additions = metadata["step"], metadata["h"], metadata["additions"]
        sim.clock_start = metadata["moment"][0], metadata["moment"][1]
        sim.output_record.observed = {reader: Since.read(since) for reader, since in metadata["observed"].items()}
        sim.output_record.reported = metadata.get("reported", metadata["totals"])  # earlier versions kept none of either
        sim.drift.past_notes = ContactNotes(**metadata.get("notes", {}))
        if sim.persistent:
            sim.persistent.history.restore(contacts)
        if ranks.is_root:  # counts are sums over ranks: one rank carries those from before
            sim.totals.update(zip(COUNTS, metadata["totals"], strict=True))
        return sim

    @classmethod
    def resume(cls, path: str | Path, comm: Any = None, files: dict[str, str] | None = None) -> Self:
        """Restore a simulation from a checkpoint, on any number of ranks; it goes on with the same bits. Collective.

        Each rank reads its share of the particles, and of the contacts, which are then sent to the ranks that have their
        particles. `files`: where the files of a user's effects are now, by effect, if they were moved. Raises SceneError if what
        is in them has changed.
        """
        ranks = Communicator(comm)
        with raising_together(ranks):
            file = Checkpoint(Path(path))
            saved = file.attributes
            metadata = {name: json.loads(str(saved[name])) for name in snapshot.METADATA if name in saved}
            for name, place in (files or {}).items():
                if name in metadata["scene"]["effects"]:
                    metadata["scene"]["effects"][name]["file"] = place
            scene = Scene.from_dict(metadata["scene"])
            require_effect_files(scene, json.loads(str(saved.get("effect_files", "{}"))), path)
            rows = Particles(scene.dimension, file.rows(*ranks.share(file.total)))
            contacts = file.contacts(*ranks.share(file.number_of_contacts))._asdict()
        same_on_all(ranks, metadata)
        owner = holders(ranks, rows.id, contacts["id"])
        contacts, _ = send_rows(ranks, contacts, *by_destination(owner, ranks.size))
        with raising_together(ranks):
            sim = cls.restored(scene, ranks, rows, metadata, Memory(**contacts))
        record = sim.output_record
        record.written = json.loads(saved["written"])
        if "past" in saved:
            sim.count_on(json.loads(saved["past"]))
        if Path(path).name == "checkpoint.h5":  # a run into that folder goes on there
            record.saved = Path(path).resolve().parent, sim.steps_done, identity_of(Path(path), ranks)
        return sim

    def count_on(self, past: dict[str, Any]) -> None:
        """Go on with the counts of a resumed run, which rank 0 carries for all ranks, and with the notes for its remarks."""
        counts = past["counts"]
        if self.ranks.is_root:
            self.ranks.messages += counts["messages"]
            self.ranks.reductions += counts["reductions"]
            self.drift.past_work = {name: counts.get(name, 0) for name in WORK}
        self.calls.update({name: self.calls.get(name, 0) + calls for name, calls in past["calls"].items()})
        self.output_record.energies = Energies(**past.get("energies", {}))
        self.output_record.energy_remarks = self.output_record.energies.remarks(self.active)

    def copy(self) -> Self:
        """Another simulation in the same state. Collective."""
        metadata = self.metadata()
        return self.restored(self.scene, self.ranks, self.rows.copy(), metadata, self.lasting_contacts())

    __copy__ = copy

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self.copy()

    def __reduce__(self) -> Any:
        raise TypeError("a Simulation belongs to its ranks, and cannot be pickled: save it by to_json, or by a run's checkpoint")

    def to_json(self, path: str | Path, indent: int | None = None) -> None:
        """Save scene and state, exact to the bit; on one line, or readable with `indent`. Collective."""
        metadata = self.metadata()  # takes what was changed, which may make contacts forgotten
        contacts = allgather_rows(self.ranks, self.lasting_contacts()._asdict())
        order = np.lexsort((contacts["partner"], contacts["id"]))
        metadata |= {"effect_files": self.scene.digests(), "kept": [contacts[name][order].tolist() for name in Memory._fields]}
        snapshot.save_json(Path(path), self.ranks, self.rows, metadata, indent)

    @classmethod
    def from_json(cls, path: str | Path, comm: Any = None) -> Self:
        """What `to_json` saved, on any number of ranks."""
        ranks = Communicator(comm)
        with raising_together(ranks):
            arrays, metadata = snapshot.load_json(Path(path))
        same_on_all(ranks, metadata, arrays)
        with raising_together(ranks):
            scene = Scene.from_dict(metadata["scene"])
            require_effect_files(scene, metadata.get("effect_files", {}), path)
            rows = Particles(scene.dimension, arrays).select(np.arange(*ranks.share(len(arrays["id"]))))
            kept = [np.array(column, kind) for column, kind in zip(metadata["kept"], (np.int64, np.int64, float), strict=True)]
            mine = np.isin(kept[0], rows.id)
            return cls.restored(scene, ranks, rows, metadata, Memory(*(column[mine] for column in kept)))

    def __eq__(self, other: object) -> bool:
        """The same scene, files of effects, time, step length, next id and particles, to the bit. Collective.

        The impulses that lasting contacts keep for a warm start are not compared.
        """
        if not isinstance(other, Saved):
            return NotImplemented
        for sim in (self, other):
            sim.take_changes()
        clocks = [(sim.time, sim.h, sim.next_id) for sim in (self, other)]
        ranks = max(self.ranks, other.ranks, key=lambda ranks: ranks.size)  # all of these must get the same answer
        files = self.scene.digests() == other.scene.digests()
        if not ranks.all(self.scene == other.scene and files and clocks[0] == clocks[1]):
            return False
        if ranks.any(self.ranks.size != other.ranks.size):  # particles that are divided in another way
            return ranks.all(snapshot.same(*(snapshot.gather_all(sim.ranks, sim.rows) for sim in (self, other))))
        if not ranks.all(self.ids == other.ids):
            return False
        d = self.scene.dimension
        shares = (Particles(d, in_id_order(sim.ranks, sim.rows.arrays, sim.ids, sim.ranks.size)) for sim in (self, other))
        return ranks.all(snapshot.same(*shares))

    __hash__ = None  # type: ignore[assignment]

    def __str__(self) -> str:
        self.particles.collect()
        own = f"; the {len(self.rows)} on rank {self.ranks.rank}:" if self.ranks.size > 1 else ""
        return f"{self!r}{own}\n{snapshot.printed_table(self.rows)}"

    def __repr__(self) -> str:
        return f"Simulation({self.scene.title!r}: {self.total} particles, step {self.steps_done}, time {self.time:g})"


class StepTrial:
    """A copy of what a step of a simulation changes, with which the step can be undone.

    It holds the particles of this rank, the impulses of their lasting contacts, the counts of what happened, and how often forces
    were evaluated. Interactions and pair tests that were done stay counted.
    """

    def __init__(self, sim: Saved):
        self.sim = sim
        self.rows, self.contacts = sim.rows.copy(), sim.lasting_contacts()
        self.totals, self.calls, self.tc_elastic = sim.totals.copy(), sim.calls.copy(), sim.drift.exact.tc_elastic

    def undo(self) -> None:
        """Return to the state before the step. It can be called only once: the arrays of the copy become those of the state."""
        sim = self.sim
        sim.rows.replace(self.rows.arrays)
        sim.totals.update(self.totals)
        sim.calls.clear()
        sim.calls.update(self.calls)
        if sim.persistent:
            sim.persistent.history.restore(self.contacts)
        sim.drift.exact.tc_elastic = self.tc_elastic
