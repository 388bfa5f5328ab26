"""The output for a user: plan, progress bar, phase table. Rank 0 prints it; plain lines where there is no terminal."""

import os
import sys
from collections.abc import Callable
from contextlib import suppress
from math import isfinite
from pathlib import Path
from time import perf_counter
from typing import Any

from rich.console import Console
from rich.filesize import decimal
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Column, Table
from rich.text import Text

from particles_mpi.run.forecast import Forecast
from particles_mpi.scene.plan import duration

PHASES = {
    "steps": "many steps in one loop",
    "forces": "sum of forces",
    "kick": "velocities, friction, drag",
    "rest": "lasting contacts",
    "agree": "agree with other ranks (waits)",
    "ghosts": "ghosts: fetch, refresh",
    "migrate": "migrate, balance",
    "pairs": "find candidate pairs",
    "search": "contact times",
    "collide": "collide",
    "exchange": "all particles to all ranks",
    "walls": "drift with walls",
    "drift": "drift",
    "events": "events of effects",
    "diagnostics": "diagnostics",
    "output": "frames",
    "checkpoint": "checkpoints",
    "watchdog": "watchdog",
    "other": "everything else",
}

LOG_AFTER, LOG_RARER = 10.0, 1.5  # seconds until the first line of progress in a log, and factor to the next
NAMED_SHARE = 0.05  # of a step: phases that take less are not named in a forecast
COMPILING_SECONDS = 20  # seconds to compile the kernels of one dimension that a scene uses
# Particles: of fewer, messages take longer than what they save; and where all attract one another.
FEW_ON_A_RANK, FEW_WITH_GRAVITY = 2000, 200
LOG_WIDTH = 200  # columns of a table that is not shown on a terminal


def state_of(row: dict[str, Any]) -> str:
    """Return a row of diagnostics in a few words: N, the energy and counts so far; "" for an empty row."""
    if not row:
        return ""
    has_potential = isfinite(row["total_energy"])  # not where a force acts along a periodic axis
    name, column = ("E", "total_energy") if has_potential else ("K", "kinetic")
    hits, missed = row["hits_so_far"], row["missed_so_far"]
    return f"t={row['time']:.4g} N={row['particles']} {name}={row[column]:.5g} hits={hits} missed={missed}"


def watched() -> bool:
    """Is the output shown on a terminal? Open MPI gives its ranks a terminal of their own: what counts is mpirun's output."""
    if "OMPI_COMM_WORLD_SIZE" not in os.environ:
        return os.isatty(1)
    try:
        return os.readlink(f"/proc/{os.getppid()}/fd/1").startswith(("/dev/pts", "/dev/tty"))
    except OSError:
        return False


def announce_compiling(scene: Any) -> None:
    """Print a line, once, if this process has to compile a kernel from now on.

    Set-up compiles those of the program up to dimension 3: only those of a user's effects are left.
    """
    from numba.core import event

    files = ", ".join(Path(options.file).name for options in scene.outside.values())
    what = f"kernels of {files}" if files else "kernels"
    told = f"{what} are compiled now, once"
    if scene.dimension > 3:
        told = f"dimension {scene.dimension}: kernels are compiled now, about {COMPILING_SECONDS} s, once"

    class CompilingNotice(event.Listener):
        warned = False

        def on_start(self, _: Any) -> None:
            if not self.warned:
                self.warned = True
                SteadyConsole(highlight=False, markup=False, soft_wrap=True).print(told)

        def on_end(self, _: Any) -> None:
            pass

    event.register("numba:compile", CompilingNotice())


class SteadyConsole(Console):
    """A console that stops printing where its output is no longer read, as behind `| head`, or has no room; the run goes on."""

    unwritten = False  # is there something that had no room?

    def print(self, *objects: Any, **options: Any) -> None:
        try:
            super().print(*objects, **options)
        except OSError as error:
            self.unwritten = True
            self.on_broken_pipe()
            why = f"standard output cannot be written ({error.strerror}): nothing more is printed\n"
            with suppress(OSError):  # it may go into the same file; nothing may be left in a buffer then
                os.write(2, why.encode())

    def on_broken_pipe(self) -> None:
        self.quiet = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left in buffers goes nowhere, without an error


class Screen:
    """Prints on rank 0, unless `quiet`."""

    def __init__(self, is_root: bool, quiet: bool):
        self.loud, shown = is_root and not quiet, watched()
        self.console = SteadyConsole(
            highlight=False,
            soft_wrap=True,
            force_terminal=None if shown else False,
            width=None if shown else 110,
            quiet=not self.loud,
        )
        self.progress: Progress | None = None

    def say(self, line: Any = "", head: str = "", whole: bool = False) -> None:
        """Print a line, behind a `head` in bold, if there is one. Brackets in them are text, and no markup.

        A terminal shows it folded between words, unless it is `whole`: so is what may be copied, a path or a command.
        """
        if not isinstance(line, str):
            self.console.print(line)
            return
        self.console.print(Text.assemble((head, "bold"), line), soft_wrap=whole or not self.console.is_terminal)

    def table(self, table: Table) -> None:
        """Print a table; in its full width, whatever the terminal's is, if that is a table of numbers, which may not be cut."""
        console, width = self.console, self.console.width
        if not console.is_terminal or any(column.no_wrap for column in table.columns):
            console.width = LOG_WIDTH
        console.print(table, crop=False)
        console.width = width

    def plan(self, title: str, plan: dict[str, Any], warnings: list[str]) -> None:
        """Print the plan, before the run."""
        say = self.say
        say(f": {plan['particles']} particles ({plan['fixed']} fixed) in dimension {plan['dimension']}, {plan['steps']} steps of "
            f"{plan['step']:g}, {plan['integrator']}, {plan['ranks']} rank(s)", head=title or "untitled scene")  # fmt: skip
        table = Table("runs", "law", box=None, padding=(0, 2, 0, 2))
        for row in plan["effects"]:
            table.add_row(row["effect"], Text(row["law"]))
            if "how" in row:
                table.add_row("", Text(row["how"]))
        table.add_row("drift", "dx/dt = v")
        say(table)
        say(f"  does not run: {', '.join(plan['not_run']) or 'none: every effect runs'}")
        shown = (plan["frames"] - 1) * plan["every"]
        last = f" (the last at step {shown}: output.every = {plan['every']})" if 0 <= shown < plan["steps"] else ""
        say(f"  ghosts: {plan['ghosts']}; memory about {decimal(plan['memory_bytes'])}; output {plan['frames']} "
            f"frame{'s' * (plan['frames'] != 1)}{last}, about {decimal(plan['output_bytes'])}")  # fmt: skip
        for line in plan["advice"]:
            say(f"  {line}")
        few = FEW_WITH_GRAVITY if any(row["effect"] == "mutual_gravity" for row in plan["effects"]) else FEW_ON_A_RANK
        if plan["ranks"] > 1 and plan["particles"] < few * plan["ranks"]:
            say(f"  ranks: fewer than {few} particles on each: one rank is as fast, or faster (RANKS=1 ./run.sh ...)")
        for line in warnings:
            say(f" {line}", head="  warning:")

    def shares(self, forecast: Forecast) -> None:
        """Print the share of each phase in a step, the largest first."""
        total = sum(forecast.phases.values())
        largest = sorted(((seconds, name) for name, seconds in forecast.phases.items()), reverse=True)
        named = [f"{PHASES.get(name, name)} {s / total:.0%}" for s, name in largest if s >= NAMED_SHARE * total > 0.0]
        if named:
            self.say(f"  shares of a step: {', '.join(named)}")

    def start(self, done: int, steps: int) -> Callable[[int, dict[str, Any]], None]:
        """Begin to show progress; returns a function to be called with (steps done, last row of diagnostics).

        On a terminal that is one line; elsewhere a line now and then, ever more rarely, so that a log stays short.
        """
        bar, began, due = self._progress("steps", steps, done), perf_counter(), LOG_AFTER

        def update(step: int, row: dict[str, Any]) -> None:
            nonlocal due
            if not bar.disable:
                speed = bar.tasks[0].speed
                bar.update(bar.tasks[0].id, completed=step, rate=f"{speed:.0f} steps/s" if speed else "", state=state_of(row))
            elif self.loud and (passed := perf_counter() - began) > due and done < step < steps:
                due = LOG_RARER * passed
                rate = (step - done) / passed
                self.say(f"step {step} of {steps}, {rate:.3g} steps/s, {duration((steps - step) / rate)} left: {state_of(row)}")

        return update

    def count(self, what: str, number: int) -> Callable[[str], None]:
        """Begin to show the progress of a `number` of tasks; returns a function to be called with the name of each as it begins.

        It is shown as in `start`.
        """
        bar, began, due = self._progress(what, number, -1), perf_counter(), LOG_AFTER

        def begin(name: str) -> None:
            nonlocal due
            bar.update(bar.tasks[0].id, advance=1, state=name)
            if bar.disable and self.loud and (passed := perf_counter() - began) > due:
                due = LOG_RARER * passed
                self.say(f"{name}: {bar.tasks[0].completed:.0f} of {number} done in {passed:.0f} s")

        return begin

    def _progress(self, what: str, total: int, done: int) -> Progress:
        """A progress bar, which is shown only on a terminal."""
        rate, state = (TextColumn(f"{{task.fields[{name}]}}") for name in ("rate", "state"))
        columns = MofNCompleteColumn(), BarColumn(bar_width=8), rate, TimeRemainingColumn(compact=True), state
        self.progress = Progress(*columns, console=self.console, disable=not (self.loud and self.console.is_terminal))
        self.progress.add_task(what, total=total, completed=done, rate="", state="")
        self.progress.start()
        return self.progress

    def stop(self) -> None:
        """Remove the progress bar, if there is one."""
        if self.progress:
            self.progress.stop()

    def phases(self, timers: dict[str, dict[str, float]], steps: int, particles: int) -> None:
        """Print the phase table: seconds of each phase over the ranks, and its share of the loop."""
        loop = timers["loop"]["mean"]
        numbers = [Column(name, justify="right") for name in ("min s", "mean s", "max s", "share")]
        table = Table("phase", *numbers, box=None, padding=(0, 2, 0, 0))
        for name in [*(p for p in PHASES if p in timers), "loop", "setup"]:
            t = timers[name]
            share = f"{t['mean'] / loop:.1%}" if loop > 0.0 and name != "setup" else ""
            table.add_row(PHASES.get(name, name), *(f"{t[k]:.3f}" for k in ("min", "mean", "max")), share)
        self.say(table)
        if steps and particles:
            seconds = timers["loop"]["max"]
            self.say(f"{steps / seconds:.0f} steps/s, {seconds / steps / particles * 1e9:.1f} ns a particle-step")
