"""One run, from its plan to its phase table: its options, its steps, and what ends it. `files` writes its results."""

from collections.abc import Sequence
from numbers import Real
from pathlib import Path
from shlex import quote
from time import perf_counter
from typing import Any

from particles_mpi.errors import Interrupted, SceneError, StateError, StoppedError, whole_number
from particles_mpi.kernels.validity import WATCH_EVERY
from particles_mpi.measure.energy_change import Energies
from particles_mpi.output.files import identity_of
from particles_mpi.parallel.agreement import await_all, same_on_all
from particles_mpi.parallel.signals import StopRequest
from particles_mpi.run.console import Screen
from particles_mpi.run.ending import PROGRAM, report_end
from particles_mpi.run.files import RunFiles
from particles_mpi.run.forecast import Forecast, Forecaster
from particles_mpi.scene.plan import plan

SHOW_EVERY = 10  # steps between two moves of the progress bar
SAFETY = 1.5  # times the slowest checkpoint: how long before the limit of its time a run stops


class Job:
    """Runs a simulation into a folder. Collective throughout.

    A `rehearsal` prints nothing, and ends as soon as rank 0 has a `forecast` of how long the run would take. `notes`: lines to be
    shown below the plan; `scene_file`: the file of the scene, for the command with which a run that was stopped is continued.
    """

    def __init__(
        self, sim: Any, folder: Path, *, quiet: bool = False, overwrite: bool = False, resumed: bool = False,
        steps: int | None = None, wall_time: float | None = None, setup_began: float | None = None, rehearsal: bool = False,
        notes: Sequence[str] = (), scene_file: Path | None = None,
    ):  # fmt: skip
        self.sim, self.folder, self.scene, self.ranks = sim, folder, sim.scene, sim.ranks
        known = identity_of(folder / "checkpoint.h5", self.ranks)
        own = known is not None and sim.output_record.saved == (folder.resolve(), sim.steps_done, known)
        self.resumed = resumed or (own and not overwrite)  # a simulation goes on with its own run
        limit: Any = wall_time  # a script may give anything
        options = {"output": str(folder), "steps": steps, "overwrite": overwrite, "resume": self.resumed}
        same_on_all(self.ranks, {f"--{name}": value for name, value in options.items()} | {"--wall-time": wall_time})
        self.last = sim.last_step if steps is None else whole_number("run: steps", steps)  # the step with which the job ends
        if steps is not None and self.last < sim.steps_done:
            raise SceneError(f"--steps: the run would end with step {self.last}, but it is already at step {sim.steps_done}")
        if not isinstance(limit, Real | None):
            raise ValueError(f"run: wall_time: {limit!r} is not a number of seconds")
        self.setup_began = perf_counter() if setup_began is None else setup_began
        self.rehearsal, self.notes, self.scene_file = rehearsal, notes, scene_file
        self.forecast: Forecast | None = None
        self.screen = Screen(self.ranks.is_root, quiet or rehearsal)
        sim.take_changes()
        self.plan = plan(self.scene, sim.rows, self.ranks, self.last)
        self.request = StopRequest(self.ranks, self.setup_began, wall_time)  # from here on a signal must not leave half a file
        if not self.scene_file:  # a script may have changed the state since the rows of an earlier job
            sim.output_record.energies = Energies()
        try:
            self.files = RunFiles(sim, folder, self.plan, resumed=self.resumed, own=own, overwrite=overwrite)
        except BaseException:
            self.request.close()
            raise

    def run(self) -> None:
        """Run to the last step, or until a signal or the limit of time."""
        sim, begun_with, stopped = self.sim, self.sim.steps_done, False
        try:
            self.screen.plan(self.scene.title, self.plan, sim.warnings)
            for note in self.notes:
                self.screen.say(f"  {note}")
            setup, begin, before = perf_counter() - self.setup_began, perf_counter(), sim.timers.seconds
            stopped = self.take_steps()
            self.files.close()
            if self.rehearsal:
                return
            seconds = {"setup": setup, "loop": perf_counter() - begin}
            phases = {name: total - before.get(name, 0.0) for name, total in sim.timers.seconds.items()}
            report_end(sim, self.plan, self.folder, self.screen, seconds, phases, begun_with, self.files.energies, not stopped)
        except (SceneError, StoppedError) as error:
            await_all(self.ranks, error)  # to close a file would wait for ranks that have no error
            self.files.give_up()
            if isinstance(error, StateError) and not self.rehearsal:
                raise self.files.dump(error) from None
            raise
        except BaseException:
            if self.ranks.size == 1:  # others may be anywhere, and to close a file would wait for them
                self.files.give_up()
            raise
        finally:
            self.screen.stop()
            self.request.close()
            self.files.release()
        if stopped:
            folder, scene = quote(str(self.folder)), quote(str(self.scene_file))
            saved = f"stopped at step {sim.steps_done} of {self.last}, saved; continue with --resume {folder}/checkpoint.h5"
            command = f", as {PROGRAM} run {scene} --output {folder} --resume auto" if self.scene_file else ""
            raise Interrupted(saved + command)

    def take_steps(self) -> bool:
        """Do the steps, and show and write all that is due between them; returns whether the run was stopped early."""
        sim, files, output, row, stopped = self.sim, self.files, self.scene.output, dict[str, Any](), False
        pace = Forecaster(sim, self.last) if self.screen.loud or (self.rehearsal and self.ranks.is_root) else None
        shown = sim.steps_done
        show = self.screen.start(shown, self.last)
        if not self.resumed:
            row = files.write_row()
            if pace:
                pace.reported()
            files.write_frame()
        elif not files.continues and sim.steps_done % output.every == 0:  # the frames of another folder begin here
            files.write_frame()
        if sim.steps_done >= self.last and self.resumed:  # nothing is left but to keep what the user changed
            extra = sim.steps_done % output.diagnostics_every != 0
            if extra or not files.continues:
                row = files.write_row(extra)
        if sim.steps_done == self.last or (self.resumed and not files.continues):
            self.save()
        periods = output.every, output.diagnostics_every, output.checkpoint_every
        while sim.steps_done < self.last and not (stopped := self.request.poll(sim.steps_done)):
            with self.request:
                sim.step_towards(min(self.last, *(sim.steps_done // k * k + k for k in periods)))
            n, final = sim.steps_done, sim.steps_done == self.last
            if final or any(n % k == 0 for k in (WATCH_EVERY, output.every, output.checkpoint_every)):
                sim.watch()
            if n % output.diagnostics_every == 0 or final:
                row = files.write_row(extra=n % output.diagnostics_every != 0)
            if n % output.every == 0:
                files.write_frame()
            if n % output.checkpoint_every == 0 or final:
                self.save()
            if pace and (forecast := pace.due_forecast()) and (n < self.last or self.rehearsal):
                self.print_forecast(forecast)
            if n >= shown + SHOW_EVERY:
                shown = n
                show(n, row)
        if not self.rehearsal:
            if stopped:
                self.save()
            show(sim.steps_done, row)
        return stopped

    def print_forecast(self, forecast: Forecast) -> None:
        """Print how long the run takes, and print it again if that changes."""
        before = self.forecast
        if before and before.least <= forecast.seconds <= before.most:
            return
        self.forecast = forecast
        if self.rehearsal:
            self.request.enough = True
        elif before is None:
            self.plan["predicted_seconds"] = forecast.seconds
            self.plan["predicted_seconds_range"] = [forecast.least, forecast.most]
        self.screen.say(f"  predicted{' now' if before else ''}: {forecast}")

    def save(self) -> None:
        """Write a checkpoint. The longest time that one took decides how long before its limit of time the run stops."""
        began = perf_counter()
        self.files.save()
        self.request.reserve = max(self.request.reserve, SAFETY * (perf_counter() - began))
