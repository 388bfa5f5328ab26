"""What a person sees: the plan, a progress bar, the phase table. Rank 0 only; plain lines when not a terminal."""

from __future__ import annotations

import os
from collections.abc import Callable
from math import isfinite
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

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


def watched() -> bool:
    """Does a person see what is printed? Open MPI gives its ranks a terminal of their own: ask where mpirun's output goes."""
    if "OMPI_COMM_WORLD_SIZE" not in os.environ:
        return os.isatty(1)
    try:
        return os.readlink(f"/proc/{os.getppid()}/fd/1").startswith(("/dev/pts", "/dev/tty"))
    except OSError:
        return False


LEAST = 0.05  # of a step: phases that take less are not told beforehand
COMPILING = 20  # seconds for the kernels of one dimension, as one scene uses them
WIDE = 200  # columns of a table that no terminal cuts


def tell_of_compiling(dimension: int) -> None:
    """Say it, once, if this process has to compile a kernel: set-up did so for the dimensions up to 3."""
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
    """Talks on rank 0, unless told to be quiet."""

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
        """A wide table; where it does not go to a terminal it may be as wide as it is."""
        if self.loud:
            self.console.print(table, width=None if self.console.is_terminal else WIDE, crop=False)

    def plan(self, title: str, plan: dict[str, Any], warnings: list[str]) -> None:
        """The plan before the run."""
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
        """How long a run takes; `again` if that was told before, and turns out otherwise."""
        self.say(f"  predicted{' now' if again else ''}: {forecast}")

    def shares(self, forecast: Forecast) -> None:
        """What a step consists of, the dearest phases first."""
        total = sum(forecast.phases.values())
        shares = sorted(((s / total, name) for name, s in forecast.phases.items() if s >= LEAST * total > 0.0), reverse=True)
        if shares:
            self.say(f"  of a step: {', '.join(f'{PHASES.get(name, name)} {share:.0%}' for share, name in shares)}")

    def start(self, done: int, steps: int) -> Callable[[int, dict[str, Any]], None]:
        """Begin the progress bar; returns what to call with (steps done, last row of diagnostics)."""
        if not self.loud or not self.console.is_terminal:
            return lambda step, row: None
        self.progress = Progress(
            MofNCompleteColumn(), BarColumn(), TextColumn("{task.fields[rate]}"), TimeRemainingColumn(),
            TextColumn("{task.fields[state]}"),
            console=self.console,
        )  # fmt: skip
        task = self.progress.add_task("steps", total=steps, completed=done, rate="", state="")
        self.progress.start()

        def update(step: int, row: dict[str, Any]) -> None:
            assert self.progress
            speed = self.progress.tasks[0].speed
            rate = f"{speed:.0f} steps/s" if speed else ""
            name, energy = ("E", row["total_energy"]) if row else ("", 0.0)
            if not isfinite(energy):  # a force along a periodic axis
                name, energy = "kinetic E", row["kinetic"]
            state = f"{name} {energy:.6g}  collisions {row['collisions_so_far']}" if row else ""
            self.progress.update(task, completed=step, rate=rate, state=state)

        return update

    def count(self, what: str, number: int) -> Callable[[str], None]:
        """Begin a progress bar over so many of them; returns what to call with the name of each as it begins."""
        if not self.loud or not self.console.is_terminal:
            return lambda name: None
        self.progress = Progress(
            MofNCompleteColumn(), BarColumn(), TimeRemainingColumn(), TextColumn("{task.fields[name]}"), console=self.console
        )
        task = self.progress.add_task(what, total=number, completed=-1, name="")
        self.progress.start()

        def advance(name: str) -> None:
            assert self.progress
            self.progress.update(task, advance=1, name=name)

        return advance

    def stop(self) -> None:
        """End the progress bar, on any way out."""
        if self.progress:
            self.progress.stop()
            self.progress = None

    def phases(self, timers: dict[str, dict[str, float]], steps: int, particles: int) -> None:
        """The course's table: seconds of each phase over the ranks, and its share of the loop."""
        if not self.loud:
            return
        loop = timers["loop"]["mean"]
        table = Table("phase", "min s", "mean s", "max s", "share", box=None, padding=(0, 2, 0, 0))
        for column in table.columns[1:]:
            column.justify = "right"
        for name in [*(p for p in PHASES if p in timers), "loop", "setup"]:
            t = timers[name]
            share = f"{t['mean'] / loop:.1%}" if loop > 0.0 and name != "setup" else ""
            table.add_row(PHASES.get(name, name), *(f"{t[k]:.3f}" for k in ("min", "mean", "max")), share)
        self.console.print(table)
        if steps and particles:
            seconds = timers["loop"]["max"]
            each = seconds / steps / particles * 1e9
            self.console.print(f"{steps / seconds:.0f} steps/s, {each:.1f} ns a particle-step")
