"""What a user sees: the plan, a progress bar, the phase table. Printed by rank 0; plain lines where there is no terminal."""

from __future__ import annotations

import os
from collections.abc import Callable
from math import isfinite
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Column, Table

from particles_mpi.run.forecast import Forecast
from particles_mpi.scene.plan import size

PHASES = {
    "forces": "sum of forces",
    "kick": "velocities, friction, drag",
    "rest": "contacts that last",
    "agree": "agree with others (waits)",
    "ghosts": "ghosts: fetch, refresh",
    "migrate": "migrate, balance",
    "pairs": "find candidate pairs",
    "search": "contact times",
    "collide": "collide",
    "exchange": "all particles to all ranks",
    "walls": "drift with walls",
    "drift": "drift",
    "diagnostics": "diagnostics",
    "output": "frames",
    "checkpoint": "checkpoints",
    "watchdog": "watchdog",
    "other": "everything else",
}

LEAST = 0.05  # of a step: phases that take less are not named in a forecast
COMPILING = 20  # seconds to compile the kernels of one dimension that a scene uses
WIDE = 200  # columns of a table that is not shown on a terminal


def watched() -> bool:
    """Is the output shown on a terminal? Open MPI gives its ranks a terminal of their own: what counts is mpirun's output."""
    if "OMPI_COMM_WORLD_SIZE" not in os.environ:
        return os.isatty(1)
    try:
        return os.readlink(f"/proc/{os.getppid()}/fd/1").startswith(("/dev/pts", "/dev/tty"))
    except OSError:
        return False


def tell_of_compiling(dimension: int) -> None:
    """From here on print a line, once, if this process has to compile a kernel; set-up compiles those up to dimension 3."""
    from numba.core import event

    class Teller(event.Listener):
        def on_start(self, _: Any) -> None:
            if self in waiting:
                waiting.remove(self)
                print(f"dimension {dimension}: kernels are compiled now, about {COMPILING} s, once", flush=True)

        def on_end(self, _: Any) -> None:
            pass

    waiting = [Teller()]
    event.register("numba:compile", waiting[0])


class Screen:
    """Prints on rank 0, unless `quiet`."""

    def __init__(self, is_root: bool, quiet: bool):
        self.loud = is_root and not quiet
        self.console = Console(
            highlight=False, soft_wrap=True, force_terminal=None if watched() else False, width=None if watched() else 110
        )
        self.progress: Progress | None = None

    def say(self, text: Any) -> None:
        if self.loud:
            self.console.print(text)

    def table(self, table: Table) -> None:
        """Print a table, in its full width if it is not shown on a terminal."""
        if self.loud:
            self.console.print(table, width=None if self.console.is_terminal else WIDE, crop=False)

    def plan(self, title: str, plan: dict[str, Any], warnings: list[str]) -> None:
        """Print the plan, before the run."""
        if not self.loud:
            return
        say = self.console.print
        say(f"[bold]{title or 'untitled scene'}[/bold]: {plan['particles']} particles ({plan['fixed']} fixed) in dimension "
            f"{plan['dimension']}, {plan['steps']} steps of {plan['step']:g}, "
            f"{plan['integrator']}, {plan['ranks']} rank(s)")  # fmt: skip
        table = Table("runs", "law", box=None, padding=(0, 2, 0, 2))
        for row in plan["effects"]:
            table.add_row(row["effect"], row["law"])
            if "how" in row:
                table.add_row("", row["how"])
        table.add_row("drift", "dx/dt = v")
        say(table)
        say(f"  does not run: {', '.join(plan['not_run']) or 'nothing left out'}")
        say(f"  ghosts: {plan['ghosts']}; memory about {size(plan['memory_bytes'])}; output {plan['frames']} frames, about "
            f"{size(plan['output_bytes'])}")  # fmt: skip
        for line in plan["advice"]:
            say(f"  step: {line}")
        for line in warnings:
            say(f"  [yellow]warning:[/yellow] {line}")

    def forecast(self, forecast: Forecast, again: bool = False) -> None:
        """Print how long the run will take; `again`: the forecast before was wrong."""
        self.say(f"  predicted{' now' if again else ''}: {forecast}")

    def shares(self, forecast: Forecast) -> None:
        """Print the share of each phase in a step, the largest first."""
        total = sum(forecast.phases.values())
        shares = sorted(((s / total, name) for name, s in forecast.phases.items() if s >= LEAST * total > 0.0), reverse=True)
        if shares:
            self.say(f"  of a step: {', '.join(f'{PHASES.get(name, name)} {share:.0%}' for share, name in shares)}")

    def start(self, done: int, steps: int) -> Callable[[int, dict[str, Any]], None]:
        """Begin the progress bar; returns a function to be called with (steps done, last row of diagnostics)."""
        bar = self._progress("steps", steps, done, MofNCompleteColumn(), BarColumn(), TextColumn("{task.fields[rate]}"),
                             TimeRemainingColumn(), TextColumn("{task.fields[state]}"))  # fmt: skip

        def update(step: int, row: dict[str, Any]) -> None:
            if bar is None:
                return
            speed = bar.tasks[0].speed
            name, energy = ("E", row["total_energy"]) if row else ("", 0.0)
            if not isfinite(energy):  # a force along a periodic axis has no potential
                name, energy = "kinetic E", row["kinetic"]
            state = f"{name} {energy:.6g}  collisions {row['collisions_so_far']}" if row else ""
            bar.update(bar.tasks[0].id, completed=step, rate=f"{speed:.0f} steps/s" if speed else "", state=state)

        return update

    def count(self, what: str, number: int) -> Callable[[str], None]:
        """Begin a progress bar for a `number` of tasks; returns a function to be called with the name of each as it begins."""
        bar = self._progress(
            what, number, -1, MofNCompleteColumn(), BarColumn(), TimeRemainingColumn(), TextColumn("{task.fields[state]}")
        )

        def advance(name: str) -> None:
            if bar is not None:
                bar.update(bar.tasks[0].id, advance=1, state=name)

        return advance

    def _progress(self, what: str, total: int, done: int, *columns: ProgressColumn) -> Progress | None:
        """A progress bar with these columns, begun; None where nobody sees it."""
        if not self.loud or not self.console.is_terminal:
            return None
        self.progress = Progress(*columns, console=self.console)
        self.progress.add_task(what, total=total, completed=done, rate="", state="")
        self.progress.start()
        return self.progress

    def stop(self) -> None:
        """Remove the progress bar, if there is one."""
        if self.progress:
            self.progress.stop()
            self.progress = None

    def phases(self, timers: dict[str, dict[str, float]], steps: int, particles: int) -> None:
        """Print the phase table: seconds of each phase over the ranks, and its share of the loop."""
        if not self.loud:
            return
        loop = timers["loop"]["mean"]
        numbers = [Column(name, justify="right") for name in ("min s", "mean s", "max s", "share")]
        table = Table("phase", *numbers, box=None, padding=(0, 2, 0, 0))
        for name in [*(p for p in PHASES if p in timers), "loop", "setup"]:
            t = timers[name]
            share = f"{t['mean'] / loop:.1%}" if loop > 0.0 and name != "setup" else ""
            table.add_row(PHASES.get(name, name), *(f"{t[k]:.3f}" for k in ("min", "mean", "max")), share)
        self.console.print(table)
        if steps and particles:
            seconds = timers["loop"]["max"]
            each = seconds / steps / particles * 1e9
            self.console.print(f"{steps / seconds:.0f} steps/s, {each:.1f} ns a particle-step")
