"""The folder of a run and what is written into it: frames, rows of diagnostics, checkpoints."""

import json
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from particles_mpi.contacts.drift import COUNTS
from particles_mpi.errors import SceneError, StateError, StoppedError
from particles_mpi.measure.diagnostics import column_names
from particles_mpi.output import checkpoint, run_folder
from particles_mpi.output.diagnostics_csv import Diagnostics
from particles_mpi.output.files import failing_together, identity_of, write_text
from particles_mpi.particles import Array, field
from particles_mpi.results.scenery import paraview_script
from particles_mpi.run.ending import run_counts, scene_and_folder

FRAMES_IN = {"hdf5": "trajectory.vtkhdf", "vtk": "particles.pvd"}  # by format: what one opens to see the frames
MOST_VTK = 1_000_000  # particles: with more, VTK files are written only on request, because they are slower and larger than HDF5


def without_large_vtk(output: Any, total: int) -> list[str]:
    """Remove VTK from the `output` of a scene with very many particles that does not ask for it; returns lines for the user."""
    if total <= MOST_VTK or "vtk" not in output.formats or "formats" in output.model_fields_set:
        return []
    output.formats.remove("vtk")
    return [f'output.formats: no VTK files for more than {MOST_VTK} particles, unless the scene names "vtk" here']


class RunFiles:
    """Claims a folder for a run, opens its files, and writes them. Collective throughout.

    `plan`: that of the run. `resumed`: does it go on from a checkpoint? `own`: from the one in this folder? `continues`: is it
    the run in the folder that goes on?
    """

    def __init__(self, sim: Any, folder: Path, plan: dict[str, Any], *, resumed: bool, own: bool, overwrite: bool):
        self.sim, self.folder, self.ranks = sim, folder, sim.ranks
        about = scene_and_folder(sim.scene) | {"plan": plan | {"not_run": [{"effect": name} for name in plan["not_run"]]}}
        self.continues, self.lock = run_folder.claim(folder, self.ranks, about, resumed, overwrite, own)
        self.record = sim.output_record
        self.energies = self.record.energies  # with those of an extra row
        if not self.continues:
            self.record.written = {"row": -1, "frame": -1}
        shows_fixed = self.record.written.setdefault("fixed", int(plan["fixed"] > 0))
        if plan["fixed"] and not shows_fixed:
            sim.warnings.append(f"output: frames in {folder} do not show which particles are fixed: none was in the first frame")
        try:
            self.open(about)
        except BaseException:
            self.release()
            raise

    def open(self, about: dict[str, Any]) -> None:
        """Open the writers. Each checks its file before the first one changes its own. `about`: for `run.json`."""
        sim, ranks, output, d = self.sim, self.ranks, self.sim.scene.output, self.sim.scene.dimension
        step = sim.steps_done if self.continues else None
        frame, row, last_count = (self.record.written.get(name) for name in ("frame", "row", "frame_particles"))
        self.frames: list[Any] = []
        if "hdf5" in output.formats:
            from particles_mpi.output.trajectory import Trajectory

            path = self.folder / FRAMES_IN["hdf5"]
            frames = max(about["plan"]["frames"], sim.scene.steps // output.every + 1)
            self.frames.append(Trajectory(path, ranks, list(self.shown()), d, sim.total, step, frame, last_count, frames))
        if "vtk" in output.formats:
            from particles_mpi.output.vtk import VtkSeries

            self.frames.append(VtkSeries(self.folder, ranks, d, step, frame))
        if self.continues:
            left = [name for kind, name in FRAMES_IN.items() if kind not in output.formats and (self.folder / name).exists()]
            old = f"was written before step {sim.steps_done} and gets no more frames"
            sim.warnings += [f"output.formats: {self.folder / name} {old}" for name in left]
        names = column_names(d, output.observables, "mutual_gravity" in sim.scene.effects, "spin" in sim.rows.arrays)
        self.diagnostics = Diagnostics(self.folder / "diagnostics.csv", ranks, names, step, row)
        sim.warnings += [line for writer in (*self.frames, self.diagnostics) for line in writer.lost]
        try:
            for writer in (*self.frames, self.diagnostics):
                writer.open()
            if self.continues:  # what it says of the end is no longer true
                write_text(self.folder / "run.json", ranks, json.dumps(about, indent=2) + "\n")
            if output.formats:
                write_text(self.folder / "view_paraview.py", ranks, paraview_script(self.folder, sim.scene.to_dict()))
        except (SceneError, StoppedError):  # on all ranks
            self.give_up()
            raise

    def shown(self) -> dict[str, Array]:
        """Return the fields of a frame; `fixed` only if a particle was fixed when the first frame was written."""
        arrays = self.sim.rows.arrays
        return {n: a for n, a in arrays.items() if field(n).output and (n != "fixed" or self.record.written["fixed"])}

    def write_row(self, extra: bool = False) -> dict[str, Any]:
        """Write a row of diagnostics.csv: the state, and what happened since the row before.

        An `extra` row at the end of a run is ignored by the next row, and is removed when the run goes on.
        """
        sim, record = self.sim, self.record
        before = record.reported, replace(record.observed["row"]), record.written["row"]
        with sim.timers("diagnostics"):
            state = sim.measure(row=True)
            totals = self.ranks.total(*(sim.totals[name] for name in COUNTS))
            most = self.ranks.largest(len(sim.rows))[0]
            row = {"step": sim.steps_done, "time": sim.time, "particles": sim.total, **state}
            row |= {name: now - then for name, now, then in zip(COUNTS, totals, record.reported)}
            row["imbalance"] = most * self.ranks.size / sim.total if sim.total else 1.0
            record.reported = list(totals)
            self.diagnostics.write(row)
            record.written["row"] = sim.steps_done
        self.energies = replace(record.energies)
        self.energies.add(row["total_energy"], row["kinetic"])
        if extra:
            record.reported, record.observed["row"], record.written["row"] = before
        else:
            record.energies = self.energies
        collisions, wall_hits, missed, *_ = totals
        return {**row, "hits_so_far": collisions + wall_hits, "missed_so_far": missed}

    def check_folder(self) -> None:
        """Raise an error if the folder no longer belongs to this run."""
        with failing_together(self.ranks, f"cannot write into {self.folder} at step {self.sim.steps_done}"):
            if self.lock:
                self.lock.check()

    def write_frame(self) -> None:
        """One frame in every format."""
        with self.sim.timers("output"):
            self.check_folder()
            self.sim.take_changes()
            shown = self.shown()
            for writer in self.frames:
                writer.write(self.sim.steps_done, self.sim.time, shown, self.sim.ids)
            self.record.written |= {"frame": self.sim.steps_done, "frame_particles": self.sim.total}

    def save(self) -> None:
        """Write a checkpoint with the exact state, which replaces the one before."""
        sim = self.sim
        with sim.timers("output"):
            self.check_folder()
            for writer in self.frames:
                writer.show()  # a run that goes on from here counts on all frames up to here
        with sim.timers("checkpoint"):
            for writer in (*self.frames, self.diagnostics):
                writer.wait_for_disk()
            metadata = sim.metadata()
            past = {"counts": run_counts(sim), "calls": sim.calls, "energies": asdict(self.record.energies)}
            kept = metadata | {"written": self.record.written, "past": past}
            state = {name: json.dumps(value) for name, value in kept.items()} | {"step": metadata["step"], "time": sim.time}
            state["effect_files"] = json.dumps(sim.scene.digests())
            path, d = self.folder / "checkpoint.h5", sim.scene.dimension
            checkpoint.save(path, self.ranks, sim.rows.arrays, sim.ids, d, state, sim.lasting_contacts())
        self.record.saved = self.folder.resolve(), sim.steps_done, identity_of(path, self.ranks)

    def dump(self, error: StateError) -> StateError:
        """Write all rows of an invalid state to `stopped.h5`; returns the error with a text that names the file."""
        sim, path = self.sim, self.folder / "stopped.h5"
        safe = "; the last checkpoint is intact" if self.record.saved or self.continues else ""
        try:
            checkpoint.dump(path, self.ranks, sim.rows.arrays, {"step": sim.steps_done, "error": str(error)})
        except StoppedError as failure:  # the first error must be raised all the same
            return StateError(f"{error}; {failure}{safe}")
        return StateError(f"{error}; all particles are in {path}{safe}")

    def close(self) -> None:
        """Close every file."""
        with self.sim.timers("output"):
            for writer in (*self.frames, self.diagnostics):
                writer.close()

    def give_up(self) -> None:
        """Close all that can be closed after an error. Errors about data that was not written are ignored."""
        with self.sim.timers("output"):
            for writer in (*self.frames, self.diagnostics):
                with suppress(OSError, RuntimeError, ValueError, StoppedError):
                    writer.close()

    def release(self) -> None:
        """Unlock the folder for other runs."""
        if self.lock:
            self.lock.release()
